import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.odometry import kernels
from companion.perception.odometry.inertial_history import InertialHistory, InertialStretch
from companion.perception.odometry.propagation import Propagation
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState

MS = 1_000_000
SETTINGS = OdometrySettings()


def _state(t_ns: int) -> NavigationState:
    vector = np.zeros(24)
    vector[3:12] = rotation.to_matrix(rotation.exp([0.1, -0.2, 0.3])).ravel()
    vector[15:21] = [0.01, 0.0, -0.01, 0.02, 0.03, -0.01]
    vector[21:24] = [0.0, 0.0, -9.81]
    return NavigationState(t_ns, vector, np.eye(18) * 1e-4)


def _history(rng: np.random.Generator, times_ms: list[int], suspect_ms: int = -1) -> InertialHistory:
    history = InertialHistory()
    for t_ms in times_ms:
        history.append(
            t_ms * MS,
            rng.normal(0.0, 0.01, 3),
            rng.normal([0.0, 0.0, 9.8], 0.5, 3),
            suspect=t_ms == suspect_ms,
        )
    return history


def _readable_noise(stretch: InertialStretch, shaking: FloatArray) -> FloatArray:
    """The squared densities of every interval, as `kernels.propagate` wants them."""
    noise = np.empty((len(stretch.inertial), 4))
    for k, dt in enumerate(np.diff(stretch.t_s)):
        noise[k] = np.square(
            [SETTINGS.gyro_noise, SETTINGS.accel_noise, SETTINGS.gyro_bias_walk, SETTINGS.accel_bias_walk]
        )
        noise[k, :2] = np.maximum(noise[k, :2], shaking)
        noise[k, 0] += (SETTINGS.gyro_scale_sigma * np.linalg.norm(stretch.inertial[k, :3])) ** 2 * 0.1 / 3.0
        if dt > 0.025:
            noise[k, :2] += np.square([SETTINGS.gap_rate_sigma, SETTINGS.gap_accel_sigma]) * dt
        if stretch.suspect[k]:
            noise[k, :2] += np.square([SETTINGS.saturated_rate_sigma, SETTINGS.saturated_accel_sigma]) * dt
    return noise


def _readable_shaking(stretch: InertialStretch) -> FloatArray:
    """Squared densities by the Hadamard variance of means of two samples."""
    x = stretch.inertial
    means = 0.5 * (x[:-1] + x[1:])
    third = means[:-4] - 2.0 * means[2:-2] + means[4:]
    dt = (stretch.t_s[-1] - stretch.t_s[0]) / len(x)
    variances = np.mean(third**2, axis=0) / 3.0
    return np.asarray(np.array([variances[:3].mean(), variances[3:].mean()]) * dt)


@pytest.mark.parametrize(("start_ms", "end_ms"), [(0, 100), (3, 101), (-20, 12), (96, 130), (31, 32)])
def test_a_way_through_the_history_agrees_with_its_readable_stretch(start_ms: int, end_ms: int) -> None:
    history = _history(np.random.default_rng(0), [5 * k for k in range(24) if not 8 <= k < 16], 85)
    propagation = Propagation(SETTINGS)
    state, expected = _state(start_ms * MS), _state(start_ms * MS)
    propagation.advance(state, history, end_ms * MS, 2 * MS)
    stretch = history.between(start_ms * MS, end_ms * MS, 2 * MS)
    shaking = _readable_shaking(stretch) if len(stretch.inertial) >= 12 else np.zeros(2)
    segments = np.zeros_like(propagation.segments)
    kernels.propagate(
        expected.vector,
        expected.covariance,
        stretch.t_s,
        stretch.inertial,
        _readable_noise(stretch, shaking),
        segments,
    )
    assert state.t_ns == end_ms * MS
    assert propagation.count == len(stretch.t_s)
    np.testing.assert_allclose(state.vector, expected.vector, atol=1e-12)
    np.testing.assert_allclose(state.covariance, expected.covariance, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(propagation.segments, segments, atol=1e-12)


def test_what_came_too_late_for_a_scan_is_what_the_last_third_of_its_way_added() -> None:
    history = _history(np.random.default_rng(2), [5 * k for k in range(30)])
    propagation, state = Propagation(SETTINGS), _state(20 * MS)
    propagation.advance(state, history, 120 * MS, 20 * MS)
    offsets_ns = np.linspace(0, 100 * MS, 1001).astype(np.int32)
    view = propagation.view(state, history, 100 * MS, offsets_ns)
    assert view.lag_s == pytest.approx(0.05)
    # White noise of the rate: a third of the variance that the whole way added to the attitude.
    whole = float(np.trace(state.covariance[3:6, 3:6])) - 3e-4 - 3e-4 * 0.1**2
    assert float(np.trace(view.unseen[3:6, 3:6])) == pytest.approx(whole / 3.0, rel=0.02)
    assert float(np.linalg.eigvalsh(state.covariance - view.unseen)[0]) > 0.0


def _after(state: NavigationState, v_step: float, taken: float) -> NavigationState:
    corrected = state.copy()
    corrected.v_map[0] += v_step
    corrected.covariance[6:9, 6:9] -= np.eye(3) * taken / 3.0
    return corrected


@pytest.mark.parametrize(("factor", "expected"), [(1.0, 1.0), (3.0, 9.0), (0.1, 0.4)])
def test_noise_grows_and_shrinks_until_it_explains_what_scans_correct(factor: float, expected: float) -> None:
    propagation, state = Propagation(SETTINGS), _state(0)
    for _ in range(300):
        propagation.learn(state, _after(state, factor * 0.005, 0.005**2))
    assert propagation.excess[1] == pytest.approx(expected, rel=0.02)


def test_noise_grows_within_a_second_and_shrinks_over_several() -> None:
    propagation, state = Propagation(SETTINGS), _state(0)
    for _ in range(10):
        propagation.learn(state, _after(state, 4.0 * 0.005, 0.005**2))
    assert propagation.excess[1] > 8.0
    for _ in range(10):
        propagation.learn(state, _after(state, 0.5 * 0.005, 0.005**2))
    assert propagation.excess[1] > 2.0


def test_no_time_moves_nothing() -> None:
    state = _state(50 * MS)
    before = state.copy()
    Propagation(SETTINGS).advance(state, _history(np.random.default_rng(0), [0, 5, 60]), 50 * MS, 0)
    np.testing.assert_array_equal(state.vector, before.vector)


def _shaking(inertial: FloatArray) -> FloatArray:
    shaking = np.zeros(2)
    kernels.vibration(inertial, 0, len(inertial), 0.005, shaking)
    return shaking


def test_vibration_shows_its_density_and_steady_motion_does_not() -> None:
    rng = np.random.default_rng(1)
    white = rng.normal(0.0, 1.0, (4000, 6)) * ([0.01] * 3 + [0.5] * 3)
    np.testing.assert_allclose(_shaking(white), np.array([0.01**2, 0.5**2]) * 0.005, rtol=0.1)
    motion = np.linspace(0.0, 3.0, 4000)[:, None] * np.ones(6)
    np.testing.assert_allclose(_shaking(motion), 0.0, atol=1e-12)


def test_a_rotor_that_turns_near_half_the_sampling_rate_is_averaged_out_and_hardly_counts() -> None:
    tone = np.sin(2.0 * np.pi * 95.0 * 0.005 * np.arange(4000))[:, None] * np.ones(6)
    assert float(_shaking(tone)[1]) < 0.03 * 0.5 * 0.005
