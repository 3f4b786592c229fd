"""Bounds on every velocity that leaves the process."""

import math

import numpy as np

from companion.clock import ns_to_seconds
from companion.messages import FloatArray
from companion.safety.settings import SafetySettings

# Vertical speed allowed per metre left to an altitude limit: stops at the limit without a step.
_ALTITUDE_GAIN_PER_S = 1.0


class VelocityLimiter:
    """Clips speed, acceleration, altitude and turn rate; remembers what was last commanded."""

    def __init__(self, settings: SafetySettings) -> None:
        """Start from rest."""
        self._settings = settings
        self._previous_v_map: FloatArray = np.zeros(3)
        self._previous_t_ns: int | None = None

    def restart(self, v_map: FloatArray) -> None:
        """Forget the past and continue from the vehicle's present velocity (3,) m/s, clipped."""
        start = v_map if bool(np.all(np.isfinite(v_map))) else np.zeros(3)
        self._previous_v_map = self._clip_speed(start)
        self._previous_t_ns = None

    def limit(self, v_wanted_map: FloatArray, height: float, t_ns: int) -> FloatArray:
        """Return the admissible velocity nearest to the wish.

        Args:
            v_wanted_map: (3,) m/s; anything not finite counts as zero.
            height: of the vehicle over its start point, metres.
            t_ns: host time of the decision.

        Returns:
            (3,) m/s, finite and within every limit.
        """
        wish = v_wanted_map if bool(np.all(np.isfinite(v_wanted_map))) else np.zeros(3)
        bounded = self._clip_speed(wish)
        bounded[2] = self._clip_altitude(float(bounded[2]), height)
        if self._previous_t_ns is not None:
            elapsed = max(0.0, ns_to_seconds(t_ns - self._previous_t_ns))
            step = bounded - self._previous_v_map
            norm = float(np.linalg.norm(step))
            allowed = self._settings.max_acceleration_mps2 * elapsed
            if norm > allowed:
                bounded = self._previous_v_map + step * (allowed / norm)
        else:
            bounded = self._previous_v_map.copy()
        self._previous_v_map = bounded
        self._previous_t_ns = t_ns
        return bounded.copy()

    def limit_yaw_rate(self, yaw_rate: float) -> float:
        """Return the turn rate in rad/s within its limit; zero if it is not finite."""
        bound = math.radians(self._settings.max_yaw_rate_deg_s)
        return min(max(yaw_rate, -bound), bound) if math.isfinite(yaw_rate) else 0.0

    def _clip_speed(self, v_map: FloatArray) -> FloatArray:
        clipped = v_map.astype(np.float64, copy=True)
        horizontal = math.hypot(clipped[0], clipped[1])
        if horizontal > self._settings.max_speed_mps:
            clipped[:2] *= self._settings.max_speed_mps / horizontal
        clipped[2] = min(max(clipped[2], -self._settings.max_descent_mps), self._settings.max_climb_mps)
        return clipped

    def _clip_altitude(self, v_up: float, height: float) -> float:
        if not math.isfinite(height):
            return 0.0
        highest = max(0.0, _ALTITUDE_GAIN_PER_S * (self._settings.max_altitude_m - height))
        lowest = min(0.0, _ALTITUDE_GAIN_PER_S * (self._settings.min_altitude_m - height))
        return min(max(v_up, lowest), highest)
