"""When each stream of one MAVLink link is due, on the autopilot's boot clock."""

import heapq
from collections.abc import Mapping

ONBOARD_RATES_HZ: Mapping[str, float] = {
    "HEARTBEAT": 1.0,
    "ATTITUDE": 100.0,
    "ATTITUDE_QUATERNION": 50.0,
    "HIGHRES_IMU": 50.0,
    "GLOBAL_POSITION_INT": 50.0,
    "LOCAL_POSITION_NED": 30.0,
    "ODOMETRY": 30.0,
    "POSITION_TARGET_LOCAL_NED": 10.0,
    "ATTITUDE_TARGET": 10.0,
    "DISTANCE_SENSOR": 10.0,
    "ALTITUDE": 10.0,
    "VFR_HUD": 10.0,
    "SERVO_OUTPUT_RAW": 10.0,
    "GPS_RAW_INT": 8.0,
    "SYS_STATUS": 5.0,
    "EXTENDED_SYS_STATE": 5.0,
    "ESTIMATOR_STATUS": 1.0,
    "SYSTEM_TIME": 1.0,
    "PING": 1.0,
    "MISSION_CURRENT": 1.0,
    "SCALED_PRESSURE": 1.0,
    "BATTERY_STATUS": 0.5,
    "HOME_POSITION": 0.5,
    "CURRENT_MODE": 0.5,
    "VIBRATION": 0.5,
}
"""The companion link's streams, as measured on PX4 1.18."""

GROUND_RATES_HZ: Mapping[str, float] = {
    "HEARTBEAT": 1.0,
    "ATTITUDE": 15.0,
    "GLOBAL_POSITION_INT": 5.0,
    "LOCAL_POSITION_NED": 5.0,
    "ALTITUDE": 1.0,
    "VFR_HUD": 4.0,
    "POSITION_TARGET_LOCAL_NED": 1.5,
    "GPS_RAW_INT": 1.0,
    "SYS_STATUS": 1.0,
    "EXTENDED_SYS_STATE": 1.0,
    "ESTIMATOR_STATUS": 1.0,
    "SYSTEM_TIME": 1.0,
    "BATTERY_STATUS": 0.5,
    "HOME_POSITION": 0.5,
    "CURRENT_MODE": 0.5,
}
"""The ground station link's streams."""

RATE_LIMITS_HZ: Mapping[str, float] = {"CURRENT_MODE": 2.0}
"""Streams that cannot be raised beyond a rate."""

FIXED = frozenset({"HEARTBEAT"})
"""Streams whose interval cannot be changed."""

_FASTEST_US = 5_000
_SLOWEST_US = 3_600_000_000


class StreamSchedule:
    """Keeps the due times of one link's streams."""

    def __init__(self, rates_hz: Mapping[str, float]) -> None:
        """Start with default rates; everything is due at once."""
        self._defaults_us = {name: round(1.0e6 / rate) for name, rate in rates_hz.items()}
        self._periods_us = dict(self._defaults_us)
        self._due = [(0, order, name) for order, name in enumerate(rates_hz)]
        self._orders = {name: order for order, name in enumerate(rates_hz)}
        heapq.heapify(self._due)

    def take_due(self, boot_us: int) -> list[str]:
        """Return the streams to send now and move them to their next time."""
        taken: list[str] = []
        while self._due and self._due[0][0] <= boot_us:
            due_us, order, name = heapq.heappop(self._due)
            period_us = self._periods_us.get(name)
            if period_us is None:
                continue
            taken.append(name)
            next_us = due_us + period_us
            if next_us <= boot_us:
                next_us = boot_us + period_us
            heapq.heappush(self._due, (next_us, order, name))
        return taken

    def interval_us(self, name: str) -> int:
        """Return a stream's interval in microseconds, -1 if it is off."""
        return self._periods_us.get(name, -1)

    def set_interval(self, name: str, interval_us: float, boot_us: int) -> bool:
        """Change a stream's interval: 0 for the default, negative for off.

        Returns:
            False if this stream's interval cannot be changed.
        """
        if name in FIXED or not abs(interval_us) < _SLOWEST_US:
            return False
        order = self._orders.setdefault(name, len(self._orders))
        self._due = [entry for entry in self._due if entry[2] != name]
        heapq.heapify(self._due)
        self._periods_us.pop(name, None)
        if interval_us < 0.0:
            return True
        period_us = self._defaults_us.get(name) if interval_us == 0.0 else round(interval_us)
        if period_us is None:
            return True
        fastest_us = round(1.0e6 / RATE_LIMITS_HZ[name]) if name in RATE_LIMITS_HZ else _FASTEST_US
        self._periods_us[name] = max(period_us, fastest_us)
        heapq.heappush(self._due, (boot_us + self._periods_us[name], order, name))
        return True
