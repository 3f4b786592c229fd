"""The floors of the house: imports only ever go down, and never in a circle."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

WINGS = ("drivers", "perception", "control", "safety", "logs")

# A module may import its own floor's modules only where that makes no circle, and any lower floor.
FLOORS: tuple[frozenset[str], ...] = (
    frozenset(
        {
            "clock",
            "compiled",
            "directories",
            "errors",
            "exit_codes",
            "geometry",
            "settings",
            "yaml_problems",
            "yaml_source",
            "yaml_tree",
        }
    ),
    frozenset({"messages"}),
    frozenset(WINGS),
    frozenset({"pipeline"}),
    frozenset(
        {
            "assembly",
            "config",
            "command_line",
            "control_socket",
            "decision_schedule",
            "exchange",
            "flight",
            "kernel_cache",
            "metrics_cli",
            "perception_thread",
            "preflight",
            "recordings",
            "replay",
            "runtime",
            "service",
        }
    ),
    frozenset({"cli", "__main__"}),
)

OWNERS = {
    "mavsdk": "companion/drivers/px4.py",
    "onnxruntime": "companion/control/policy.py",
    "open3d": "sitl/worlds",
    "filterpy": "companion/perception/tracking",
    "mcap": "companion/logs",
    "torch": "sitl/training",
    "ray": "sitl/campaign",
}


def python_files(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imported_names(path: Path) -> list[str]:
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.extend(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            names.append(node.module)
            names.extend(f"{node.module}.{alias.name}" for alias in node.names)
    return names


def part_of(name: str) -> str | None:
    """Return the first component below `companion`, or None for the bare package."""
    pieces = name.split(".")
    return pieces[1] if pieces[0] == "companion" and len(pieces) > 1 else None


def floor_of(part: str) -> int | None:
    return next((index for index, floor in enumerate(FLOORS) if part in floor), None)


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@pytest.mark.parametrize("path", python_files("companion"), ids=lambda p: str(p.relative_to(ROOT)))
def test_companion_imports_only_downwards(path: Path) -> None:
    part = part_of(module_name(path))
    if part is None:
        return
    floor = floor_of(part)
    assert floor is not None, f"{path.name} stands on no floor: add {part!r} to FLOORS"
    for name in imported_names(path):
        assert not name.startswith("sitl"), f"{path}: companion never imports sitl"
        other = part_of(name)
        other_floor = floor_of(other) if other is not None else None
        if other is None or other_floor is None:
            continue
        assert other_floor <= floor, f"{path} climbs to {name}"
        if part in WINGS and other in WINGS:
            assert part == other, f"{path}: wings do not know each other ({name})"


def test_no_module_is_part_of_an_import_circle() -> None:
    modules = {module_name(p): p for package in ("companion", "sitl") for p in python_files(package)}
    edges = {
        name: {other for other in imported_names(path) if other in modules and other != name}
        for name, path in modules.items()
    }
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, " -> ".join([*trail, name])
        if name in done:
            return
        for other in sorted(edges[name]):
            if other not in ("companion", "sitl"):
                visit(other, (*trail, name))
        done.add(name)

    for name in sorted(modules):
        visit(name, ())


@pytest.mark.parametrize("library", sorted(OWNERS))
def test_a_heavy_library_has_one_owner(library: str) -> None:
    for path in [*python_files("companion"), *python_files("sitl")]:
        if any(name.split(".")[0] == library for name in imported_names(path)):
            relative = path.relative_to(ROOT).as_posix()
            assert relative.startswith(OWNERS[library]), f"{relative} imports {library}"


@pytest.mark.parametrize("package", ["companion", "sitl", "tests"])
def test_no_file_is_longer_than_400_lines(package: str) -> None:
    for path in python_files(package):
        lines = len(path.read_text(encoding="utf-8").splitlines())
        assert lines <= 400, f"{path.relative_to(ROOT)} has {lines} lines"


def test_no_file_is_a_drawer() -> None:
    for path in [*python_files("companion"), *python_files("sitl")]:
        assert path.stem not in {"utils", "util", "helpers", "common", "misc"}, path
