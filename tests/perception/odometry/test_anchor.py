import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.odometry.anchor import MOST_PERIODS, Anchor, observed_part, twist_of_pose
from companion.perception.odometry.degeneracy import keep_observed
from companion.perception.odometry.state import NavigationState
from companion.perception.odometry.update import Correction

SIGMAS = np.array([1e-3] * 3 + [1e-4] * 3)
GAIN = np.diag(SIGMAS**2)
INFORMATION = np.diag(1.0 / SIGMAS**2)


def _state(p_map: tuple[float, float, float] = (0.0, 0.0, 0.0), yaw: float = 0.0) -> NavigationState:
    vector = np.zeros(24)
    vector[0:3] = p_map
    vector[3:12] = rotation.to_matrix(rotation.from_yaw(yaw)).ravel()
    vector[23] = -9.81
    covariance = np.zeros((18, 18))
    covariance[:6, :6] = np.diag(SIGMAS**2)
    return NavigationState(0, vector, covariance)


def _correction(
    state: NavigationState, information: FloatArray = INFORMATION, rms: float = 1.0
) -> Correction:
    _, _, observability = keep_observed(information, np.zeros(6), 100.0, 100.0, 0.0)
    return Correction(state, True, 100, 100, 100, 0.01, rms, observability, False, 1, 1, state.vector, GAIN)


def _settled(correlation: float) -> Anchor:
    """An anchor that has seen residuals scatter as assumed for so long that its factor is settled."""
    anchor = Anchor(correlation)
    anchor.correlation = correlation
    return anchor


def _match(anchor: Anchor, shares: dict[int, float], state: NavigationState, birth: int) -> None:
    """Let a scan match ground of some periods, by share; a strong scan that decides the pose alone."""
    anchor.information[:] = 0.0
    anchor.weights[:] = 0.0
    for index, share in shares.items():
        anchor.information[index] = share * INFORMATION
        anchor.weights[index] = share
    anchor.follow(_correction(state), birth)


def _sigma_m(anchor: Anchor) -> float:
    return float(np.sqrt(np.trace(anchor.covariance[:3, :3])))


def test_ground_seen_from_the_start_stays_as_certain_as_the_start() -> None:
    anchor = _settled(1.0)
    for birth in range(2, 200):
        _match(anchor, {0: 1.0}, _state(), birth)
    np.testing.assert_array_equal(anchor.covariance, 0.0)


def test_every_new_stretch_adds_one_more_matching_error() -> None:
    anchor = _settled(2.0)
    _match(anchor, {0: 1.0}, _state(), 2)
    for stretch in range(1, 11):
        _match(anchor, {stretch: 1.0}, _state(), stretch + 2)
        np.testing.assert_allclose(np.diag(anchor.covariance)[:3], 2.0 * stretch * SIGMAS[:3] ** 2)


def test_residuals_that_scatter_more_make_every_match_less_certain() -> None:
    anchor = Anchor(4.0)
    quiet = anchor.correlation
    for rms, expected in ((0.3, quiet), (1.5, 4.0 * 1.5**2)):
        for _ in range(100):
            anchor.information[0], anchor.weights[0] = INFORMATION, 1.0
            anchor.follow(_correction(_state(), rms=rms), 2)
        assert anchor.correlation == pytest.approx(expected, rel=1e-3)


def test_coming_back_to_the_start_takes_the_sum_away() -> None:
    anchor = _settled(1.0)
    _match(anchor, {0: 1.0}, _state(), 2)
    for stretch in range(1, 11):
        _match(anchor, {stretch: 1.0}, _state(), stretch + 2)
    assert _sigma_m(anchor) > 5e-3
    _match(anchor, {0: 1.0}, _state(), 20)
    np.testing.assert_allclose(anchor.covariance, 0.0, atol=1e-12)


def test_an_uncertain_heading_weighs_with_the_distance_from_where_it_arose() -> None:
    anchor = _settled(1.0)
    _match(anchor, {0: 1.0}, _state((0.0, 0.0, 0.0)), 2)
    _match(anchor, {1: 1.0}, _state((100.0, 0.0, 0.0), yaw=1.0), 3)
    x = np.array([100.0, 0.0, 0.0])
    place = np.hstack([np.eye(3), -np.cross(np.eye(3), x).T])  # rho + phi cross x
    spread = place @ anchor.covariance @ place.T
    assert float(np.sqrt(spread[1, 1])) == pytest.approx(np.hypot(1e-3, 100.0 * 1e-4), rel=1e-6)
    assert float(np.sqrt(spread[0, 0])) == pytest.approx(1e-3, rel=1e-6)


def test_a_weak_scan_moves_only_part_of_the_way_to_the_ground_it_matches() -> None:
    anchor = _settled(1.0)
    _match(anchor, {0: 1.0}, _state(), 2)
    anchor.information[:] = 0.0
    anchor.weights[:] = 0.0
    anchor.information[1], anchor.weights[1] = 0.25 * INFORMATION, 1.0
    anchor.follow(_correction(_state()), 3)
    np.testing.assert_allclose(np.diag(anchor.covariance)[:3], 0.25**2 * SIGMAS[:3] ** 2)


def test_what_is_not_observed_inherits_nothing() -> None:
    information = INFORMATION.copy()
    information[0, 0] = 0.0
    _, _, observability = keep_observed(information, np.zeros(6), 1e6, 1e8, 0.004)
    part = observed_part(observability)
    np.testing.assert_allclose(part @ np.ones(6), [0.0, 1.0, 1.0, 1.0, 1.0, 1.0], atol=1e-12)
    np.testing.assert_array_equal(observed_part(None), np.eye(6))


def test_gravity_becomes_less_certain_as_the_map_tilts() -> None:
    anchor = _settled(1.0)
    _match(anchor, {0: 1.0}, _state(), 2)
    state = _state()
    _match(anchor, {1: 1.0}, state, 3)
    np.testing.assert_allclose(np.diag(state.covariance)[15:], [(9.81e-4) ** 2, (9.81e-4) ** 2, 0.0])


def test_the_number_of_periods_is_bounded_and_the_start_is_never_given_up() -> None:
    anchor = _settled(1.0)
    rng = np.random.default_rng(0)
    _match(anchor, {0: 1.0}, _state(), 2)
    for birth in range(3, 400):
        newest = anchor.periods - 1
        _match(anchor, {newest: 0.6, int(rng.integers(0, newest + 1)): 0.4}, _state(), birth)
        assert anchor.periods <= MOST_PERIODS
        starts = anchor.starts[: anchor.periods]
        assert starts[0] == 0
        assert np.all(np.diff(starts) > 0)
    values = np.linalg.eigvalsh(anchor.covariance)
    assert values[0] > -1e-12
    _match(anchor, {0: 1.0}, _state(), 500)
    np.testing.assert_allclose(anchor.covariance, 0.0, atol=1e-12)


def test_after_a_restart_the_present_pose_is_the_origin() -> None:
    anchor = _settled(1.0)
    _match(anchor, {0: 1.0}, _state(), 2)
    _match(anchor, {1: 1.0}, _state(), 3)
    anchor.restart()
    assert anchor.periods == 1
    np.testing.assert_array_equal(anchor.covariance, 0.0)


def test_errors_of_a_pose_and_twists_of_the_map_displace_points_alike() -> None:
    rng = np.random.default_rng(1)
    state = _state((3.0, -2.0, 1.0), yaw=0.8)
    error = rng.normal(0.0, 1e-5, 6)
    x_imu = rng.normal(0.0, 5.0, 3)
    twist = twist_of_pose(state.vector) @ error
    turned = rotation.rotate(rotation.exp(error[3:]), x_imu)
    moved = state.p_map + error[:3] + state.R_map_imu @ turned
    before = state.p_map + state.R_map_imu @ x_imu
    np.testing.assert_allclose(moved - before, twist[:3] + np.cross(twist[3:], before), atol=1e-8)
