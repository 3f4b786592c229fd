"""The Mid-360's inertial chip (TDK ICM-40609-D): exact motion of its own position, then its errors.

Sources: noise densities, scale error and ranges from the chip's datasheet. Turn-on bias and bias drift
are not published for the LiDAR's factory calibration and are assumptions, as is the vibration.
"""

import math

import numpy as np
from numpy.random import Generator
from pydantic import Field

from companion.clock import ns_to_seconds
from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray
from companion.settings import Settings
from sitl.array_layout import laid_out
from sitl.kinematics import Kinematics
from sitl.sensors.imu_kernels import average_inertial, blur_inertial
from sitl.sensors.vibration import Vibration, VibrationSettings
from sitl.slots import InertialSlot
from sitl.worlds.primitives import Vector

_STANDARD_GRAVITY = 9.80665


class ImuSettings(Settings):
    """Imperfections of one chip."""

    position_lidar_m: Vector = (0.011, 0.02329, -0.04412)
    """Where the chip sits in the point frame; its axes are parallel."""
    gyro_noise_radps_per_sqrt_hz: float = Field(default=7.9e-5, ge=0.0, le=1.0)
    """White noise density (4.5 mdps per root hertz)."""
    accel_noise_mps2_per_sqrt_hz: float = Field(default=9.8e-4, ge=0.0, le=1.0)
    """White noise density (100 ug per root hertz)."""
    bandwidth_hz: float = Field(default=100.0, gt=0.0, le=10_000.0)
    """Bandwidth of the white noise in a sample."""
    gyro_turn_on_bias_dps: float = Field(default=0.3, ge=0.0, le=50.0)
    """Standard deviation of the bias drawn at power-on, each axis."""
    accel_turn_on_bias_mps2: float = Field(default=0.05, ge=0.0, le=5.0)
    """Standard deviation of the bias drawn at power-on, each axis."""
    gyro_bias_instability_dps: float = Field(default=0.005, ge=0.0, le=5.0)
    """Standard deviation of the wandering part of the bias."""
    accel_bias_instability_mps2: float = Field(default=0.002, ge=0.0, le=5.0)
    """Standard deviation of the wandering part of the bias."""
    bias_time_s: float = Field(default=300.0, gt=0.0, le=1e6)
    """Correlation time of the wandering part."""
    scale_error: float = Field(default=0.005, ge=0.0, le=0.2)
    """Scale factors are drawn uniformly within 1 plus or minus this, each axis of each sensor."""
    gyro_range_dps: float = Field(default=2000.0, gt=0.0, le=4000.0)
    """Rates saturate here."""
    accel_range_g: float = Field(default=32.0, gt=0.0, le=64.0)
    """Accelerations saturate here."""
    vibration: VibrationSettings = VibrationSettings()
    """What the motors add."""

    @classmethod
    def ideal(cls) -> "ImuSettings":
        """Return a chip without any error, on a vehicle that does not vibrate."""
        return cls(
            gyro_noise_radps_per_sqrt_hz=0.0, accel_noise_mps2_per_sqrt_hz=0.0, gyro_turn_on_bias_dps=0.0,
            accel_turn_on_bias_mps2=0.0, gyro_bias_instability_dps=0.0, accel_bias_instability_mps2=0.0,
            scale_error=0.0, vibration=VibrationSettings(accel_rms_mps2=0.0, gyro_rms_radps=0.0),
        )  # fmt: skip


def true_inertial(start: Kinematics, end: Kinematics, step_s: float, T_body_imu: Pose) -> FloatArray:
    """Return what an ideal chip measures over one step: rate (rad/s), then specific force (m/s^2), (6,).

    Both are means over the step, expressed in the chip's frame at mid-step. With the chip's velocity
    differenced exactly, the lever arm's centripetal and tangential terms are included, and integrating
    the samples with mid-step attitudes reproduces attitude and velocity.
    """
    inertial = np.empty(6)
    average_inertial(
        float(step_s),
        laid_out(start.v_world), laid_out(start.q_world_body), laid_out(start.omega_body),
        laid_out(end.v_world), laid_out(end.q_world_body), laid_out(end.omega_body),
        laid_out(T_body_imu.p), laid_out(T_body_imu.q), inertial,
    )  # fmt: skip
    return inertial


class ImuModel:
    """One simulated chip inside a LiDAR mounted on a body."""

    def __init__(self, rng: Generator, T_body_lidar: Pose, settings: ImuSettings) -> None:
        """Power on: draw biases and scale factors."""
        self._rng = rng
        self._settings = settings
        self._T_body_imu = T_body_lidar @ Pose.of(settings.position_lidar_m, rotation.IDENTITY)
        self._vibration = Vibration(rng, settings.vibration)
        turn_on = np.repeat(
            [math.radians(settings.gyro_turn_on_bias_dps), settings.accel_turn_on_bias_mps2], 3
        )
        self._turn_on_bias = turn_on * rng.standard_normal(6)
        instability = np.repeat(
            [math.radians(settings.gyro_bias_instability_dps), settings.accel_bias_instability_mps2], 3
        )
        self._wander = instability * rng.standard_normal(6)
        scale = 1.0 + settings.scale_error * rng.uniform(-1.0, 1.0, 6)
        densities = [settings.gyro_noise_radps_per_sqrt_hz, settings.accel_noise_mps2_per_sqrt_hz]
        noise = np.repeat(densities, 3) * math.sqrt(settings.bandwidth_hz)
        limit = np.repeat(
            [math.radians(settings.gyro_range_dps), settings.accel_range_g * _STANDARD_GRAVITY], 3
        )
        self._errors = np.stack([self._turn_on_bias, instability, noise, scale, limit])

    @property
    def T_body_imu(self) -> Pose:
        """Return where the chip sits on the body."""
        return self._T_body_imu

    @property
    def bias(self) -> FloatArray:
        """Return the present true bias (6,): rad/s, then m/s^2."""
        return self._turn_on_bias + self._wander

    def sample(
        self, t_start_ns: int, start: Kinematics, t_end_ns: int, end: Kinematics, thrust: float
    ) -> InertialSlot:
        """Measure one simulation step; the sample is stamped with its end.

        Args:
            t_start_ns: sensor time of the step's start.
            start: the body's motion then.
            t_end_ns: sensor time of the step's end.
            end: the body's motion then.
            thrust: of the motors by vehicle mass, m/s^2; 0 with stopped motors. It drives the vibration.
        """
        step_s = ns_to_seconds(t_end_ns - t_start_ns)
        truth = true_inertial(start, end, step_s, self._T_body_imu)
        deviates = self._rng.standard_normal(12)
        measured = np.empty((2, 3))
        blur_inertial(
            math.exp(-step_s / self._settings.bias_time_s),
            self._errors, truth, self._vibration.step(step_s, thrust), deviates, self._wander, measured,
        )  # fmt: skip
        return InertialSlot(t_sensor_ns=t_end_ns, gyro_imu=measured[0], accel_imu=measured[1])
