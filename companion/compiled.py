"""Ahead-of-flight compilation of numerical kernels.

Kernels are declared with `compiled(signature)` and stay uncompiled until `warm_up` (or, in tests and
tools, their first call). `warm_up` compiles or loads from disk every registered kernel and then
forbids further compilation, so nothing can be compiled in the air.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])

_registry: list[tuple[Any, str]] = []


def compiled(signature: str) -> Callable[[_Function], _Function]:
    """Mark a function as a compiled kernel for one explicit Numba signature.

    The kernel releases the interpreter lock, is cached on disk, divides like IEEE 754 and keeps the
    order of floating point operations, so equal inputs give equal bits.

    Args:
        signature: Numba signature, for example ``"float64(float64[::1], int64)"``.
    """

    def declare(function: _Function) -> _Function:
        dispatcher = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
        _registry.append((dispatcher, signature))
        return cast(_Function, dispatcher)

    return declare


def inlined(function: _Function) -> _Function:
    """Mark a small scalar function that kernels call; it is compiled as part of its callers."""
    return cast(_Function, numba.njit(nogil=True, error_model="numpy")(function))


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
            dispatcher.compile(signature)
        dispatcher.disable_compile()
    return total
