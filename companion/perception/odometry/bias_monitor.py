"""Do the estimated biases stay what a chip can have, and change no faster than it drifts?"""

from collections import deque

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND
from companion.messages import FloatArray
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import ACCEL_BIAS, GYRO_BIAS, NavigationState

_KEPT = 10  # one a second
_SIGMAS = 6.0
_GYRO_FLOOR = 0.005  # rad/s: what scale errors and slow shaking feign
_ACCEL_FLOOR = 0.15  # m/s^2


class BiasMonitor:
    """Compares biases with physical limits and with what they were up to ten seconds ago."""

    def __init__(self, settings: OdometrySettings) -> None:
        """Begin without any estimate."""
        self._settings = settings
        self._before: deque[tuple[int, FloatArray, FloatArray]] = deque(maxlen=_KEPT)

    def forget(self) -> None:
        """Begin anew."""
        self._before.clear()

    def relabel(self, shift_ns: int) -> None:
        """Follow a jump of the sensor's clock."""
        self._before = deque(((t + shift_ns, b, v) for t, b, v in self._before), maxlen=_KEPT)

    def observe(self, state: NavigationState) -> str:
        """Take a corrected state; return how its biases run away, or ""."""
        settings = self._settings
        gyro, accel = float(np.linalg.norm(state.gyro_bias)), float(np.linalg.norm(state.accel_bias))
        if gyro > settings.gyro_bias_limit:
            return f"gyro bias runs away: {gyro:.3f} rad/s"
        if accel > settings.accel_bias_limit:
            return f"accelerometer bias runs away: {accel:.2f} m/s^2"
        biases = np.concatenate([state.gyro_bias, state.accel_bias])
        variances = np.concatenate(
            [np.diagonal(state.covariance[part, part]) for part in (GYRO_BIAS, ACCEL_BIAS)]
        )
        reason = self._moved(state.t_ns, biases)
        if not self._before or state.t_ns - self._before[-1][0] >= NANOSECONDS_PER_SECOND:
            self._before.append((state.t_ns, biases, variances))
        return reason

    def _moved(self, t_ns: int, biases: FloatArray) -> str:
        """Compare with the oldest remembered estimate."""
        if not self._before:
            return ""
        then_ns, before, variances = self._before[0]
        passed_s = (t_ns - then_ns) / NANOSECONDS_PER_SECOND
        walks = np.repeat([self._settings.gyro_bias_walk, self._settings.accel_bias_walk], 3)
        floors = np.repeat([_GYRO_FLOOR, _ACCEL_FLOOR], 3)
        allowed = floors + _SIGMAS * np.sqrt(variances + walks**2 * passed_s)
        moved = np.abs(biases - before)
        if not np.any(moved > allowed):
            return ""
        worst = int(np.argmax(moved / allowed))
        name, unit = ("gyro", "rad/s") if worst < 3 else ("accelerometer", "m/s^2")
        return f"{name} bias moved by {moved[worst]:.3f} {unit} in {passed_s:.0f} s"
