"""The mission: waypoints one after the other, pauses, and how fast to approach."""

from enum import Enum

import numpy as np

from companion.clock import ns_to_seconds, seconds_to_ns
from companion.control.leader.settings import MissionSettings
from companion.messages import FloatArray


class Phase(Enum):
    """What the mission is at."""

    WAITING = "waiting"
    FLYING = "flying"
    PAUSING = "pausing"
    FINISHED = "finished"


class Mission:
    """Progress along the waypoints. Waypoints once reached stay reached when control is taken again."""

    def __init__(self, settings: MissionSettings) -> None:
        self._settings = settings
        self._waypoints = np.array(settings.waypoints_m, np.float64).reshape(-1, 3)
        self._start_ns = 0
        self._pause_start_ns = 0
        self.index = 0
        """Index of the waypoint being approached or held."""
        self.phase = Phase.WAITING
        """What to do now."""

    def start(self, p_map: FloatArray, t_ns: int) -> None:
        """Begin, or go on, from standstill at `p_map` (3,) at host time `t_ns`."""
        if not self._settings.waypoints_m:
            self._waypoints = np.asarray(p_map, np.float64).reshape(1, 3).copy()
        if self.phase is Phase.FINISHED:
            self.index = 0
        self.phase = Phase.WAITING
        self._start_ns = t_ns

    @property
    def waypoint_map(self) -> FloatArray:
        """The waypoint being approached, (3,) m."""
        return np.asarray(self._waypoints[self.index])

    def height(self, otherwise: float) -> float:
        """Return the height of the waypoint being approached, m, or `otherwise` before there is any."""
        return float(self.waypoint_map[2]) if len(self._waypoints) else otherwise

    @property
    def at_last_waypoint(self) -> bool:
        """Whether no other waypoint follows."""
        return self.index == len(self._waypoints) - 1

    def update(self, p_map: FloatArray, goal_map: FloatArray, t_ns: int) -> None:
        """Move on in the mission.

        Args:
            p_map: (3,) position of the vehicle, m.
            goal_map: (3,) where to stop for the present waypoint, m.
            t_ns: host time.
        """
        settings = self._settings
        if self.phase is Phase.WAITING and t_ns - self._start_ns >= seconds_to_ns(settings.wait_s):
            self.phase = Phase.FLYING
        if self.phase is Phase.FLYING and np.linalg.norm(goal_map - p_map) < settings.arrival_radius_m:
            if self._pause_s() > 0.0 or self.at_last_waypoint:
                self.phase = Phase.PAUSING
                self._pause_start_ns = t_ns
            else:
                self.index += 1
        if self.phase is Phase.PAUSING and t_ns - self._pause_start_ns >= seconds_to_ns(self._pause_s()):
            if self.at_last_waypoint:
                self.phase = Phase.FINISHED
            else:
                self.phase = Phase.FLYING
                self.index += 1

    def speed(self, goal_distance: float, t_ns: int) -> float:
        """Return the horizontal speed allowed now, m/s.

        Args:
            goal_distance: horizontal distance to where to stop, m.
            t_ns: host time.
        """
        settings = self._settings
        moving_s = ns_to_seconds(t_ns - self._start_ns) - settings.wait_s
        if moving_s <= 0.0:
            return 0.0
        ramp = min(1.0, moving_s / settings.ramp_s) if settings.ramp_s > 0.0 else 1.0
        speed = settings.speed_mps * ramp
        if self._pause_s() > 0.0 or self.at_last_waypoint:
            speed = min(speed, settings.brake_gain_per_s * goal_distance)
        return speed

    def climb_rate(self, height_error: float) -> float:
        """Return the vertical speed, m/s up, for the goal's height minus the vehicle's, m."""
        settings = self._settings
        limit = settings.max_vertical_speed_mps
        return min(max(settings.vertical_gain_per_s * height_error, -limit), limit)

    def _pause_s(self) -> float:
        settings = self._settings
        if self.at_last_waypoint:
            return settings.final_hold_s
        return (
            settings.waypoint_holds_s[self.index] if settings.waypoint_holds_s else settings.waypoint_hold_s
        )
