"""Finds every numerical kernel of the product and makes it ready before flight."""

import contextlib
import hashlib
import importlib
import pkgutil
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import companion
from companion.compiled import declaring_packages, warm_up

_STAMP = "kernels.sha256"


def kernel_modules() -> list[str]:
    """Return the names of all modules that hold compiled kernels, by the naming rule of the house."""
    found = pkgutil.walk_packages(companion.__path__, f"{companion.__name__}.")
    return sorted(module.name for module in found if module.name.endswith("kernels"))


def forget_stale_kernels(root: Path, other_sources: Sequence[Path] = ()) -> bool:
    """Delete compiled kernels below a folder if any kernel's source has changed since they were made.

    Numba looks at the file of the kernel itself only; a function of another file that was compiled into it
    may have changed as well.

    Args:
        root: the folder.
        other_sources: files elsewhere from which something is compiled into its kernels.

    Returns:
        Whether anything had changed.
    """
    digest = hashlib.sha256()
    for source in [*sorted(root.rglob("*kernels.py")), *sorted(other_sources)]:
        name = source.relative_to(root).as_posix() if source.is_relative_to(root) else source.name
        digest.update(name.encode())
        digest.update(source.read_bytes())
    stamp = root / "__pycache__" / _STAMP
    # Where nothing can be written, as in a system-wide installation, Numba keeps its files elsewhere.
    with contextlib.suppress(OSError):
        if stamp.exists() and stamp.read_text(encoding="ascii") == digest.hexdigest():
            return False
        for compiled_file in [*root.rglob("*.nbi"), *root.rglob("*.nbc")]:
            compiled_file.unlink(missing_ok=True)
        stamp.parent.mkdir(exist_ok=True)
        stamp.write_text(digest.hexdigest(), encoding="ascii")
    return True


def forget_stale(packages: Iterable[str] = ()) -> None:
    """Delete compiled kernels whose sources have changed, of this package and of others.

    Those of others count as changed also when a kernel of this package has, for it may be part of them.

    Args:
        packages: names of the others; what is no package on the disk is passed over.
    """
    own = Path(companion.__file__).parent
    shared = own / "compiled.py"
    forget_stale_kernels(own, [shared])
    for name in sorted({*packages} - {companion.__name__}):
        for folder in getattr(importlib.import_module(name), "__path__", ()):
            forget_stale_kernels(Path(folder), [*own.rglob("*kernels.py"), shared])


def load_kernels(on_kernel: Callable[[str, int, int], None] | None = None) -> int:
    """Compile every kernel or load it from the disk cache, then forbid compilation in this process.

    Args:
        on_kernel: called with (name, index from 1, total) before each kernel.

    Returns:
        The number of kernels made ready.
    """
    forget_stale(declaring_packages())
    for name in kernel_modules():
        importlib.import_module(name)
    return warm_up(on_kernel)
