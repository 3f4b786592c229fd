import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, Odometry, OdometryStatus
from companion.perception.odometry.body_motion import Mounting, body_odometry
from companion.perception.odometry.health import Health
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState

NO_FLOORS = OdometrySettings(
    position_sigma_floor_m=0.0,
    rotation_sigma_floor_deg=0.0,
    velocity_sigma_floor=0.0,
)
CERTAIN = np.zeros((6, 6))
T_IMU_BODY = Pose.of([-0.3, 0.2, -0.1], rotation.exp([0.1, -0.4, 0.7]))
GYRO = np.array([0.5, -1.0, 2.0])
HEALTH = Health(OdometryStatus.TRACKING, 90, "")


def _state() -> NavigationState:
    rng = np.random.default_rng(0)
    vector = np.zeros(24)
    vector[0:3] = [1.0, 2.0, 3.0]
    vector[3:12] = rotation.to_matrix(rotation.exp([0.2, 0.1, -1.0])).ravel()
    vector[12:15] = [1.0, -2.0, 0.5]
    vector[15:18] = [0.01, 0.02, -0.01]
    vector[21:24] = 9.81 * np.array([0.02, -0.05, -1.0]) / np.linalg.norm([0.02, -0.05, -1.0])
    root = rng.normal(0.0, 0.02, (18, 18))
    return NavigationState(7, vector, root @ root.T)


def _odometry(
    state: NavigationState,
    settings: OdometrySettings = NO_FLOORS,
    anchored: FloatArray = CERTAIN,
    correlation: float = 1.0,
    tilt_variance: float = 0.0,
) -> Odometry:
    mounting = Mounting(T_IMU_BODY, settings)
    mounting.tilt_variance = tilt_variance
    return body_odometry(state, anchored, correlation, GYRO - state.gyro_bias, mounting, 11, 2, HEALTH)


def test_the_body_is_where_the_mounting_puts_it() -> None:
    state = _state()
    odometry = _odometry(state)
    T_map_imu = Pose.of(state.p_map, rotation.from_matrix(state.R_map_imu))
    T_map_body = T_map_imu @ T_IMU_BODY
    np.testing.assert_allclose(odometry.p_map, T_map_body.p, atol=1e-12)
    assert float(rotation.angle_between(odometry.q_map_body, T_map_body.q)) < 1e-9
    assert (odometry.t_ns, odometry.t_sensor_ns, odometry.reset_counter, odometry.quality) == (11, 7, 2, 90)


def test_the_bodys_velocity_is_the_derivative_of_its_position() -> None:
    state = _state()
    odometry = _odometry(state)
    dt = 1e-6
    later = state.copy()
    later.p_map[:] += state.v_map * dt
    q = rotation.multiply(rotation.from_matrix(state.R_map_imu), rotation.exp((GYRO - state.gyro_bias) * dt))
    later.vector[3:12] = rotation.to_matrix(q).ravel()
    np.testing.assert_allclose((_odometry(later).p_map - odometry.p_map) / dt, odometry.v_map, atol=1e-5)
    turn = rotation.log(
        rotation.multiply(rotation.conjugate(odometry.q_map_body), _odometry(later).q_map_body)
    )
    np.testing.assert_allclose(turn / dt, odometry.omega_body, atol=1e-5)


def _difference(a: Odometry, b: Odometry) -> FloatArray:
    turn = rotation.log(rotation.multiply(rotation.conjugate(b.q_map_body), a.q_map_body))
    return np.concatenate([a.p_map - b.p_map, turn, a.v_map - b.v_map])


def test_the_covariance_follows_the_numerical_jacobian() -> None:
    state = _state()
    odometry = _odometry(state)
    jacobian = np.zeros((9, 18))
    for i in range(18):
        error = np.zeros(18)
        error[i] = 1e-6
        jacobian[:, i] = _difference(_odometry(state.plus(error)), odometry) / 1e-6
    expected = jacobian @ state.covariance @ jacobian.T
    np.testing.assert_allclose(odometry.covariance_pose, expected[:6, :6], atol=1e-7)
    np.testing.assert_allclose(odometry.covariance_velocity, expected[6:, 6:], atol=1e-7)


def test_a_twist_of_the_map_adds_what_it_does_to_pose_and_velocity() -> None:
    state = _state()
    state.covariance[:] = 0.0
    root = np.random.default_rng(2).normal(0.0, 0.02, (6, 6))
    odometry = _odometry(state)
    jacobian = np.zeros((9, 6))
    for i in range(6):
        twist = np.zeros(6)
        twist[i] = 1e-6
        turn = rotation.exp(twist[3:])
        moved = state.copy()
        moved.p_map[:] = rotation.rotate(turn, state.p_map) + twist[:3]
        moved.vector[3:12] = (rotation.to_matrix(turn) @ state.R_map_imu).ravel()
        moved.v_map[:] = rotation.rotate(turn, state.v_map)
        jacobian[:, i] = _difference(_odometry(moved), odometry) / 1e-6
    expected = jacobian @ root @ root.T @ jacobian.T
    twisted = _odometry(state, anchored=root @ root.T)
    np.testing.assert_allclose(twisted.covariance_pose, expected[:6, :6], atol=1e-6)
    np.testing.assert_allclose(twisted.covariance_velocity, expected[6:, 6:], atol=1e-6)


def test_correlated_residuals_widen_the_pose() -> None:
    state = _state()
    keep = np.zeros((18, 18))
    keep[:6, :6] = state.covariance[:6, :6]
    state.covariance[:] = keep
    wide = _odometry(state, correlation=3.0)
    np.testing.assert_allclose(
        wide.covariance_pose, 3.0 * _odometry(state).covariance_pose, rtol=1e-9, atol=1e-15
    )


@pytest.mark.parametrize("distance_m", [0.0, 10.0, 40.0])
def test_the_lean_of_the_map_weighs_the_more_the_farther_the_vehicle_has_gone(distance_m: float) -> None:
    state = _state()
    state.covariance[:] = 0.0
    state.vector[0:3] = [distance_m, 0.0, 0.0]
    state.vector[3:12] = np.eye(3).ravel()
    lean = np.radians(0.3)
    odometry = _odometry(state, tilt_variance=lean**2)
    x, y, z = odometry.p_map
    pose = np.sqrt(np.diag(odometry.covariance_pose))
    np.testing.assert_allclose(pose[:3], lean * np.array([abs(z), abs(z), np.hypot(x, y)]), atol=1e-9)
    # About the vertical the map does not lean.
    turn = odometry.covariance_pose[3:, 3:]
    up_body = rotation.rotate(rotation.conjugate(odometry.q_map_body), [0.0, 0.0, 1.0])
    np.testing.assert_allclose(turn @ up_body, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.trace(turn), 2.0 * lean**2)


def test_published_deviations_never_fall_below_their_floors() -> None:
    state = _state()
    state.covariance[:] *= 1e-12
    settings = OdometrySettings()
    odometry = _odometry(state, settings)
    np.testing.assert_allclose(
        np.sqrt(np.diag(odometry.covariance_pose)[:3]), settings.position_sigma_floor_m
    )
    np.testing.assert_allclose(
        np.degrees(np.sqrt(np.diag(odometry.covariance_pose)[3:])), settings.rotation_sigma_floor_deg
    )
    np.testing.assert_allclose(np.sqrt(np.diag(odometry.covariance_velocity)), settings.velocity_sigma_floor)


@pytest.mark.parametrize("angle", [0.0, 1.5, 3.1, -3.1])
def test_every_attitude_is_published_as_a_proper_quaternion(angle: float) -> None:
    for axis in np.eye(3):
        state = _state()
        state.vector[3:12] = rotation.to_matrix(rotation.exp(angle * axis)).ravel()
        T_map_body = Pose.of(np.zeros(3), rotation.exp(angle * axis)) @ T_IMU_BODY
        q = _odometry(state).q_map_body
        assert q[0] >= 0.0
        assert float(rotation.angle_between(q, T_map_body.q)) < 1e-7


def test_a_moved_state_keeps_a_proper_attitude_and_the_length_of_gravity() -> None:
    moved = _state().plus(np.random.default_rng(1).normal(0.0, 0.3, 18))
    np.testing.assert_allclose(moved.R_map_imu @ moved.R_map_imu.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(moved.g_map), 9.81)
