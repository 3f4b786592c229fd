"""From the IMU's motion to the body's: lever arms, covariances and their floors."""

import numpy as np

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, Odometry
from companion.perception.odometry.health import Health
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import GYRO_BIAS, THETA, NavigationState, P, V

_NOTHING_KNOWN = 1e6


def cross_matrix(v: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) whose product with x is v cross x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def body_odometry(
    state: NavigationState,
    omega_imu: FloatArray,
    T_imu_body: Pose,
    t_ns: int,
    reset_counter: int,
    health: Health,
    settings: OdometrySettings,
) -> Odometry:
    """Return the motion of the body that carries the IMU.

    Args:
        state: motion of the IMU and its covariance.
        omega_imu: (3,) rate at the state's time, free of bias, rad/s.
        T_imu_body: body in the IMU frame.
        t_ns: host time of the state.
        reset_counter: jumps of the map frame so far.
        health: verdict on the state.
        settings: floors of the published standard deviations.
    """
    R_map_imu = state.R_map_imu
    R_imu_body = rotation.to_matrix(T_imu_body.q)
    lever_imu = T_imu_body.p
    swing_imu = cross_matrix(omega_imu) @ lever_imu

    pose_jacobian = np.zeros((6, 18))
    pose_jacobian[0:3, P] = np.eye(3)
    pose_jacobian[0:3, THETA] = -R_map_imu @ cross_matrix(lever_imu)
    pose_jacobian[3:6, THETA] = R_imu_body.T
    velocity_jacobian = np.zeros((3, 18))
    velocity_jacobian[:, V] = np.eye(3)
    velocity_jacobian[:, THETA] = -R_map_imu @ cross_matrix(swing_imu)
    velocity_jacobian[:, GYRO_BIAS] = R_map_imu @ cross_matrix(lever_imu)
    rotation_floor = np.radians(settings.rotation_sigma_floor_deg)
    return Odometry(
        t_ns=t_ns,
        t_sensor_ns=state.t_ns,
        p_map=state.p_map + R_map_imu @ lever_imu,
        q_map_body=rotation.from_matrix(R_map_imu @ R_imu_body),
        v_map=state.v_map + R_map_imu @ swing_imu,
        omega_body=R_imu_body.T @ omega_imu,
        covariance_pose=_at_least(
            pose_jacobian @ state.covariance @ pose_jacobian.T,
            [settings.position_sigma_floor_m] * 3 + [float(rotation_floor)] * 3,
        ),
        covariance_velocity=_at_least(
            velocity_jacobian @ state.covariance @ velocity_jacobian.T, [settings.velocity_sigma_floor] * 3
        ),
        quality=health.quality,
        reset_counter=reset_counter,
        status=health.status,
        reason=health.reason,
    )


def _at_least(covariance: FloatArray, sigmas: list[float]) -> FloatArray:
    """Return a symmetric covariance whose diagonal reaches given standard deviations."""
    symmetric = 0.5 * (covariance + covariance.T)
    diagonal = np.diagonal(symmetric)
    return np.asarray(symmetric + np.diag(np.maximum(0.0, np.square(sigmas) - diagonal)))


def no_odometry(t_ns: int, t_sensor_ns: int, reset_counter: int, health: Health) -> Odometry:
    """Return odometry that says why there is none: at the origin, with a covariance that says nothing."""
    return Odometry(
        t_ns=t_ns,
        t_sensor_ns=t_sensor_ns,
        p_map=np.zeros(3),
        q_map_body=rotation.IDENTITY.copy(),
        v_map=np.zeros(3),
        omega_body=np.zeros(3),
        covariance_pose=np.eye(6) * _NOTHING_KNOWN,
        covariance_velocity=np.eye(3) * _NOTHING_KNOWN,
        quality=0,
        reset_counter=reset_counter,
        status=health.status,
        reason=health.reason,
    )
