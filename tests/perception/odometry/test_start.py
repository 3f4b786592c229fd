import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, ImuSample
from companion.perception.odometry.initialisation import Initialisation, StaticInitialiser
from companion.perception.odometry.settings import OdometrySettings

SETTINGS = OdometrySettings()
T_IMU_BODY = Pose.of([-0.06, -0.02, -0.03], rotation.exp([0.0, 0.0, 0.4]))


def _feed(gyro: FloatArray, accel: FloatArray) -> Initialisation:
    initialiser = StaticInitialiser(SETTINGS, T_IMU_BODY)
    result = Initialisation(None, "")
    for i in range(len(gyro)):
        t_ns = 5_000_000 * i
        result = initialiser.add(ImuSample(t_ns, t_ns, gyro[i], accel[i]))
        if result.state is not None:
            break
    return result


def _resting(tilt: FloatArray, count: int = 300, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Samples of a sensor whose IMU axes are turned by `tilt` from level."""
    rng = np.random.default_rng(seed)
    up_imu = rotation.rotate(rotation.conjugate(rotation.exp(tilt)), [0.0, 0.0, 9.80665])
    gyro = np.array([0.004, -0.003, 0.002]) + rng.normal(0.0, 8e-4, (count, 3))
    return gyro, up_imu + rng.normal(0.0, 0.01, (count, 3))


@pytest.mark.parametrize(
    "tilt", [[0.0, 0.0, 0.0], [0.2, -0.3, 0.0], [np.pi - 0.1, 0.0, 0.0], [0.0, 1.5, 0.0]]
)
def test_rest_gives_a_level_map_whose_origin_and_yaw_are_the_bodys(tilt: list[float]) -> None:
    gyro, accel = _resting(np.array(tilt))
    state = _feed(gyro, accel).state
    assert state is not None
    np.testing.assert_allclose(state.R_map_imu @ accel.mean(axis=0), [0.0, 0.0, 9.80665], atol=0.02)
    T_map_body = Pose.of(state.p_map, rotation.from_matrix(state.R_map_imu)) @ T_IMU_BODY
    np.testing.assert_allclose(T_map_body.p, 0.0, atol=1e-12)
    forward = rotation.rotate(T_map_body.q, [1.0, 0.0, 0.0])
    assert abs(float(forward[1])) < 1e-9
    np.testing.assert_allclose(state.gyro_bias, [0.004, -0.003, 0.002], atol=3e-4)
    np.testing.assert_allclose(state.R_map_imu @ state.R_map_imu.T, np.eye(3), atol=1e-12)


def test_the_starting_covariance_ties_tilt_and_accelerometer_bias_together() -> None:
    gyro, accel = _resting(np.array([0.2, -0.1, 0.0]))
    state = _feed(gyro, accel).state
    assert state is not None
    assert float(np.linalg.eigvalsh(state.covariance)[0]) > -1e-12
    # What an accelerometer at rest reads, bias - R' g, is known far better than either.
    J = np.zeros((3, 18))
    J[:, 12:15] = np.eye(3)
    J[:, 15:18] = -state.R_map_imu.T
    sigma = np.sqrt(np.linalg.eigvalsh(J @ state.covariance @ J.T))
    assert float(sigma[0]) < 0.002
    assert state.covariance[15, 15] == pytest.approx(SETTINGS.initial_accel_bias_sigma**2)


@pytest.mark.parametrize(
    ("disturb", "reason"),
    [
        ("shake", "acceleration varies"),
        ("wobble", "rates vary"),
        ("turn", "turning"),
        ("tilt", "mean acceleration moved"),
        ("weigh", "off gravity"),
        ("stop", "resting"),
    ],
)
def test_motion_is_refused_with_its_reason(disturb: str, reason: str) -> None:
    gyro, accel = _resting(np.zeros(3))
    time = np.arange(len(gyro)) * 0.005
    if disturb == "shake":
        accel[:, 0] += 0.6 * np.sin(60.0 * time)
    elif disturb == "wobble":
        gyro[:, 1] += 0.1 * np.sin(3.0 * time)
    elif disturb == "turn":
        gyro[:, 2] += 0.06
    elif disturb == "tilt":
        accel[:, 0] += 0.4 * time
    elif disturb == "weigh":
        accel *= 0.9
    else:
        gyro, accel = gyro[:150], accel[:150]
    result = _feed(gyro, accel)
    assert result.state is None
    assert reason in result.reason


def test_rest_after_motion_starts_one_window_later() -> None:
    gyro, accel = _resting(np.zeros(3), 600)
    gyro[:200, 0] += 1.0
    initialiser = StaticInitialiser(SETTINGS, T_IMU_BODY)
    started_ns = -1
    for i in range(600):
        t_ns = 5_000_000 * i
        if initialiser.add(ImuSample(t_ns, t_ns, gyro[i], accel[i])).state is not None:
            started_ns = t_ns
            break
    assert 1_990_000_000 <= started_ns <= 2_050_000_000
