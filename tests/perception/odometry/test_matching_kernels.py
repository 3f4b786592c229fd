import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.odometry import matching_kernels, plane_kernels
from companion.perception.odometry.voxel_map import VoxelMap

IDENTITY = np.concatenate([np.zeros(3), np.eye(3).ravel()])


def _planes(points: FloatArray, fine: VoxelMap, coarse: VoxelMap, pose: FloatArray) -> FloatArray:
    planes = np.zeros((len(points), matching_kernels.PLANE_WIDTH))
    matching_kernels.find_planes(
        points,
        np.arange(len(points)),
        pose,
        fine.table_keys,
        fine.table_blocks,
        fine.block_born,
        fine.cells,
        fine.cell_m,
        coarse.table_keys,
        coarse.table_blocks,
        coarse.block_born,
        coarse.cells,
        coarse.cell_m,
        0.1,
        True,
        planes,
    )
    return planes


@pytest.mark.parametrize("seed", range(20))
def test_the_smallest_eigenvector_agrees_with_lapack(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3)) * rng.uniform(0.01, 3.0, 3)
    A = root @ root.T
    result = np.zeros(6)
    plane_kernels.smallest_eigenvector(A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2], result)
    values, vectors = np.linalg.eigh(A)
    np.testing.assert_allclose(result[3:], values, atol=1e-9 * values[2])
    assert abs(float(result[:3] @ vectors[:, 0])) > 1.0 - 1e-6


def test_a_sphere_has_no_smallest_eigenvector() -> None:
    result = np.ones(6)
    plane_kernels.smallest_eigenvector(2.0, 0.0, 0.0, 2.0, 0.0, 2.0, result)
    np.testing.assert_array_equal(result[:3], 0.0)


def test_a_noisy_wall_gives_its_plane() -> None:
    rng = np.random.default_rng(0)
    n = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
    u = np.cross(n, [0.0, 0.0, 1.0])
    u /= np.linalg.norm(u)
    v = np.cross(n, u)
    across = rng.uniform(-2.0, 2.0, (20_000, 2))
    wall = across[:, :1] * u + across[:, 1:] * v + 5.0 * n + rng.normal(0.0, 0.02, (20_000, 1)) * n
    fine, coarse = VoxelMap(0.2, 8192, 100.0), VoxelMap(0.6, 8192, 100.0)
    fine.insert(wall, IDENTITY, 100.0)
    queries = np.ascontiguousarray(wall[:200][np.abs(across[:200]).max(axis=1) < 1.5])
    planes = _planes(queries, fine, coarse, IDENTITY)
    assert np.mean(planes[:, 5] == 0.0) > 0.95
    good = planes[planes[:, 5] == 0.0]
    assert float(np.degrees(np.arccos(np.minimum(np.abs(good[:, :3] @ n), 1.0))).max()) < 6.0
    # The plane passes through the wall beside the query, not through the noisy query.
    beside = queries[planes[:, 5] == 0.0] - (queries[planes[:, 5] == 0.0] @ n - 5.0)[:, None] * n
    assert float(np.abs(np.sum(good[:, :3] * beside, axis=1) + good[:, 3]).max()) < 0.02


def test_where_the_fine_map_is_too_sparse_the_coarse_one_answers() -> None:
    grid = np.stack(np.meshgrid(np.arange(-3.0, 3.0, 0.5), np.arange(-3.0, 3.0, 0.5)), axis=-1).reshape(-1, 2)
    ground = np.ascontiguousarray(np.concatenate([grid, np.full((len(grid), 1), -1.0)], axis=1))
    fine, coarse = VoxelMap(0.15, 8192, 100.0), VoxelMap(0.6, 8192, 100.0)
    fine.insert(ground, IDENTITY, 100.0)
    coarse.insert(ground, IDENTITY, 100.0)
    planes = _planes(np.array([[0.2, 0.3, -1.02], [50.0, 0.0, 0.0]]), fine, coarse, IDENTITY)
    assert planes[0, 5] == 1.0
    np.testing.assert_allclose(np.abs(planes[0, :3]), [0.0, 0.0, 1.0], atol=1e-6)
    assert planes[1, 5] == -1.0


def test_a_line_is_no_plane() -> None:
    wire = np.stack([np.linspace(-1.0, 1.0, 400), np.zeros(400), np.zeros(400)], axis=1)
    fine, coarse = VoxelMap(0.2, 1024, 100.0), VoxelMap(0.6, 1024, 100.0)
    fine.insert(wire, IDENTITY, 100.0)
    coarse.insert(wire, IDENTITY, 100.0)
    assert _planes(np.array([[0.1, 0.0, 0.0]]), fine, coarse, IDENTITY)[0, 5] == -1.0


@pytest.mark.parametrize("seed", range(4))
def test_the_normal_equations_agree_with_the_readable_sum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(0.0, 8.0, (400, 3))
    R = rotation.to_matrix(rotation.exp(rng.normal(0.0, 1.0, 3)))
    p = rng.normal(0.0, 3.0, 3)
    pose = np.concatenate([p, R.ravel()])
    normals = rng.normal(size=(400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    true = rng.normal(0.0, 0.05, 400)
    planes = np.zeros((400, matching_kernels.PLANE_WIDTH))
    planes[:, :3] = normals
    planes[:, 3] = true - np.sum(normals * (points @ R.T + p), axis=1)
    planes[:, 4] = rng.uniform(0.0, 1e-4, 400)
    planes[::9, 5] = -1.0
    root = rng.normal(0.0, 0.01, (6, 6))
    prior = root @ root.T
    information, gradient, statistics = np.zeros((6, 6)), np.zeros(6), np.zeros(4)
    used = matching_kernels.accumulate(
        points, np.arange(400), planes, pose, prior, 4e-4, 1e-6, 1e-4, information, gradient, statistics
    )
    A, b, count = np.zeros((6, 6)), np.zeros(6), 0
    for i in range(400):
        if planes[i, 5] < 0.0:
            continue
        n_imu = R.T @ normals[i]
        h = np.concatenate([normals[i], np.cross(points[i], n_imu)])
        along = points[i] @ n_imu
        square = points[i] @ points[i]
        variance = 4e-4 * along**2 / square + 1e-6 * (square - along**2) + 1e-4 + planes[i, 4]
        if true[i] ** 2 > 9.0 * (variance + h @ prior @ h):
            continue
        weight = 1.0 / (variance * (1.0 + true[i] ** 2 / variance / 4.0))
        A += weight * np.outer(h, h)
        b -= weight * true[i] * h
        count += 1
    assert used == count
    assert 0 < count < 356
    np.testing.assert_allclose(information, A, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(gradient, b, rtol=1e-7, atol=1e-6)


def _cylinder(rng: np.random.Generator, radius_m: float, count: int) -> FloatArray:
    """The half of an upright cylinder at (5, 0) that faces the origin."""
    angle = rng.uniform(0.5 * np.pi, 1.5 * np.pi, count)
    ring = radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1) + [5.0, 0.0]
    return np.concatenate([ring, rng.uniform(-1.5, 1.5, (count, 1))], axis=1)


@pytest.mark.parametrize("radius_m", [0.2, 0.3, 0.5])
def test_the_plane_of_a_pillar_touches_its_surface(radius_m: float) -> None:
    rng = np.random.default_rng(3)
    points = _cylinder(rng, radius_m, 60_000)
    fine, coarse = VoxelMap(0.15, 8192, 100.0), VoxelMap(0.6, 8192, 100.0)
    fine.insert(points, IDENTITY, 100.0)
    facing = np.abs(points[:, 1]) < 0.5 * radius_m
    queries = np.ascontiguousarray(points[facing][:600])
    planes = _planes(queries, fine, coarse, IDENTITY)
    good = planes[:, 5] == 0.0
    assert np.mean(good) > 0.9
    outward = queries[good] - [5.0, 0.0, 0.0]
    outward[:, 2] = 0.0
    sign = np.sign(np.sum(planes[good, :3] * outward, axis=1))
    height = sign * (np.sum(planes[good, :3] * queries[good], axis=1) + planes[good, 3])
    # Planes without curvature lie 31, 17 and 11 mm inside these.
    assert abs(float(height.mean())) < 0.003


def test_information_is_split_by_when_its_planes_were_first_seen() -> None:
    rng = np.random.default_rng(4)
    points = rng.normal(0.0, 8.0, (300, 3))
    R = rotation.to_matrix(rotation.exp(rng.normal(0.0, 1.0, 3)))
    pose = np.concatenate([rng.normal(0.0, 3.0, 3), R.ravel()])
    planes = np.zeros((300, matching_kernels.PLANE_WIDTH))
    planes[:, :3] = rng.normal(size=(300, 3))
    planes[:, :3] /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    planes[:, 6] = rng.integers(1, 100, 300)
    planes[:, 7] = np.where(rng.uniform(size=300) < 0.3, 0.0, rng.uniform(1.0, 5.0, 300))
    starts = np.array([0, 20, 21, 70, 10_000])
    information, weights = np.ones((5, 6, 6)), np.ones(5)
    matching_kernels.share_by_birth(points, np.arange(300), planes, pose, starts, 4, information, weights)
    for k in range(4):
        expected, weight = np.zeros((6, 6)), 0.0
        for i in np.flatnonzero((planes[:, 6] >= starts[k]) & (planes[:, 6] < starts[k + 1])):
            h = np.concatenate([planes[i, :3], np.cross(points[i], R.T @ planes[i, :3])])
            expected += planes[i, 7] * np.outer(h, h)
            weight += planes[i, 7]
        np.testing.assert_allclose(information[k], expected, rtol=1e-9, atol=1e-6)
        assert weights[k] == pytest.approx(weight)
    np.testing.assert_array_equal(information[4], 1.0)


def test_a_plane_knows_when_its_place_was_first_seen() -> None:
    rng = np.random.default_rng(5)
    floor = np.concatenate([rng.uniform(-2.0, 2.0, (20_000, 2)), np.zeros((20_000, 1))], axis=1)
    fine, coarse = VoxelMap(0.15, 8192, 100.0), VoxelMap(0.6, 8192, 100.0)
    for part in (floor[floor[:, 0] < 0.0], floor):
        fine.insert(np.ascontiguousarray(part), IDENTITY, 100.0)
    planes = _planes(np.array([[-1.0, 0.1, 0.0], [1.0, 0.1, 0.0]]), fine, coarse, IDENTITY)
    assert planes[:, 6].tolist() == [1.0, 2.0]
