"""Between the body, whose motion another process states, and the IMU, which carries it on."""

import math

import numpy as np

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import ExternalOdometry, FloatArray, Odometry
from companion.perception.odometry.external_path import P, R, V, motion_of
from companion.perception.odometry.external_settings import ExternalMotionSettings
from companion.perception.odometry.health import Health

_DRIFT_MPS2 = 0.1
"""Acceleration that the IMU may get wrong: its bias, and gravity by the attitude's error."""
_DRIFT_RADPS = 0.005
"""Rate that it may get wrong."""


def imu_motion_of(
    message: ExternalOdometry, v_map: FloatArray, omega_imu: FloatArray, T_body_imu: Pose
) -> FloatArray:
    """Return the IMU's motion (15,) where the body moves as stated.

    Args:
        message: the body's pose.
        v_map: (3,) its velocity.
        omega_imu: (3,) rate, free of bias, rad/s.
        T_body_imu: the IMU in the body frame.
    """
    R_map_body = rotation.to_matrix(message.q_map_body)
    R_body_imu = rotation.to_matrix(T_body_imu.q)
    lever_body = T_body_imu.p
    swing_map = R_map_body @ np.cross(R_body_imu @ omega_imu, lever_body)
    return motion_of(message.p_map + R_map_body @ lever_body, R_map_body @ R_body_imu, v_map + swing_map)


def body_odometry_of(
    motion: FloatArray,
    omega_imu: FloatArray,
    T_body_imu: Pose,
    message: ExternalOdometry,
    *,
    age_s: float,
    t_ns: int,
    t_sensor_ns: int,
    reset_counter: int,
    health: Health,
    limits: ExternalMotionSettings,
) -> Odometry:
    """Return the motion of the body that carries the IMU.

    Args:
        motion: (15,) of the IMU.
        omega_imu: (3,) rate, free of bias, rad/s.
        T_body_imu: the IMU in the body frame.
        message: the newest message, for its covariances.
        age_s: for how long the IMU has carried the motion on since.
        t_ns: host time of the motion.
        t_sensor_ns: the same on the LiDAR's clock.
        reset_counter: jumps of the map frame so far.
        health: verdict.
        limits: floors of the published standard deviations.
    """
    R_body_imu = rotation.to_matrix(T_body_imu.q)
    R_map_body = motion[R].reshape(3, 3) @ R_body_imu.T
    omega_body = R_body_imu @ omega_imu
    lever_body = T_body_imu.p
    v_map = motion[V] - R_map_body @ np.cross(omega_body, lever_body)
    covariance_velocity = message.covariance_velocity + np.eye(3) * (_DRIFT_MPS2 * age_s) ** 2
    covariance_pose = message.covariance_pose.copy()
    covariance_pose[:3, :3] += covariance_velocity * age_s**2
    covariance_pose[3:, 3:] += np.eye(3) * (_DRIFT_RADPS * age_s) ** 2
    rotation_floor = math.radians(limits.rotation_sigma_floor_deg)
    return Odometry(
        t_ns=t_ns,
        t_sensor_ns=t_sensor_ns,
        p_map=motion[P] - R_map_body @ lever_body,
        q_map_body=rotation.from_matrix(R_map_body),
        v_map=v_map,
        omega_body=omega_body,
        covariance_pose=_at_least(
            covariance_pose, [limits.position_sigma_floor_m] * 3 + [rotation_floor] * 3
        ),
        covariance_velocity=_at_least(covariance_velocity, [limits.velocity_sigma_floor_mps] * 3),
        quality=health.quality,
        reset_counter=reset_counter,
        status=health.status,
        reason=health.reason,
    )


def _at_least(covariance: FloatArray, sigmas: list[float]) -> FloatArray:
    """Return a covariance whose diagonal reaches given standard deviations."""
    return np.asarray(covariance + np.diag(np.maximum(0.0, np.square(sigmas) - np.diagonal(covariance))))
