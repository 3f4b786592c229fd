"""Decides from the truth whether a simulated flight has ended, and how."""

from companion.clock import ns_to_seconds, seconds_to_ns
from sitl.outcome import Ending
from sitl.scenario import Stage
from sitl.vehicle import SimulatedVehicle

_SETTLE_NS = seconds_to_ns(0.5)


class Referee:
    """Watches one vehicle; never seen by anything that flies."""

    def __init__(self, stage: Stage, vehicle: SimulatedVehicle) -> None:
        """Begin at the vehicle's power-on."""
        self._tolerance_m = stage.scenario.goal_tolerance_m
        self._max_duration_ns = stage.max_duration_ns
        self._vehicle = vehicle
        self._boot_ns = vehicle.t_ns
        self._has_flown = False
        self._landed_ns: int | None = None
        self.t_ns = vehicle.t_ns
        self.over = False
        self.reason = ""

    @property
    def elapsed_s(self) -> float:
        """Simulated seconds since power-on."""
        return ns_to_seconds(self.t_ns - self._boot_ns)

    @property
    def goal_distance_m(self) -> float:
        """Horizontal distance between the vehicle and its goal."""
        return self._vehicle.goal_distance_m()

    def watch(self, t_ns: int) -> None:
        """Look at the vehicle at `t_ns`; sets `over` and `reason` when the flight has ended."""
        self.t_ns = t_ns
        vehicle = self._vehicle
        self._has_flown = self._has_flown or not vehicle.autopilot.landed
        if self._has_flown and vehicle.on_ground_disarmed:
            self._landed_ns = self._landed_ns or t_ns
        else:
            self._landed_ns = None
        if vehicle.airframe.collisions:
            self._end("collision")
        elif self._landed_ns is not None and t_ns - self._landed_ns >= _SETTLE_NS:
            near = self.goal_distance_m <= self._tolerance_m
            self._end("landed at the goal" if near else f"landed {self.goal_distance_m:.1f} m from the goal")
        elif t_ns - self._boot_ns >= self._max_duration_ns:
            self._end(f"not landed after {self.elapsed_s:.0f} s")

    def ending(self, wall_time_s: float) -> Ending:
        """Return how the flight ended."""
        collisions = self._vehicle.airframe.collisions
        success = self.reason == "landed at the goal" and not collisions
        return Ending(
            success=success,
            reason=self.reason,
            goal_distance_m=self.goal_distance_m,
            collisions=collisions,
            sim_time_s=self.elapsed_s,
            wall_time_s=wall_time_s,
        )

    def _end(self, reason: str) -> None:
        self.over = True
        self.reason = reason
