import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray, LidarScan
from companion.perception.odometry.preprocessing import Thinning, nearest_first, usable_points
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState
from companion.perception.odometry.update import ScanMatcher
from companion.perception.odometry.voxel_map import VoxelMap

SETTINGS = OdometrySettings()


def _room_points(rng: np.random.Generator, count: int, sigma_m: float = 0.02) -> FloatArray:
    """Points on the six inner faces of a 10 m x 8 m x 4 m room around the origin."""
    half = np.array([5.0, 4.0, 2.0])
    points: FloatArray = rng.uniform(-1.0, 1.0, (count, 3)) * half
    axis = rng.integers(0, 3, count)
    rows = np.arange(count)
    points[rows, axis] = half[axis] * rng.choice([-1.0, 1.0], count) + rng.normal(0.0, sigma_m, count)
    return points


def _corridor_points(rng: np.random.Generator, count: int) -> FloatArray:
    """Points on floor and walls of a corridor along x without ends."""
    points: FloatArray = rng.uniform(-1.0, 1.0, (count, 3)) * [15.0, 1.5, 1.5]
    axis = rng.integers(1, 3, count)
    points[np.arange(count), axis] = 1.5 * rng.choice([-1.0, 1.0], count) + rng.normal(0.0, 0.02, count)
    return points


def _state(sigma_p: float, sigma_theta: float) -> NavigationState:
    vector = np.zeros(24)
    vector[3:12] = np.eye(3).ravel()
    vector[23] = -9.81
    sigmas = [sigma_p] * 3 + [sigma_theta] * 3 + [0.1] * 3 + [1e-3] * 3 + [1e-2] * 3 + [1e-3] * 3
    return NavigationState(0, vector, np.diag(np.square(sigmas)))


def _matcher(points_map: FloatArray) -> ScanMatcher:
    fine, coarse = VoxelMap(0.2, 16_384, 100.0), VoxelMap(0.6, 8192, 100.0)
    pose = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    fine.insert(points_map, pose, 100.0)
    coarse.insert(points_map, pose, 100.0)
    return ScanMatcher(SETTINGS, fine, coarse)


@pytest.mark.parametrize("distance_m", [0.01, 0.05, 0.3])
def test_a_displaced_scan_pulls_the_state_to_where_it_was_taken(distance_m: float) -> None:
    rng = np.random.default_rng(1)
    matcher = _matcher(_room_points(rng, 60_000))
    p_true = distance_m * np.array([0.6, -0.64, 0.48])
    q_true = rotation.exp(np.radians([0.5, -0.3, 1.0]))
    scan_imu = rotation.rotate(rotation.conjugate(q_true), _room_points(rng, 3000) - p_true)
    correction = matcher.correct(_state(distance_m, 0.02), np.ascontiguousarray(scan_imu), np.arange(3000))
    assert correction.accepted
    np.testing.assert_allclose(correction.state.p_map, p_true, atol=0.004)
    angle = rotation.angle_between(rotation.from_matrix(correction.state.R_map_imu), q_true)
    assert float(np.degrees(angle)) < 0.1
    covariance = correction.state.covariance
    assert float(np.linalg.eigvalsh(covariance)[0]) > -1e-12
    assert float(np.sqrt(covariance[0, 0])) < 0.004


def test_a_prediction_that_is_sure_of_a_wrong_place_is_found_out_and_searched_widely() -> None:
    rng = np.random.default_rng(2)
    matcher = _matcher(_room_points(rng, 60_000))
    p_true = np.array([0.25, -0.2, 0.1])
    correction = matcher.correct(_state(0.002, 1e-4), _room_points(rng, 3000) - p_true, np.arange(3000))
    assert correction.accepted
    assert correction.wide
    np.testing.assert_allclose(correction.state.p_map, p_true, atol=0.01)


def test_a_scan_of_another_place_is_refused_and_changes_nothing() -> None:
    rng = np.random.default_rng(3)
    matcher = _matcher(_room_points(rng, 60_000))
    predicted = _state(0.01, 0.001)
    noise = rng.uniform(-4.0, 4.0, (3000, 3))
    correction = matcher.correct(predicted, noise, np.arange(3000))
    assert not correction.accepted
    assert correction.state is predicted


def test_too_few_points_are_refused() -> None:
    rng = np.random.default_rng(4)
    matcher = _matcher(_room_points(rng, 60_000))
    correction = matcher.correct(_state(0.01, 0.001), _room_points(rng, 20), np.arange(20))
    assert not correction.accepted
    assert correction.observability is None


def test_along_a_corridor_the_state_keeps_its_prediction_and_its_uncertainty() -> None:
    rng = np.random.default_rng(5)
    matcher = _matcher(_corridor_points(rng, 60_000))
    scan = _corridor_points(rng, 3000) - [0.0, 0.02, -0.01]
    correction = matcher.correct(_state(0.05, 0.002), scan, np.arange(3000))
    assert correction.accepted
    assert correction.observability is not None
    assert correction.observability.degenerate == 1
    assert abs(float(correction.state.p_map[0])) < 1e-3
    np.testing.assert_allclose(correction.state.p_map[1:], [0.02, -0.01], atol=0.003)
    assert float(np.sqrt(correction.state.covariance[0, 0])) > 0.045
    assert float(np.sqrt(correction.state.covariance[1, 1])) < 0.005


def _scan(points: FloatArray, tags: list[int]) -> LidarScan:
    n = len(points)
    return LidarScan(
        0, 0, 0, 100_000_000, 0, points.astype(np.float32), np.arange(n, dtype=np.int32),
        np.arange(n).astype(np.uint8), np.array(tags, np.uint8), 1, 1,
    )  # fmt: skip


def test_only_finite_confident_points_in_range_are_used() -> None:
    points = np.array(
        [[1.0, 0, 0], [np.nan, 0, 0], [0.1, 0, 0], [0, 90.0, 0], [0, 2.0, 0], [0, 3.0, 0], [0, 4.0, 0]]
    )
    scan = _scan(points, [0x00, 0x00, 0x00, 0x00, 0x10, 0x20, 0x30])
    used, offsets_ns, reflectivity = usable_points(scan, SETTINGS)
    np.testing.assert_array_equal(used, points[[0, 4]].astype(np.float32))
    assert offsets_ns.tolist() == [0, 4]
    assert reflectivity.tolist() == [0, 4]
    everything = usable_points(scan, SETTINGS.model_copy(update={"ignore_uncertain_points": False}))
    assert len(everything[0]) == 4


def test_the_thinning_cell_settles_at_the_wanted_number_of_points() -> None:
    rng = np.random.default_rng(7)
    thinning = Thinning(SETTINGS)
    count = 0
    for _ in range(30):
        count = len(thinning.choose(_room_points(rng, 18_000)))
    assert abs(count - SETTINGS.matched_points) < 0.15 * SETTINGS.matched_points


def test_thinned_scans_keep_the_nearest_half_of_the_quota() -> None:
    points = np.random.default_rng(8).normal(0.0, 5.0, (500, 3))
    kept = nearest_first(points, 100)
    assert isinstance(kept, np.ndarray)
    assert len(np.unique(kept)) == 100
    assert set(np.argsort(np.linalg.norm(points, axis=1))[:50].tolist()) <= set(kept.tolist())
    assert nearest_first(points, 500) == slice(None)
