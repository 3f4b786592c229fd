"""Ahead-of-flight compilation of numerical kernels.

Kernels are declared with `compiled(signature)` and stay uncompiled until `warm_up` (or, in tests and
tools, their first call). `warm_up` compiles or loads from disk every registered kernel and then
forbids further compilation, so nothing can be compiled in the air.

The same source runs on a graphics card: `for_cuda` compiles a kernel, and all that it calls, a second time.
"""

from collections.abc import Callable
from types import FunctionType
from typing import Any, TypeVar, cast

import numba
from numba.core import sigutils
from numba.core.dispatcher import Dispatcher

_Function = TypeVar("_Function", bound=Callable[..., Any])

_registry: list[tuple[Any, str]] = []


def compiled(signature: str) -> Callable[[_Function], _Function]:
    """Mark a function as a compiled kernel for one explicit Numba signature.

    The kernel releases the interpreter lock, is cached on disk, divides like IEEE 754 and keeps the
    order of floating point operations, so equal inputs give equal bits.

    Args:
        signature: Numba signature, for example ``"float64(float64[::1], int64)"``.
    """
    return lambda function: _declared(function, signature, counts_references=True)


def inlined(function: _Function) -> _Function:
    """Mark a scalar function that kernels call; it is compiled as part of its callers, at every call.

    An array is seven numbers: left alone, the compiler often calls instead, and passes them all each time.
    """
    options = {"nogil": True, "error_model": "numpy", "_nrt": True, "forceinline": True}
    return cast(_Function, numba.njit(**options)(function))


def portable(signature: str) -> Callable[[_Function], _Function]:
    """Mark a compiled kernel in the common subset of compilers for processors and graphics cards.

    It allocates nothing and owns no array, only looks into those it is given. So nobody counts who else holds
    them, which is dear where functions hand arrays on, and dearer where several threads count the same one.

    Args:
        signature: as for `compiled`.
    """
    return lambda function: _declared(function, signature, counts_references=False)


def portable_inlined(function: _Function) -> _Function:
    """Mark a function that portable kernels call, as `inlined` does; it may return arrays it was given.

    Kernels that are not portable may call it only if it returns no array.
    """
    return cast(_Function, numba.njit(nogil=True, error_model="numpy", _nrt=False)(function))


def _declared(function: _Function, signature: str, *, counts_references: bool) -> _Function:
    options = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": counts_references}
    dispatcher = numba.njit(**options)(function)
    _registry.append((dispatcher, signature))
    return cast(_Function, dispatcher)


def declaring_packages() -> set[str]:
    """Return the names of the top-level packages whose modules have declared kernels so far."""
    return {str(dispatcher.py_func.__module__).partition(".")[0] for dispatcher, _ in _registry}


def warm_up(on_kernel: Callable[[str, int, int], None] | None = None) -> int:
    """Compile or load every registered kernel, then forbid compilation.

    Args:
        on_kernel: called with (name, index from 1, total) before each kernel, for progress.

    Returns:
        The number of kernels made ready.
    """
    total = len(_registry)
    for index, (dispatcher, signature) in enumerate(_registry, start=1):
        if on_kernel is not None:
            on_kernel(dispatcher.py_func.__name__, index, total)
        if not dispatcher.signatures:
            _compile(dispatcher, signature)
        dispatcher.disable_compile()
    return total


def _compile(dispatcher: Any, signature: str) -> None:
    """Compile a kernel as its first call would: the disk cache then holds it once for both.

    Raises:
        TypeError: if it returns another type than it declares.
    """
    arguments, declared = sigutils.normalize_signature(signature)
    dispatcher.compile(arguments)
    found = dispatcher.overloads[arguments].signature.return_type
    if found != declared:
        raise TypeError(f"{dispatcher.py_func.__qualname__} returns {found}, declared is {declared}")


def for_cuda(function: _Function, *, entry: bool = False) -> _Function:
    """Return the same source as a function of a graphics card, with all kernels that it calls.

    What was compiled for the processor, or may no longer be, plays no part: every function that the source
    names is built anew from its own source. On the simulator of CUDA (NUMBA_ENABLE_CUDASIM=1) the result is
    the plain Python of it all. Only scalar code works there: no allocation, no calls of numpy, no exceptions.

    Args:
        function: a kernel, or a plain function that calls kernels.
        entry: whether it is launched from the processor, and cached on disk; otherwise other functions of the
            card call it.
    """
    # Drones have no such card, and the import takes time.
    from numba import config, cuda

    twin = _twin(function)
    if config.ENABLE_CUDASIM and not entry:
        return cast(_Function, twin)
    return cast(_Function, cuda.jit(cache=True)(twin) if entry else cuda.jit(device=True)(twin))


_device_functions: dict[FunctionType, Any] = {}


def _twin(function: Callable[..., Any]) -> FunctionType:
    """Return a copy of a function whose names stand for functions of the card."""
    source = cast(FunctionType, function.py_func if isinstance(function, Dispatcher) else function)
    names = dict(source.__globals__)
    for name in source.__code__.co_names:
        value = names.get(name)
        if isinstance(value, Dispatcher):
            if value.py_func not in _device_functions:
                _device_functions[value.py_func] = for_cuda(value)
            names[name] = _device_functions[value.py_func]
    twin = FunctionType(source.__code__, names, source.__name__, source.__defaults__, source.__closure__)
    twin.__module__, twin.__qualname__ = source.__module__, source.__qualname__
    return twin
