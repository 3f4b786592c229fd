import numpy as np
import pytest

from companion.messages import FloatArray
from companion.perception.odometry import voxel_kernels
from companion.perception.odometry.voxel_map import MOST_FUSED, VoxelMap

IDENTITY = np.concatenate([np.zeros(3), np.eye(3).ravel()])


def _means(points: FloatArray, cell_m: float) -> dict[tuple[int, ...], FloatArray]:
    cells: dict[tuple[int, ...], list[FloatArray]] = {}
    for point in points:
        cells.setdefault(tuple(np.floor(point / cell_m).astype(int).tolist()), []).append(point)
    return {cell: np.mean(members[:MOST_FUSED], axis=0) for cell, members in cells.items()}


def _gather(voxels: VoxelMap, place: FloatArray, radius_m: float) -> FloatArray:
    found = np.zeros((27, voxel_kernels.FOUND_WIDTH))
    count = voxel_kernels.gather(
        voxels.table_keys,
        voxels.table_blocks,
        voxels.cells,
        voxels.cell_m,
        radius_m,
        float(place[0]),
        float(place[1]),
        float(place[2]),
        found,
    )
    return found[:count]


def _lookup_works(voxels: VoxelMap) -> bool:
    """Every block of the pool is found under its key, and nothing else is in the table."""
    used = np.flatnonzero(voxels.block_keys != voxel_kernels.EMPTY)
    found = [
        voxel_kernels.find(voxels.table_keys, voxels.table_blocks, int(voxels.block_keys[block]))
        for block in used
    ]
    in_table = int((voxels.table_keys != voxel_kernels.EMPTY).sum())
    return found == used.tolist() and in_table == len(used) == voxels.blocks


def test_a_cell_holds_the_mean_of_its_points() -> None:
    points = np.random.default_rng(0).normal(0.0, 2.0, (4000, 3))
    voxels = VoxelMap(0.5, 4096, 100.0)
    voxels.insert(points[:1500], IDENTITY, 100.0)
    voxels.insert(points[1500:], IDENTITY, 100.0)
    expected = _means(points, 0.5)
    stored = voxels.points()
    assert len(stored) == len(expected)
    for point in stored:
        mean = expected[tuple(np.floor(point / 0.5).astype(int).tolist())]
        np.testing.assert_allclose(point, mean, atol=1e-5)


def test_a_settled_cell_no_longer_moves() -> None:
    voxels = VoxelMap(1.0, 1024, 100.0)
    voxels.insert(np.full((MOST_FUSED, 3), 0.25), IDENTITY, 100.0)
    voxels.insert(np.full((500, 3), 0.75), IDENTITY, 100.0)
    np.testing.assert_allclose(voxels.points(), [[0.25, 0.25, 0.25]], atol=1e-6)


def test_points_are_placed_by_the_pose_and_far_ones_left_out() -> None:
    pose = np.concatenate([[1.0, 2.0, 3.0], [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    voxels = VoxelMap(0.2, 1024, 100.0)
    voxels.insert(np.array([[4.0, 0.0, 0.0], [30.0, 0.0, 0.0], [np.nan, 0.0, 0.0]]), pose, 10.0)
    np.testing.assert_allclose(voxels.points(), [[1.0, 6.0, 3.0]], atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_gathering_sees_the_27_cells_around_a_place(seed: int) -> None:
    rng = np.random.default_rng(seed)
    voxels = VoxelMap(0.4, 8192, 100.0)
    voxels.insert(rng.uniform(-2.0, 2.0, (3000, 3)), IDENTITY, 100.0)
    stored = voxels.points()
    for place in rng.uniform(-2.0, 2.0, (200, 3)):
        near = np.all(np.abs(np.floor(stored / 0.4) - np.floor(place / 0.4)) <= 1, axis=1)
        near &= np.linalg.norm(stored - place, axis=1) <= 0.5
        found = _gather(voxels, place, 0.5)
        expected = stored[near] - place
        np.testing.assert_allclose(
            found[np.lexsort(found[:, :3].T), :3], expected[np.lexsort(expected.T)], atol=1e-6
        )
        np.testing.assert_allclose(found[:, 4], np.sum(found[:, :3] ** 2, axis=1))


def test_blocks_beyond_the_radius_are_forgotten_as_the_sensor_moves_on() -> None:
    voxels = VoxelMap(0.5, 4096, 20.0)
    rng = np.random.default_rng(1)
    pose = IDENTITY.copy()
    for step in range(400):
        pose[0] = 0.5 * step
        voxels.insert(rng.uniform(-5.0, 5.0, (200, 3)), pose, 100.0)
    stored = voxels.points()
    # A full turn of the sweep takes 64 insertions: 32 m.
    assert float(np.linalg.norm(stored - pose[:3], axis=1).max()) < 20.0 + 32.0 + 2.0
    assert voxels.control[2] > 0
    assert _lookup_works(voxels)


def test_a_full_map_gives_up_what_was_not_seen_for_long() -> None:
    voxels = VoxelMap(0.5, 1024, 1000.0)
    rng = np.random.default_rng(2)
    pose = IDENTITY.copy()
    for step in range(60):
        pose[0] = 3.0 * step
        voxels.insert(rng.uniform(-4.0, 4.0, (600, 3)), pose, 100.0)
        assert voxels.blocks <= 1024
    assert _lookup_works(voxels)
    near = np.abs(voxels.points()[:, 0] - pose[0]) < 4.0
    assert near.sum() > 300


def test_a_cleared_map_is_empty_and_usable() -> None:
    voxels = VoxelMap(0.5, 1024, 100.0)
    voxels.insert(np.random.default_rng(3).normal(0.0, 2.0, (500, 3)), IDENTITY, 100.0)
    voxels.clear()
    assert voxels.blocks == 0
    assert len(voxels.points()) == 0
    voxels.insert(np.ones((1, 3)), IDENTITY, 100.0)
    assert _lookup_works(voxels)
