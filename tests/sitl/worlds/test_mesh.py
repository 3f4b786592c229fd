"""Meshes as worlds: where their surfaces are, what is refused."""

from pathlib import Path

import numpy as np
import pytest

from companion.errors import ProfileError
from sitl.worlds import mesh
from sitl.worlds.mesh import merge_cubes, mesh_world
from sitl.worlds.raycast_kernels import BOX, PLANE

VOXEL = 0.2


def write_box(path: Path, low: tuple[float, float, float], high: tuple[float, float, float]) -> Path:
    """Write a closed box as an OBJ file."""
    corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += [f"f {a} {b} {c}\nf {a} {c} {d}" for a, b, c, d in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_walls_stand_where_they_stood_to_within_a_cube(tmp_path: Path) -> None:
    world = mesh_world(write_box(tmp_path / "hut.obj", (2.0, -1.5, 0.0), (6.0, 1.5, 3.0)), VOXEL, 0.0, 0.4)
    assert world.kinds[0] == PLANE
    assert np.all(world.kinds[1:] == BOX)
    obstacles = world.obstacles()
    for place, distance in [((0.0, 0.0, 1.5), 2.0), ((4.0, -4.0, 1.0), 2.5), ((4.0, 0.0, 5.0), 2.0)]:
        measured = float(obstacles.clearance(place))
        assert distance - VOXEL - 1e-6 <= measured <= distance + 1e-6
    surface = np.random.default_rng(1).uniform((2.0, -1.5, 0.7), (6.0, 1.5, 3.0), (500, 3))
    surface[:, 0] = 2.0
    assert obstacles.clearance(surface).max() <= 1e-6  # the wall has no hole
    assert float(obstacles.clearance((4.0, 0.0, 1.5))) > 1.0  # and is hollow behind
    assert len(world) < 200


def test_what_lies_low_becomes_the_ground_unless_the_floor_is_kept(tmp_path: Path) -> None:
    path = write_box(tmp_path / "slab.obj", (-5.0, -5.0, -0.1), (5.0, 5.0, 0.1))
    assert len(mesh_world(path, VOXEL, 0.0, 0.4)) == 1
    kept = mesh_world(path, VOXEL, None, 0.4)
    assert PLANE not in kept.kinds
    assert float(kept.clearance((0.0, 0.0, 1.0))) == pytest.approx(0.9, abs=VOXEL)


def test_merged_boxes_fill_exactly_the_cubes() -> None:
    rng = np.random.default_rng(2)
    for size in (0, 1, 40, 400):
        cubes = np.unique(rng.integers(-4, 4, (size, 3)), axis=0)
        merged = merge_cubes(cubes)
        filled = np.zeros((9, 9, 9), int)
        for x0, y0, z0, x1, y1, z1 in merged + 4:
            filled[x0:x1, y0:y1, z0:z1] += 1
        expected = np.zeros((9, 9, 9), int)
        expected[tuple((cubes + 4).T)] = 1
        np.testing.assert_array_equal(filled, expected)
        assert len(merged) <= len(cubes)
    wall = np.stack(np.meshgrid(np.arange(50), [7], np.arange(20), indexing="ij"), axis=-1).reshape(-1, 3)
    assert merge_cubes(wall).tolist() == [[0, 7, 0, 50, 8, 20]]


def test_files_that_are_no_mesh_of_reasonable_size_are_refused_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken.ply").write_text("this is no mesh")
    (tmp_path / "world.dae").write_text("")
    huge = write_box(tmp_path / "huge.obj", (-5e4, -5e4, 0.0), (5e4, 5e4, 10.0))
    hut = write_box(tmp_path / "hut.obj", (2.0, -1.5, 0.0), (6.0, 1.5, 3.0))
    for path, words in [
        (tmp_path / "absent.ply", "no such file"),
        (tmp_path / "broken.ply", "no triangles"),
        (tmp_path / "world.dae", "allowed: .ply"),
        (huge, "use larger cubes"),
    ]:
        with pytest.raises(ProfileError, match=words) as refused:
            mesh_world(path, VOXEL, 0.0, 0.4)
        assert str(refused.value).startswith(str(path))
        assert "\n" not in str(refused.value)
    monkeypatch.setattr(mesh, "MAX_BOXES", 3)
    with pytest.raises(ProfileError, match="at most 3 are allowed"):
        mesh_world(hut, VOXEL, 0.0, 0.4)
    monkeypatch.setattr(mesh, "MAX_BYTES", 10)
    with pytest.raises(ProfileError, match="at most 10 are read"):
        mesh_world(hut, VOXEL, 0.0, 0.4)
