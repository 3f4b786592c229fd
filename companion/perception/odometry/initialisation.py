"""Starting at rest: gravity gives roll and pitch, the mean rate gives the gyro bias."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from companion.clock import seconds_to_ns
from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, ImuSample
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import (
    ACCEL_BIAS,
    ERROR_SIZE,
    GRAVITY,
    GYRO_BIAS,
    STATE_SIZE,
    THETA,
    NavigationState,
    P,
    V,
)

_MOST_SAMPLES = 4000
_LEAST_SAMPLES = 40
_HALVES_RATIO = 0.5  # of the stillness limit: how far the two halves' means may lie apart


@dataclass(frozen=True, slots=True, eq=False)
class Initialisation:
    """A starting state, or the reason why there is none yet."""

    state: NavigationState | None
    reason: str


class StaticInitialiser:
    """Watches the newest stretch of IMU samples until it shows a sensor at rest."""

    def __init__(self, settings: OdometrySettings, T_imu_body: Pose) -> None:
        """Start with an empty window.

        Args:
            settings: window length and limits.
            T_imu_body: body in the IMU frame; the map's origin and yaw are the body's.
        """
        self._settings = settings
        self._T_imu_body = T_imu_body
        self._window: deque[ImuSample] = deque(maxlen=_MOST_SAMPLES)

    def clear(self) -> None:
        """Forget the window."""
        self._window.clear()

    def add(self, sample: ImuSample) -> Initialisation:
        """Take one sample, newer than all before, and try to start."""
        window_ns = seconds_to_ns(self._settings.initial_window_s)
        self._window.append(sample)
        while sample.t_sensor_ns - self._window[1 if len(self._window) > 1 else 0].t_sensor_ns >= window_ns:
            self._window.popleft()
        covered_ns = sample.t_sensor_ns - self._window[0].t_sensor_ns
        if covered_ns < window_ns or len(self._window) < _LEAST_SAMPLES:
            return Initialisation(None, f"resting {covered_ns * 1e-9:.1f} s of {window_ns * 1e-9:.1f} s")
        gyro = np.array([entry.gyro_imu for entry in self._window])
        accel = np.array([entry.accel_imu for entry in self._window])
        reason = motion_in(gyro, accel, self._settings)
        if reason:
            return Initialisation(None, reason)
        return Initialisation(
            resting_state(
                sample.t_sensor_ns, gyro.mean(axis=0), accel.mean(axis=0), self._T_imu_body, self._settings
            ),
            "",
        )


def motion_in(gyro: FloatArray, accel: FloatArray, settings: OdometrySettings) -> str:
    """Return why samples (n, 3) in rad/s and (n, 3) in m/s^2 do not show a sensor at rest, or ""."""
    gyro_sigma, accel_sigma = float(gyro.std(axis=0).max()), float(accel.std(axis=0).max())
    if gyro_sigma > settings.still_gyro_sigma:
        return f"not still: rates vary by {gyro_sigma:.3f} rad/s, allowed {settings.still_gyro_sigma:.3f}"
    if accel_sigma > settings.still_accel_sigma:
        limit = settings.still_accel_sigma
        return f"not still: acceleration varies by {accel_sigma:.2f} m/s^2, allowed {limit:.2f}"
    rate = float(np.linalg.norm(gyro.mean(axis=0)))
    if rate > settings.max_gyro_bias:
        return f"turning at {rate:.3f} rad/s, allowed {settings.max_gyro_bias:.3f}"
    half = len(accel) // 2
    tilt = float(np.linalg.norm(accel[:half].mean(axis=0) - accel[half:].mean(axis=0)))
    if tilt > _HALVES_RATIO * settings.still_accel_sigma:
        return f"not still: mean acceleration moved by {tilt:.2f} m/s^2"
    error = float(np.linalg.norm(accel.mean(axis=0))) - settings.gravity
    if abs(error) > settings.max_gravity_error:
        return f"acceleration at rest is off gravity by {error:+.2f} m/s^2"
    return ""


def resting_state(
    t_ns: int,
    mean_gyro: FloatArray,
    mean_accel: FloatArray,
    T_imu_body: Pose,
    settings: OdometrySettings,
) -> NavigationState:
    """Return the state of a sensor at rest, in the map that this state defines.

    At rest tilt and accelerometer bias cannot be told apart. The attitude defines the map, so it is
    certain; what is uncertain is the direction of gravity in that map, and the bias that goes with it:
    specific force = bias - R' g, hence d(bias) = R' d(g).

    Args:
        t_ns: sensor time.
        mean_gyro: (3,) rad/s.
        mean_accel: (3,) m/s^2.
        T_imu_body: body in the IMU frame.
        settings: gravity and the bias's uncertainty.
    """
    up_imu = mean_accel / np.linalg.norm(mean_accel)
    forward_imu = rotation.rotate(T_imu_body.q, [1.0, 0.0, 0.0])
    left_imu = np.cross(up_imu, forward_imu)
    if np.linalg.norm(left_imu) < 1e-3:  # body x axis vertical: yaw of its z axis instead
        left_imu = np.cross(up_imu, rotation.rotate(T_imu_body.q, [0.0, 0.0, -1.0]))
    left_imu = left_imu / np.linalg.norm(left_imu)
    R_map_imu = np.stack([np.cross(left_imu, up_imu), left_imu, up_imu])
    g_map = np.array([0.0, 0.0, -settings.gravity])

    vector = np.zeros(STATE_SIZE)
    vector[0:3] = -R_map_imu @ T_imu_body.p
    vector[3:12] = R_map_imu.ravel()
    vector[15:18] = mean_gyro
    vector[18:21] = mean_accel + R_map_imu.T @ g_map
    vector[21:24] = g_map

    covariance = np.zeros((ERROR_SIZE, ERROR_SIZE))
    covariance[P, P] = np.eye(3) * 1e-8
    covariance[THETA, THETA] = np.eye(3) * 1e-8
    covariance[V, V] = np.eye(3) * 1e-4
    covariance[GYRO_BIAS, GYRO_BIAS] = np.eye(3) * 4e-6
    horizontal = np.diag([1.0, 1.0, 0.0]) * settings.initial_accel_bias_sigma**2
    covariance[GRAVITY, GRAVITY] = horizontal
    covariance[ACCEL_BIAS, GRAVITY] = R_map_imu.T @ horizontal
    covariance[GRAVITY, ACCEL_BIAS] = horizontal @ R_map_imu
    # Local gravity may differ from the setting by 0.03 m/s^2; the bias absorbs it.
    vertical = np.diag([0.0, 0.0, 1e-3])
    covariance[ACCEL_BIAS, ACCEL_BIAS] = R_map_imu.T @ (horizontal + vertical) @ R_map_imu + np.eye(3) * 1e-6
    return NavigationState(t_ns, vector, covariance)
