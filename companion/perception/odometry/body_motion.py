"""From the IMU's motion to the body's: lever arms, covariances and their floors."""

import numpy as np

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, Odometry
from companion.perception.odometry.body_motion_kernels import MOTION_SIZE, publish
from companion.perception.odometry.health import Health
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState

_NOTHING_KNOWN = 1e6


def cross_matrix(v: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) whose product with x is v cross x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


class Mounting:
    """Where the body is in the IMU frame, and what is always said of its errors, for the kernel."""

    def __init__(self, T_imu_body: Pose, settings: OdometrySettings) -> None:
        """Take the body's pose in the IMU frame, and the floors of the settings."""
        self.p_imu_body = np.ascontiguousarray(T_imu_body.p, dtype=np.float64)
        self.tilt_variance = (settings.initial_accel_bias_sigma / settings.gravity) ** 2
        self.R_imu_body = np.ascontiguousarray(rotation.to_matrix(T_imu_body.q))
        self.floors = np.square(
            [
                settings.position_sigma_floor_m,
                float(np.radians(settings.rotation_sigma_floor_deg)),
                settings.velocity_sigma_floor,
            ]
        )


def body_odometry(
    state: NavigationState,
    anchored: FloatArray,
    correlation: float,
    omega_imu: FloatArray,
    mounting: Mounting,
    t_ns: int,
    reset_counter: int,
    health: Health,
) -> Odometry:
    """Return the motion of the body that carries the IMU.

    Args:
        state: motion of the IMU and its covariance against the filter's own map.
        anchored: (6, 6) covariance of that map's twist against the start, see `Anchor`.
        correlation: factor on the covariance of pose and velocity against the filter's map.
        omega_imu: (3,) rate at the state's time, free of bias, rad/s.
        mounting: of the IMU on the body.
        t_ns: host time of the state.
        reset_counter: jumps of the map frame so far.
        health: verdict on the state.
    """
    motion = np.empty(MOTION_SIZE)
    pose_covariance, velocity_covariance = np.empty((6, 6)), np.empty((3, 3))
    publish(
        state.vector,
        state.covariance,
        anchored,
        omega_imu,
        mounting.p_imu_body,
        mounting.R_imu_body,
        correlation,
        mounting.tilt_variance,
        mounting.floors,
        motion,
        pose_covariance,
        velocity_covariance,
    )
    return Odometry(
        t_ns=t_ns,
        t_sensor_ns=state.t_ns,
        p_map=motion[0:3],
        q_map_body=motion[3:7],
        v_map=motion[7:10],
        omega_body=motion[10:13],
        covariance_pose=pose_covariance,
        covariance_velocity=velocity_covariance,
        quality=health.quality,
        reset_counter=reset_counter,
        status=health.status,
        reason=health.reason,
    )


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
