import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.odometry import kernels
from companion.perception.odometry.innovation_monitor import InnovationMonitor, is_jump
from companion.perception.odometry.innovation_monitor_kernels import RESULT_SIZE, innovate
from companion.perception.odometry.state import ERROR_SIZE, STATE_SIZE, NavigationState

SIGMA_M, SIGMA = 0.004, 5e-4


def _state() -> NavigationState:
    vector = np.zeros(STATE_SIZE)
    vector[3:12] = rotation.to_matrix(rotation.exp([0.2, -0.1, 0.9])).ravel()
    vector[21:24] = [0.0, 0.0, -9.81]
    covariance = np.diag([SIGMA_M**2] * 3 + [SIGMA**2] * 3 + [1e-4] * (ERROR_SIZE - 6))
    return NavigationState(0, vector, covariance)


def _way(shaking: float = 0.0, rate: float = 0.0, every: int = 1) -> FloatArray:
    """A scan's 20 intervals in hover with a given standard deviation of the acceleration."""
    rng = np.random.default_rng(2)
    way = np.zeros((21, kernels.SEGMENT_WIDTH))
    way[:, 0] = 5e-3 * np.arange(21)
    way[:, 16:19] = rng.normal(0.0, 1.0, (21, 3)) * shaking
    way[:, 21] = rate
    return way[::every]


def _corrected(error: FloatArray) -> NavigationState:
    full = np.zeros(ERROR_SIZE)
    full[:6] = error
    return _state().plus(full)


def test_corrections_as_large_as_predicted_are_quiet() -> None:
    monitor = InnovationMonitor()
    rng = np.random.default_rng(5)
    sigmas = np.array([SIGMA_M] * 3 + [SIGMA] * 3)
    # A correction is never larger than the prediction is uncertain; half of it in a sharp match.
    for _ in range(500):
        assert monitor.observe(_state(), _corrected(0.5 * sigmas * rng.normal(size=6)), _way(0.6)) == ""


@pytest.mark.parametrize(("axis", "told"), [(0, "position by 4 cm"), (5, "rotation by 2.3 deg")])
def test_one_large_correction_is_told_by_what_contradicts(axis: int, told: str) -> None:
    monitor = InnovationMonitor()
    error = np.zeros(6)
    error[axis] = 0.04
    assert monitor.observe(_state(), _corrected(error), _way()) == f"scan contradicts the IMU: {told}"


def test_a_small_contradiction_that_stays_adds_up() -> None:
    monitor = InnovationMonitor()
    error = np.array([0.0115, 0.0, 0.0, 0.0, 0.0, 0.0])
    told = [monitor.observe(_state(), _corrected(error), _way()) for _ in range(3)]
    assert told[:2] == ["", ""]
    assert told[2] != ""
    assert monitor.windowed == pytest.approx(np.sqrt(3.0) * monitor.newest)


def test_contradictions_that_alternate_do_not_add_up() -> None:
    monitor = InnovationMonitor()
    for i in range(10):
        error = np.array([0.0115 * (-1) ** i, 0.0, 0.0, 0.0, 0.0, 0.0])
        assert monitor.observe(_state(), _corrected(error), _way()) == ""


def _unmodelled(way: FloatArray) -> tuple[float, float]:
    """What position and rotation may be off by beyond the filter's covariance."""
    result = np.zeros(RESULT_SIZE)
    innovate(_state().vector, _state().vector, _state().covariance, way, result)
    return float(result[8]), float(result[9])


def test_the_kernel_whitens_as_its_readable_form() -> None:
    rng = np.random.default_rng(11)
    root = rng.normal(size=(ERROR_SIZE, ERROR_SIZE)) * 1e-3
    predicted = _state()
    predicted.covariance[:] = root @ root.T + np.eye(ERROR_SIZE) * 1e-6
    for scale in (1e-3, 0.05, 1.5):
        e = rng.normal(size=6) * scale
        result = np.zeros(RESULT_SIZE)
        way = _way(1.7, rate=0.4)
        innovate(predicted.vector, _corrected(e).vector, predicted.covariance, way, result)
        steps = np.diff(way[:-1, 16:22], axis=0)
        shaking = np.sqrt(0.5 * np.mean(steps**2, axis=0))
        position_m = 0.002 + (0.2 * shaking[:3].max() + 1.5 * (shaking[:3].max() - 1.0)) * 0.01
        angle = 3.5e-4 + 0.2 * shaking[3:].max() * 0.1 + 0.005 * 0.04
        S = predicted.covariance[:6, :6] + np.diag([position_m**2] * 3 + [angle**2] * 3)
        np.testing.assert_allclose(result[:6], np.linalg.solve(np.linalg.cholesky(S), e), rtol=1e-6)
        np.testing.assert_allclose(result[6:8], [np.linalg.norm(e[:3]), np.linalg.norm(e[3:])], rtol=1e-6)
        np.testing.assert_allclose(result[8:], [position_m, angle], rtol=1e-9)


def test_more_is_allowed_while_the_chip_is_shaken_turns_fast_or_loses_samples() -> None:
    calm_m, calm = _unmodelled(_way(0.5))
    assert _unmodelled(_way(3.0))[0] > calm_m + 0.01
    assert _unmodelled(_way(0.5, rate=1.6))[1] == pytest.approx(calm + 0.005 * 0.16, rel=0.05)
    gappy = np.delete(_way(0.5), [4, 9, 14], axis=0)
    assert _unmodelled(gappy)[0] > calm_m


def test_only_a_far_unexpected_move_is_a_jump() -> None:
    near, far = np.array([0.05, 0, 0, 0, 0, 0]), np.array([0.15, 0, 0, 0, 0, 0])
    assert not is_jump(_state(), _corrected(near))
    assert is_jump(_state(), _corrected(far))
    assert is_jump(_state(), _corrected(np.array([0, 0, 0, 0, 0.06, 0])))
    monitor = InnovationMonitor()
    monitor.observe(_state(), _corrected(far), _way())
    assert monitor.jumped
    uncertain = _state()
    uncertain.covariance[:3, :3] = np.eye(3) * 0.2**2
    monitor.forget()
    assert monitor.observe(uncertain, _corrected(far), _way()) == ""
    assert not monitor.jumped
