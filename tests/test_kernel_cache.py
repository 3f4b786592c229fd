"""Every kernel of the product is found by its file's name and can be made ready."""

import subprocess
import sys
from pathlib import Path

import pytest

from companion import kernel_cache
from companion.kernel_cache import forget_stale, forget_stale_kernels, kernel_modules
from sitl.cli import main

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


PACKAGE = {
    "companion/__init__.py": "",
    "emulator/__init__.py": "",
    "emulator/hot_kernels.py": """
from companion.compiled import compiled
from companion.small_kernels import offset


@compiled("int64(int64)")
def moved(x: int) -> int:
    return x + offset()
""",
}
OFFSET = """
from companion.compiled import inlined


@inlined
def offset() -> int:
    return {}
"""
LOAD = "import emulator.hot_kernels as hot; from companion.kernel_cache import load_kernels; load_kernels(); "


def test_a_kernel_into_which_an_edited_one_was_compiled_is_compiled_again(tmp_path: Path) -> None:
    for name, text in PACKAGE.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    for name in ("compiled.py", "kernel_cache.py"):
        (tmp_path / "companion" / name).write_bytes((ROOT / "companion" / name).read_bytes())

    def moved(offset: int) -> str:
        (tmp_path / "companion" / "small_kernels.py").write_text(OFFSET.format(offset))
        command = [sys.executable, "-B", "-c", f"{LOAD} print(hot.moved(1))"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=200)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    assert moved(10) == "11"
    assert moved(20) == "21"


def test_what_is_no_package_holds_no_kernels_to_forget() -> None:
    forget_stale(("json.decoder", "__main__"))


def test_looking_at_a_world_forgets_stale_kernels_of_the_emulator(monkeypatch: pytest.MonkeyPatch) -> None:
    forgotten: list[str] = []
    monkeypatch.setattr(kernel_cache, "forget_stale", lambda packages: forgotten.extend(packages))
    assert main(["world", "none"]) == 0
    assert forgotten == ["sitl"]
