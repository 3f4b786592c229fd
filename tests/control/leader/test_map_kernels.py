import numpy as np
import pytest

from companion.control.leader import map_kernels
from tests.control.leader import oracles

CELL, LAYER, REACH, SELF = 0.2, 0.25, 2.0, 0.35
SHAPE = (32, 32, 8)


def cloud(rng: np.random.Generator, p: np.ndarray, count: int = 600) -> np.ndarray:
    points = (p + rng.normal(0.0, [1.2, 1.2, 0.5], (count, 3))).astype(np.float32)
    points[::50] = np.nan
    points[1] = np.inf
    return points


def window(p: np.ndarray) -> np.ndarray:
    cells = np.floor(p / np.array([CELL, CELL, LAYER])).astype(np.int64)
    return np.asarray(cells - np.array(SHAPE) // 2)


@pytest.mark.parametrize("seed", range(4))
def test_hits_and_their_places_equal_the_oracle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = rng.uniform(-50.0, 50.0, 3)
    points, first = cloud(rng, p), window(p)
    hits, sums = np.zeros(SHAPE, np.int8), np.zeros((*SHAPE[:2], 3), np.float32)
    floor_z = p[2] - 0.6
    map_kernels.mark_hits(points, p, first, CELL, LAYER, REACH, SELF, floor_z, hits, sums)
    expected_hits, expected_sums = oracles.hits_of(points, p, first, SHAPE, CELL, LAYER, REACH, SELF, floor_z)
    assert np.array_equal(hits, expected_hits)
    assert hits.max() == 3
    assert np.allclose(sums, expected_sums, atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_the_range_image_equals_the_oracle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = rng.uniform(-50.0, 50.0, 3)
    points = cloud(rng, p)
    image = np.zeros((24, 180), np.float32)
    map_kernels.draw_ranges(points, p, SELF, image)
    expected = oracles.ranges_of(points, p, SELF, 24, 180)
    assert np.allclose(image, expected, atol=1e-4)
    assert np.isfinite(image).sum() > 200


@pytest.mark.parametrize("seed", range(3))
def test_evidence_grows_and_fades_as_in_the_oracle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = rng.uniform(-50.0, 50.0, 3)
    first = window(p)
    evidence = (rng.integers(0, 121, SHAPE) * (rng.random(SHAPE) < 0.5)).astype(np.int16)
    hits = (rng.integers(1, 4, SHAPE) * (rng.random(SHAPE) < 0.1)).astype(np.int8)
    image = np.where(rng.random((24, 180)) < 0.3, np.inf, rng.uniform(0.5, 4.0, (24, 180))).astype(np.float32)
    expected = oracles.evidence_after(evidence, hits, image.astype(np.float64), p, first, CELL, LAYER, 120)
    map_kernels.update_evidence(evidence, hits, image, p, first, CELL, LAYER, 120)
    assert np.array_equal(evidence, expected)


@pytest.mark.parametrize("density", [0.0, 0.002, 0.05, 0.5])
def test_distances_equal_the_oracle(density: float) -> None:
    rng = np.random.default_rng(5)
    blocked = (rng.random((40, 40)) < density).astype(np.uint8)
    rows, distance = np.zeros((40, 40), np.int32), np.zeros((40, 40), np.float32)
    map_kernels.measure_distances(blocked, CELL, 15, rows, distance)
    assert np.allclose(distance, oracles.distances_of(blocked, CELL, 15), atol=1e-5)


def test_sliding_keeps_what_stays_inside_and_forgets_the_rest() -> None:
    rng = np.random.default_rng(1)
    old = np.array([-20, 7, -3], np.int64)
    evidence = rng.integers(1, 100, SHAPE).astype(np.int16)
    surface = np.ones((*SHAPE[:2], 2), np.float32)
    for shift in ([3, -5, 2], [0, 0, -1], [40, 0, 0], [-31, 31, 0]):
        new = old + np.array(shift)
        before, after = evidence.copy(), evidence.copy()
        map_kernels.slide_window(after, surface.copy(), old, new)
        for voxel in np.ndindex(*SHAPE):
            absolute = new + np.array(voxel)
            index = tuple(absolute % np.array(SHAPE))
            inside = bool(np.all(absolute >= old) and np.all(absolute < old + np.array(SHAPE)))
            assert after[index] == (before[index] if inside else 0)


def test_a_lone_spurious_voxel_blocks_no_column_but_a_supported_one_does() -> None:
    evidence = np.zeros(SHAPE, np.int16)
    first = np.array([-3, 11, -2], np.int64)
    blocked = np.zeros(SHAPE[:2], np.uint8)
    lone, supported = np.array([5, 20, 1]), np.array([12, 30, 2])
    evidence[tuple(lone % np.array(SHAPE))] = 30
    evidence[tuple(supported % np.array(SHAPE))] = 20
    evidence[tuple((supported + np.array([1, 0, 1])) % np.array(SHAPE))] = 20
    map_kernels.block_columns(evidence, first, 0, 3, blocked)
    assert np.argwhere(blocked).tolist() == [[15, 19], [16, 19]]
    map_kernels.block_columns(evidence, first, 4, 5, blocked)
    assert not blocked.any()


def test_the_place_the_vehicle_is_at_is_free() -> None:
    evidence = np.full(SHAPE, 50, np.int16)
    p = np.array([-3.21, 8.4, 1.5])
    map_kernels.forget_ball(evidence, p, window(p), CELL, LAYER, SELF)
    assert 10 < np.count_nonzero(evidence == 0) < 40
    assert evidence[tuple(np.floor(p / [CELL, CELL, LAYER]).astype(int) % np.array(SHAPE))] == 0


def test_a_column_remembers_where_its_returns_lie() -> None:
    surface = np.zeros((4, 4, 2), np.float32)
    sums = np.zeros((4, 4, 3), np.float32)
    sums[1, 2] = [0.3, -0.15, 5.0]
    sums[2, 2] = [0.08, 0.0, 1.0]
    map_kernels.update_surface(surface, sums)
    assert np.allclose(surface[1, 2], [0.06, -0.03])
    assert np.allclose(surface[2, 2], [0.04, 0.0])
    assert np.count_nonzero(surface) == 3
