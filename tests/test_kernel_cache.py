"""Every kernel of the product is found by its file's name and can be made ready."""

import subprocess
import sys
from pathlib import Path

from companion.kernel_cache import forget_stale_kernels, kernel_modules

ROOT = Path(__file__).parents[1]


def test_every_file_with_kernels_is_found() -> None:
    declared = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in (ROOT / "companion").rglob("*.py")
        if "@compiled(" in path.read_text(encoding="utf-8") and path.name != "compiled.py"
    }
    assert declared
    assert declared <= set(kernel_modules())


def test_warmup_makes_them_ready_and_says_how_many() -> None:
    command = [sys.executable, "-m", "companion.cli", "warmup"]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=280)
    assert result.returncode == 0, result.stderr
    count, _, rest = result.stdout.partition(" ")
    assert int(count) >= len(kernel_modules())
    assert rest == "kernels ready\n"


def test_what_was_compiled_from_changed_sources_is_forgotten(tmp_path: Path) -> None:
    source = tmp_path / "wing" / "hot_kernels.py"
    compiled_file = tmp_path / "wing" / "__pycache__" / "hot_kernels.f-1.py311.1.nbc"
    compiled_file.parent.mkdir(parents=True)
    source.write_text("a = 1\n")
    forget_stale_kernels(tmp_path)
    compiled_file.write_bytes(b"machine code")
    assert not forget_stale_kernels(tmp_path)
    assert compiled_file.exists()
    source.write_text("a = 2\n")
    assert forget_stale_kernels(tmp_path)
    assert not compiled_file.exists()
