"""Decides from the truth whether a simulated flight has ended, and how."""

from dataclasses import dataclass

import numpy as np

from companion.clock import ns_to_seconds, seconds_to_ns
from companion.messages import FloatArray
from sitl.outcome import Ending
from sitl.scenario import Stage

_SETTLE_NS = seconds_to_ns(2.0)
_AT_THE_GOAL = "landed at the goal"


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """What can be seen of a vehicle from outside.

    Attributes:
        t_ns: host time.
        p_world: (3,) true position of the body, metres.
        landed: it stands on the ground.
        armed: its motors turn.
        collisions: contacts so far with anything but the ground.
    """

    t_ns: int
    p_world: FloatArray
    landed: bool
    armed: bool
    collisions: int


class Referee:
    """Watches one vehicle; never seen by anything that flies."""

    def __init__(self, stage: Stage, boot_ns: int) -> None:
        """Begin at the vehicle's power-on."""
        self._goal_world = stage.goal_world
        self._tolerance_m = stage.scenario.goal_tolerance_m
        self._max_duration_ns = stage.max_duration_ns
        self._boot_ns = boot_ns
        self._has_flown = False
        self._landed_ns: int | None = None
        self._collisions = 0
        self.goal_distance_m = float(np.linalg.norm((stage.goal_world - stage.T_world_start.p)[:2]))
        self.t_ns = boot_ns
        self.over = False
        self.reason = ""

    @property
    def elapsed_s(self) -> float:
        """Simulated seconds since power-on."""
        return ns_to_seconds(self.t_ns - self._boot_ns)

    def watch(self, seen: Sighting) -> None:
        """Look at the vehicle; sets `over` and `reason` when the flight has ended."""
        self.t_ns = seen.t_ns
        self.goal_distance_m = float(np.linalg.norm((seen.p_world - self._goal_world)[:2]))
        self._collisions = seen.collisions
        self._has_flown = self._has_flown or (seen.armed and not seen.landed)
        if not (self._has_flown and seen.landed and not seen.armed):
            self._landed_ns = None
        elif self._landed_ns is None:
            self._landed_ns = seen.t_ns
        if seen.collisions:
            self.end("collision")
        elif self._landed_ns is not None and seen.t_ns - self._landed_ns >= _SETTLE_NS:
            near = self.goal_distance_m <= self._tolerance_m
            self.end(_AT_THE_GOAL if near else f"landed {self.goal_distance_m:.1f} m from the goal")
        elif seen.t_ns - self._boot_ns >= self._max_duration_ns:
            self.end(f"not landed after {self.elapsed_s:.0f} s")

    def end(self, reason: str) -> None:
        """End the flight, if it has not ended yet."""
        if not self.over:
            self.over = True
            self.reason = reason

    def ending(self, wall_time_s: float) -> Ending:
        """Return how the flight ended."""
        return Ending(
            success=self.reason == _AT_THE_GOAL and not self._collisions,
            reason=self.reason,
            goal_distance_m=self.goal_distance_m,
            collisions=self._collisions,
            sim_time_s=self.elapsed_s,
            wall_time_s=wall_time_s,
        )
