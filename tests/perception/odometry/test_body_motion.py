import numpy as np

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, Odometry, OdometryStatus
from companion.perception.odometry.body_motion import body_odometry
from companion.perception.odometry.health import Health
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState

NO_FLOORS = OdometrySettings(
    position_sigma_floor_m=0.0, rotation_sigma_floor_deg=0.0, velocity_sigma_floor=0.0
)
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
    vector[21:24] = [0.0, 0.0, -9.81]
    root = rng.normal(0.0, 0.02, (18, 18))
    return NavigationState(7, vector, root @ root.T)


def _odometry(state: NavigationState, settings: OdometrySettings = NO_FLOORS) -> Odometry:
    return body_odometry(state, GYRO - state.gyro_bias, T_IMU_BODY, 11, 2, HEALTH, settings)


def test_the_body_is_where_the_mounting_puts_it() -> None:
    state = _state()
    odometry = _odometry(state)
    T_map_body = Pose.of(state.p_map, rotation.from_matrix(state.R_map_imu)) @ T_IMU_BODY
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
    for i in range(15):
        error = np.zeros(18)
        error[i] = 1e-6
        jacobian[:, i] = _difference(_odometry(state.plus(error)), odometry) / 1e-6
    expected = jacobian @ state.covariance @ jacobian.T
    np.testing.assert_allclose(odometry.covariance_pose, expected[:6, :6], atol=1e-7)
    np.testing.assert_allclose(odometry.covariance_velocity, expected[6:, 6:], atol=1e-7)


def test_published_deviations_never_fall_below_their_floors() -> None:
    state = _state()
    state.covariance[:] *= 1e-9
    settings = OdometrySettings()
    odometry = _odometry(state, settings)
    np.testing.assert_allclose(
        np.sqrt(np.diag(odometry.covariance_pose)[:3]), settings.position_sigma_floor_m
    )
    np.testing.assert_allclose(
        np.degrees(np.sqrt(np.diag(odometry.covariance_pose)[3:])), settings.rotation_sigma_floor_deg
    )
    np.testing.assert_allclose(np.sqrt(np.diag(odometry.covariance_velocity)), settings.velocity_sigma_floor)


def test_a_moved_state_keeps_a_proper_attitude_and_the_length_of_gravity() -> None:
    moved = _state().plus(np.random.default_rng(1).normal(0.0, 0.3, 18))
    np.testing.assert_allclose(moved.R_map_imu @ moved.R_map_imu.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(moved.g_map), 9.81)
