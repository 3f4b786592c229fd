"""What must not leave: stale or excessive setpoints, odometry and texts."""

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND, seconds_to_ns
from companion.drivers.px4_settings import Px4Settings
from companion.messages import Odometry, OdometryStatus, Setpoint, StatusText

# Host times of sensor data are estimates; this much ahead of now is still now.
_AHEAD_NS = seconds_to_ns(0.05)
_REPEAT_NS = seconds_to_ns(5.0)
_TEXT_NS = seconds_to_ns(0.25)
_TEXT_BURST = 8


class SetpointGate:
    """Refuses velocities that are old, or that rest on old data."""

    def __init__(self, settings: Px4Settings) -> None:
        """Take the age limit from the settings."""
        self._max_age_ns = round(settings.max_setpoint_age_ms * 1e6)

    def refusal(self, setpoint: Setpoint, t_ns: int) -> str:
        """Return why the setpoint must not be sent at `t_ns`, or an empty string."""
        if not -_AHEAD_NS <= t_ns - setpoint.t_ns <= self._max_age_ns:
            return "stale"
        moves = bool(np.any(setpoint.v_map)) or setpoint.yaw_rate != 0.0
        if moves and not -_AHEAD_NS <= t_ns - setpoint.t_data_ns <= self._max_age_ns:
            return "on stale data"
        return ""


class OdometryGate:
    """Refuses odometry that is lost, poor or old, and thins out what exceeds the rate."""

    def __init__(self, settings: Px4Settings) -> None:
        """Take the limits from the settings."""
        self._max_age_ns = round(settings.max_odometry_age_ms * 1e6)
        self._min_quality = settings.min_odometry_quality
        self._period_ns = round(NANOSECONDS_PER_SECOND / settings.odometry_hz)
        self._due_ns: int | None = None
        self._last_ns: int | None = None
        self._reset_counter: int | None = None

    def refusal(self, odometry: Odometry, t_ns: int) -> str:
        """Return why the odometry must not be sent at `t_ns`, or an empty string."""
        if odometry.status in (OdometryStatus.INITIALISING, OdometryStatus.LOST):
            return odometry.status.name.lower()
        if odometry.quality < self._min_quality:
            return "poor"
        if not -_AHEAD_NS <= t_ns - odometry.t_ns <= self._max_age_ns:
            return "stale"
        if self._last_ns is not None and odometry.t_ns <= self._last_ns:
            return "out of order"
        jumped = odometry.reset_counter != self._reset_counter
        if self._due_ns is not None and not jumped and t_ns < self._due_ns - self._period_ns // 4:
            return "thinned"
        # A late message may be followed by the next on time, but lateness does not add up to a burst.
        begun = t_ns if self._due_ns is None else max(self._due_ns, t_ns - self._period_ns // 2)
        self._due_ns = begun + self._period_ns
        self._last_ns = odometry.t_ns
        self._reset_counter = odometry.reset_counter
        return ""


class TextGate:
    """Refuses texts that repeat within 5 s, and more than 4 a second after a burst of 8."""

    def __init__(self) -> None:
        """Begin with the whole burst to spend."""
        self._recent: dict[str, int] = {}
        self._full_at_ns: int | None = None

    def refusal(self, status: StatusText) -> str:
        """Return why the text must not be sent, or an empty string."""
        t_ns = status.t_ns
        self._recent = {text: sent for text, sent in self._recent.items() if t_ns - sent < _REPEAT_NS}
        if status.text in self._recent:
            return "repeated"
        full_at_ns = t_ns if self._full_at_ns is None else max(self._full_at_ns, t_ns)
        if full_at_ns - t_ns > (_TEXT_BURST - 1) * _TEXT_NS:
            return "too fast"
        self._full_at_ns = full_at_ns + _TEXT_NS
        self._recent[status.text] = t_ns
        return ""
