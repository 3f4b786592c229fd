"""Finds every numerical kernel of the product and makes it ready before flight."""

import importlib
import pkgutil
from collections.abc import Callable

import companion
from companion.compiled import warm_up


def kernel_modules() -> list[str]:
    """Return the names of all modules that hold compiled kernels, by the naming rule of the house."""
    found = pkgutil.walk_packages(companion.__path__, f"{companion.__name__}.")
    return sorted(module.name for module in found if module.name.endswith("kernels"))


def load_kernels(on_kernel: Callable[[str, int, int], None] | None = None) -> int:
    """Compile every kernel or load it from the disk cache, then forbid compilation in this process.

    Args:
        on_kernel: called with (name, index from 1, total) before each kernel.

    Returns:
        The number of kernels made ready.
    """
    for name in kernel_modules():
        importlib.import_module(name)
    return warm_up(on_kernel)
