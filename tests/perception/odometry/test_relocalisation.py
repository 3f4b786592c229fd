"""Searching for a place: in a room that has only one such corner, and in rows of pillars that look alike."""

import numpy as np

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.odometry.relocalisation import (
    CONFIRMATIONS,
    MOST_STARTS,
    Relocaliser,
    moved_to,
    shift_of,
    starting_points,
)
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import ERROR_SIZE, STATE_SIZE, NavigationState
from companion.perception.odometry.update import Correction, ScanMatcher
from companion.perception.odometry.voxel_map import VoxelMap

SCAN_NS = 100_000_000


def _room(rng: np.random.Generator, count: int) -> FloatArray:
    """Points on the faces of a room around the origin, and on a box that tells its corners apart."""
    half, centre = np.array([5.0, 4.0, 2.0]), np.array([3.0, 2.0, -1.0])
    points: FloatArray = rng.uniform(-1.0, 1.0, (count, 3)) * half
    axis = rng.integers(0, 3, count)
    rows = np.arange(count)
    points[rows, axis] = half[axis] * rng.choice([-1.0, 1.0], count)
    box = rows < count // 8
    points[box] = centre + rng.uniform(-0.8, 0.8, (int(box.sum()), 3))
    points[rows[box], axis[box]] = centre[axis[box]] + 0.8 * rng.choice([-1.0, 1.0], int(box.sum()))
    return points + rng.normal(0.0, 0.01, (count, 3))


def _rows(rng: np.random.Generator, count: int) -> FloatArray:
    """Points on a floor and on square pillars in rows, one metre apart, without end."""
    points: FloatArray = rng.uniform(-1.0, 1.0, (count, 3)) * [12.0, 12.0, 1.5]
    floor = rng.uniform(size=count) < 0.3
    points[floor, 2] = -1.5
    upright = ~floor
    base = np.round(points[upright, :2])
    face = rng.integers(0, 2, int(upright.sum()))
    side = rng.uniform(-0.15, 0.15, (int(upright.sum()), 2))
    side[np.arange(len(face)), face] = 0.15 * rng.choice([-1.0, 1.0], len(face))
    points[upright, :2] = base + side
    return points + rng.normal(0.0, 0.005, (count, 3))


def _state(t_ns: int, sigma_m: float, sigma: float = 0.05) -> NavigationState:
    vector = np.zeros(STATE_SIZE)
    vector[3:12] = np.eye(3).ravel()
    vector[23] = -9.81
    sigmas = (
        [sigma_m, sigma_m, 0.3 * sigma_m] + [sigma] * 3 + [0.2] * 3 + [1e-3] * 3 + [1e-2] * 3 + [1e-3] * 3
    )
    return NavigationState(t_ns, vector, np.diag(np.square(sigmas)))


def _relocaliser(points_map: FloatArray) -> Relocaliser:
    fine, coarse = VoxelMap(0.15, 65_536, 100.0), VoxelMap(0.6, 16_384, 100.0)
    pose = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    fine.insert(points_map, pose, 100.0)
    coarse.insert(points_map, pose, 100.0)
    return Relocaliser(ScanMatcher(OdometrySettings(), fine, coarse))


def _search(
    relocaliser: Relocaliser, world: FloatArray, p_true: FloatArray, yaw: float, sigma_m: float
) -> tuple[Correction | None, int]:
    """Offer scans taken at rest at a true place to a search that predicts the origin."""
    rng = np.random.default_rng(9)
    q_true = rotation.from_yaw(yaw)
    near = world[np.linalg.norm(world - p_true, axis=1) < 8.0]
    for count in range(1, 80):
        scan = rng.permutation(near)[:2500] + rng.normal(0.0, 0.01, (2500, 3))
        points = np.ascontiguousarray(rotation.rotate(rotation.conjugate(q_true), scan - p_true))
        predicted = _state(count * SCAN_NS, sigma_m)
        correction = relocaliser.consider(predicted, points, np.arange(2500))
        if correction is not None or relocaliser.hopeless:
            return correction, count
    return None, count


def test_a_place_a_metre_off_is_found_and_confirmed() -> None:
    world = _room(np.random.default_rng(1), 150_000)
    p_true = np.array([0.9, -0.7, 0.2])
    correction, scans = _search(_relocaliser(world), world, p_true, 0.1, 0.5)
    assert correction is not None
    np.testing.assert_allclose(correction.state.p_map, p_true, atol=0.02)
    assert scans > CONFIRMATIONS


def test_a_place_near_the_prediction_takes_one_scan_and_its_confirmations() -> None:
    world = _room(np.random.default_rng(1), 150_000)
    correction, scans = _search(_relocaliser(world), world, np.array([0.05, 0.0, 0.02]), 0.0, 0.05)
    assert correction is not None
    assert scans == 1 + CONFIRMATIONS


def test_rows_of_equal_pillars_are_refused() -> None:
    world = _rows(np.random.default_rng(2), 300_000)
    relocaliser = _relocaliser(world)
    correction, _ = _search(relocaliser, world, np.array([0.9, 0.1, 0.0]), 0.0, 0.6)
    assert correction is None
    assert "places match alike" in relocaliser.reason


def test_another_place_is_refused() -> None:
    rng = np.random.default_rng(3)
    relocaliser = _relocaliser(_room(rng, 150_000))
    elsewhere = rng.uniform(-6.0, 6.0, (60_000, 3))
    correction, _ = _search(relocaliser, elsewhere, np.zeros(3), 0.0, 0.4)
    assert correction is None
    assert relocaliser.reason == "no place matches"


def test_a_region_too_large_is_not_searched() -> None:
    world = _room(np.random.default_rng(1), 20_000)
    relocaliser = _relocaliser(world)
    correction, scans = _search(relocaliser, world, np.zeros(3), 0.0, 5.0)
    assert correction is None
    assert relocaliser.hopeless
    assert scans == 1


def test_starting_points_cover_the_region_the_likeliest_first() -> None:
    covariance = np.diag([0.36, 0.16, 0.0025] + [0.003] * 3 + [1e-2] * 12)
    starts = starting_points(covariance)
    assert 1 < len(starts) <= MOST_STARTS
    np.testing.assert_array_equal(starts[0].p_map, 0.0)
    places = np.array([start.p_map for start in starts])
    rng = np.random.default_rng(4)
    for p in rng.normal(size=(200, 3)) * [0.6, 0.4, 0.05]:
        if float(np.sum((p / [0.6, 0.4, 0.05]) ** 2)) < 6.0:
            assert float(np.abs(places - p).max(axis=1).min()) <= 0.31
    assert starting_points(np.eye(ERROR_SIZE) * 25.0) == []


def test_a_shifted_prediction_takes_its_velocity_along() -> None:
    predicted = _state(0, 0.5)
    predicted.covariance[0, 6] = predicted.covariance[6, 0] = 0.09  # 0.36 m/s for every metre
    shift = starting_points(np.diag([0.2, 0.2, 0.01] + [1e-4] * 15))[1]
    moved = moved_to(predicted, shift, 0.1, 0.01)
    np.testing.assert_allclose(moved.p_map, shift.p_map, atol=1e-9)
    np.testing.assert_allclose(moved.v_map, [0.36 * shift.p_map[0], 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diagonal(moved.covariance)[:6]), [0.1] * 3 + [0.01] * 3, atol=1e-6)
    assert float(np.linalg.eigvalsh(moved.covariance)[0]) > -1e-12
    correction = Correction(moved, True, 1, 1, 1, 0.0, 0.0, None, False, 1, 1, moved.vector, np.eye(6))
    back = shift_of(predicted, correction)
    np.testing.assert_allclose(back.p_map, shift.p_map, atol=1e-9)
