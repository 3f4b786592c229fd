"""The compiled update against one that is written with full matrices."""

from collections.abc import Callable

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.odometry import registration_kernels as kernels
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState
from companion.perception.odometry.update import ScanMatcher, View
from companion.perception.odometry.voxel_map import VoxelMap
from tests.perception.odometry import registration_oracle as oracle

SETTINGS = OdometrySettings()
Surface = Callable[[np.random.Generator, int], FloatArray]


def room(rng: np.random.Generator, count: int) -> FloatArray:
    half = np.array([5.0, 4.0, 2.0])
    points: FloatArray = rng.uniform(-1.0, 1.0, (count, 3)) * half
    axis, rows = rng.integers(0, 3, count), np.arange(count)
    points[rows, axis] = half[axis] * rng.choice([-1.0, 1.0], count) + rng.normal(0.0, 0.01, count)
    return points


def corridor(rng: np.random.Generator, count: int) -> FloatArray:
    points: FloatArray = rng.uniform(-1.0, 1.0, (count, 3)) * [15.0, 1.5, 1.5]
    axis = rng.integers(1, 3, count)
    points[np.arange(count), axis] = 1.5 * rng.choice([-1.0, 1.0], count) + rng.normal(0.0, 0.01, count)
    return points


def prediction(rng: np.random.Generator, sigma_p: float, sigma_theta: float) -> NavigationState:
    """A state at the origin with a full covariance, as a filter would have it."""
    vector = np.zeros(24)
    vector[3:12] = rotation.to_matrix(rotation.exp([0.02, -0.01, 0.3])).ravel()
    vector[23] = -9.81
    sigmas = np.array([sigma_p] * 3 + [sigma_theta] * 3 + [0.1] * 3 + [1e-3] * 3 + [1e-2] * 3 + [1e-3] * 3)
    root = np.eye(18) + 0.2 * rng.normal(size=(18, 18))
    return NavigationState(0, vector, np.outer(sigmas, sigmas) * (root @ root.T))


@pytest.mark.parametrize("lag_s", [0.0, 0.05])
@pytest.mark.parametrize(
    ("surface", "sigma_p", "sigma_theta"),
    [(room, 0.02, 1e-3), (room, 0.3, 0.02), (corridor, 0.05, 2e-3), (corridor, 0.4, 0.03)],
    ids=["near", "far off, coarse planes first", "unobserved along", "unobserved along, far off"],
)
def test_the_compiled_update_equals_the_one_with_full_matrices(
    surface: Surface, sigma_p: float, sigma_theta: float, lag_s: float
) -> None:
    rng = np.random.default_rng(4)
    fine, coarse = VoxelMap(SETTINGS.fine_cell_m, 16_384, 100.0), VoxelMap(0.6, 8192, 100.0)
    pose = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    for cells in (fine, coarse):
        cells.insert(surface(rng, 60_000), pose, 100.0)
    predicted = prediction(rng, sigma_p, sigma_theta)
    offset = sigma_p * np.array([0.5, -0.6, 0.4])
    scan = np.ascontiguousarray((surface(rng, 1500) - offset) @ predicted.R_map_imu)
    chosen = np.arange(1500)
    # A tenth of the prediction's own covariance stands for what came too late.
    view = View(lag_s, 2.0 * lag_s * predicted.covariance)
    expected = oracle.register(predicted, scan, chosen, fine, coarse, SETTINGS, view)
    found = ScanMatcher(SETTINGS, fine, coarse).correct(predicted, scan, chosen, view)
    assert expected.accepted
    assert found.accepted
    assert (found.matched, found.iterations) == (expected.matched, expected.iterations)
    assert found.searches == expected.searches
    assert found.observability is not None
    np.testing.assert_allclose(found.observability.shares, expected.shares, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(found.state.vector, expected.state.vector, atol=1e-9)
    np.testing.assert_allclose(found.state.covariance, expected.state.covariance, atol=1e-10)
    np.testing.assert_allclose(found.seen[:12], expected.seen[:12], atol=1e-9)
    np.testing.assert_allclose(found.gain, expected.gain, atol=1e-10)


def test_a_scan_that_was_deskewed_with_a_wrong_velocity_corrects_the_velocity() -> None:
    rng = np.random.default_rng(5)
    fine, coarse = VoxelMap(SETTINGS.fine_cell_m, 16_384, 100.0), VoxelMap(0.6, 8192, 100.0)
    pose = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    for cells in (fine, coarse):
        cells.insert(room(rng, 60_000), pose, 100.0)
    vector = np.zeros(24)
    vector[3:12] = np.eye(3).ravel()
    vector[23] = -9.81
    # The true velocity is zero; 0.4 m/s are believed, for the 0.1 s since the last scan.
    believed = np.array([0.4, 0.0, 0.0])
    vector[0:3], vector[12:15] = 0.1 * believed, believed
    covariance = np.diag([1e-6] * 3 + [1e-8] * 3 + [0.25] * 3 + [1e-8] * 9)
    covariance[0:3, 0:3] += 0.01 * covariance[6:9, 6:9]
    covariance[0:3, 6:9] = covariance[6:9, 0:3] = 0.1 * covariance[6:9, 6:9]
    predicted = NavigationState(0, vector, covariance)
    age_s = rng.uniform(0.0, 0.1, 2500)
    # De-skewing moves each point by what the vehicle is believed to have gone since.
    scan = room(rng, 2500) - age_s[:, None] * believed
    matcher = ScanMatcher(SETTINGS, fine, coarse)
    found = matcher.correct(predicted, scan, np.arange(2500), View(float(age_s.mean()), np.zeros((18, 18))))
    late = matcher.correct(predicted, scan, np.arange(2500))
    assert found.accepted
    assert float(np.linalg.norm(found.state.v_map)) < 0.03
    assert float(np.linalg.norm(found.state.p_map)) < 0.004
    assert float(np.linalg.norm(late.state.p_map)) > 0.015
    # The points lie on the map where they were seen, half a way behind what was believed of the end.
    np.testing.assert_allclose(found.seen[:3], 0.05 * believed, atol=0.004)


def test_well_observed_equations_pass_unchanged() -> None:
    root = np.random.default_rng(6).normal(size=(6, 6))
    A, b = root @ root.T + np.eye(6), np.arange(6.0)
    kept_A, kept_b, shares = A.copy(), b.copy(), np.zeros(6)
    kernels.keep_observed(kept_A, kept_b, 1.0, 10.0, 1e-6, shares, np.zeros((6, 6)))
    assert np.array_equal(kept_A, A)
    assert np.array_equal(kept_b, b)
    assert shares.min() > 1e-6


def test_an_unobserved_direction_loses_information_and_gradient() -> None:
    A, b = np.diag([100.0, 80.0, 0.01, 300.0, 200.0, 250.0]), np.ones(6)
    shares, directions = np.zeros(6), np.zeros((6, 6))
    kernels.keep_observed(A, b, np.sqrt(2.5), 100.0, 0.004, shares, directions)
    assert np.count_nonzero(shares < 0.004) == 1
    assert abs(directions[2, 0]) == pytest.approx(1.0)
    np.testing.assert_allclose(A, np.diag([100.0, 80.0, 0.0, 300.0, 200.0, 250.0]), atol=1e-9)
    np.testing.assert_allclose(b, [1.0, 1.0, 0.0, 1.0, 1.0, 1.0], atol=1e-12)
