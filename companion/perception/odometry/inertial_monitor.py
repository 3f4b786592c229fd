"""Is the inertial chip alive and believable? Judged from its samples alone."""

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND
from companion.messages import ImuSample
from companion.perception.odometry import inertial_monitor_kernels as kernels
from companion.perception.odometry.settings import OdometrySettings

_RATE_MARGIN = 1.9  # of the nominal interval: four fifths of all packets already give 1.25

_REASONS = {
    kernels.FROZEN: "IMU frozen: its values repeat",
    kernels.SATURATED: "IMU saturated",
    kernels.JOLTED: "jolt: the sensor turned faster than the vehicle can",
}


class InertialMonitor:
    """Watches for samples that repeat, saturate, stay away, come at a wrong rate or show a jolt."""

    def __init__(self, settings: OdometrySettings) -> None:
        """Begin with no sample seen."""
        self._nominal_hz = settings.imu_hz
        nominal_s = 1.0 / settings.imu_hz
        self._limits = np.array(
            [
                settings.imu_silent_after_s,
                nominal_s / _RATE_MARGIN,
                nominal_s * _RATE_MARGIN,
                settings.max_angular_acceleration,
                settings.gyro_saturation,
                settings.accel_saturation,
            ]
        )
        self._memory = np.zeros(kernels.MEMORY_SIZE)
        self._t_sensor_ns = 0

    def relabel(self, shift_ns: int) -> None:
        """Follow a jump of the sensor's clock."""
        self._t_sensor_ns += shift_ns

    def observe(self, sample: ImuSample) -> str:
        """Take a sample, newer than all before; return what is wrong, or ""."""
        passed_ns = sample.t_sensor_ns - self._t_sensor_ns
        interval_s = passed_ns / NANOSECONDS_PER_SECOND if self._memory[21] > 0.0 else 0.0
        self._t_sensor_ns = sample.t_sensor_ns
        finding = kernels.watch(sample.gyro_imu, sample.accel_imu, interval_s, self._limits, self._memory)
        if finding == kernels.HEALTHY:
            return ""
        if finding == kernels.INTERRUPTED:
            return f"IMU interrupted for {interval_s:.2f} s"
        if finding == kernels.WRONG_RATE:
            return f"IMU comes at {1.0 / self._memory[14]:.0f} Hz, not {self._nominal_hz:.0f}"
        return _REASONS[finding]
