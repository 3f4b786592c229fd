import numpy as np

from companion.perception.odometry.bias_monitor import BiasMonitor
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import ERROR_SIZE, STATE_SIZE, NavigationState


def _state(t_s: float, gyro: float, accel: float, sigma_accel: float = 0.02) -> NavigationState:
    vector = np.zeros(STATE_SIZE)
    vector[15], vector[20] = gyro, accel
    covariance = np.eye(ERROR_SIZE) * 1e-7
    covariance[12:15, 12:15] = np.eye(3) * sigma_accel**2
    return NavigationState(round(t_s * 1e9), vector, covariance)


def _told(states: list[NavigationState]) -> list[str]:
    monitor = BiasMonitor(OdometrySettings())
    return [monitor.observe(state) for state in states]


def test_biases_that_settle_are_healthy() -> None:
    states = [_state(0.1 * i, 0.004 + 0.001 * np.exp(-0.05 * i), 0.05 * np.exp(-0.1 * i)) for i in range(200)]
    assert set(_told(states)) == {""}


def test_a_bias_that_no_chip_has_is_told() -> None:
    assert _told([_state(0.0, 0.2, 0.0)]) == ["gyro bias runs away: 0.200 rad/s"]
    assert _told([_state(0.0, 0.0, -1.5)]) == ["accelerometer bias runs away: 1.50 m/s^2"]


def test_a_bias_that_moves_faster_than_it_can_drift_is_told() -> None:
    states = [_state(0.1 * i, 0.0, 0.0 if i < 50 else 0.4) for i in range(60)]
    told = _told(states)
    assert told[49] == ""
    assert told[50] == "accelerometer bias moved by 0.400 m/s^2 in 5 s"


def test_a_bias_that_was_uncertain_may_be_found_out() -> None:
    states = [_state(0.1 * i, 0.0, 0.0 if i < 3 else 0.4, sigma_accel=0.1) for i in range(10)]
    assert set(_told(states)) == {""}


def test_a_clock_that_jumps_moves_the_memory_along() -> None:
    monitor = BiasMonitor(OdometrySettings())
    for i in range(30):
        monitor.observe(_state(0.1 * i, 0.0, 0.0))
    monitor.relabel(90_000_000_000)
    assert monitor.observe(_state(93.0, 0.0, 0.0)) == ""
    assert monitor.observe(_state(93.1, 0.03, 0.0)) == "gyro bias moved by 0.030 rad/s in 3 s"
