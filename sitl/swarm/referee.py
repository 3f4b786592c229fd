"""Decides from the truth when a swarm's trial begins and ends, and how."""

from dataclasses import dataclass

import numpy as np

from companion.clock import ns_to_seconds, seconds_to_ns
from companion.logs.metrics import measure, mission_progress_percent
from companion.messages import FlightState, FloatArray
from sitl.swarm.record import End, TrialRecord
from sitl.swarm.scene import SwarmScene
from sitl.swarm.settings import TerminationSettings
from sitl.swarm.table import Table

SAMPLE_NS = seconds_to_ns(0.05)
PREPARATION_S = 60.0
"""Longest time from power-on until all companions are in control."""

_STEP_REACH_M = 0.5  # no pair comes this much nearer and parts again within one step
_IN_CONTROL = (FlightState.ACTIVE, FlightState.HOLDING, FlightState.LANDING)


@dataclass(frozen=True, slots=True)
class TrialNames:
    """What a trial is called in tables.

    Attributes:
        world: name of the world.
        method: name of the followers' method.
        trial: its number in a campaign.
    """

    world: str
    method: str
    trial: int = 0


class SwarmReferee:
    """Watches a whole swarm; never seen by anything that flies.

    Attributes:
        start_given: all vehicles have hovered and may be authorised.
        over: the trial has ended.
        end: how, once it has.
        ended_by: numbers of the vehicles concerned.
        started_ns: host time at which all companions were in control, None before.
    """

    def __init__(
        self, scene: SwarmScene, termination: TerminationSettings, cap_m: float, boot_ns: int
    ) -> None:
        """Begin at the vehicles' power-on; obstacles farther than `cap_m` do not count for MDO."""
        self._scene = scene
        self._rules = termination
        self._cap_m = cap_m
        self._boot_ns = boot_ns
        self._obstacles = scene.world.obstacles()
        self._firsts, self._seconds = np.triu_indices(len(scene.starts_world), k=1)
        self._p: list[FloatArray] = []
        self._v: list[FloatArray] = []
        self._t_ns = boot_ns
        self._now: Table | None = None
        self.start_given = False
        self.over = False
        self.end: End = "timeout"
        self.ended_by: tuple[int, ...] = ()
        self.started_ns: int | None = None

    @property
    def elapsed_s(self) -> float:
        """Seconds since power-on."""
        return ns_to_seconds(self._t_ns - self._boot_ns)

    @property
    def trial_s(self) -> float:
        """Seconds since the followers were let go; 0 before."""
        return 0.0 if self.started_ns is None else ns_to_seconds(self._t_ns - self.started_ns)

    @property
    def goal_distance_m(self) -> float:
        """Horizontal distance of the leader from its goal."""
        p = self._scene.starts_world[0] if self._now is None else self._now.p_world[0]
        return float(np.linalg.norm((p - self._scene.waypoints_world[-1])[:2]))

    def watch(self, t_ns: int, before: Table, now: Table) -> None:
        """Look at everybody at the end of a step.

        Args:
            t_ns: host time of its end.
            before: everybody at its beginning.
            now: everybody at its end.
        """
        self._t_ns, self._now = t_ns, now
        self.start_given = self.start_given or now.ready
        if self._touched(before, now):
            return
        if self.started_ns is None:
            self._prepare(now)
        if self.started_ns is None or self.over:
            return
        if (t_ns - self.started_ns) % SAMPLE_NS == 0:
            self._p.append(now.p_world.copy())
            self._v.append(now.v_world.copy())
        self._judge(now)

    def stop(self, end: End, ended_by: tuple[int, ...] = ()) -> None:
        """End the trial, if it has not ended yet."""
        if not self.over:
            self.over, self.end, self.ended_by = True, end, ended_by

    def record(self, names: TrialNames) -> TrialRecord:
        """Return what the trial came to; numbers are NaN where it was too short for any."""
        scene = self._scene
        numbers = [float("nan")] * 4
        progress = 0.0
        if len(self._p) > 1 and self._now is not None:
            p = np.stack(self._p)
            clearances = self._obstacles.clearance(p)
            t = np.arange(len(p)) * ns_to_seconds(SAMPLE_NS)
            metrics = measure(t, p, np.stack(self._v), clearances, cap_m=self._cap_m)
            numbers = [metrics.FR.mean, metrics.MS.mean, metrics.AL.mean, metrics.MDO.mean]
            progress = mission_progress_percent(
                p[0, 0], scene.waypoints_world[-1], self._now.p_world[0], success=self.end == "success"
            )
        return TrialRecord(
            world=names.world,
            method=names.method,
            followers=len(scene.starts_world) - 1,
            fidelity="full",
            trial=names.trial,
            seed=scene.seed,
            scene_hash=scene.scene_hash,
            end=self.end,
            ended_by=self.ended_by,
            t_end_s=self.trial_s,
            mission_progress_percent=progress,
            flock_radius_m=numbers[0],
            minimum_separation_m=numbers[1],
            alignment=numbers[2],
            obstacle_distance_m=numbers[3],
            steps=len(self._p),
        )

    def _touched(self, before: Table, now: Table) -> bool:
        """End the trial if anybody touched anything on the way between two steps."""
        hit = np.flatnonzero(now.collisions > 0)
        if len(hit):
            self.stop("obstacle", tuple(hit.tolist()))
            return True
        if not len(self._firsts):
            return False
        nearest_m = np.linalg.norm(now.p_world[self._firsts] - now.p_world[self._seconds], axis=1).min()
        if nearest_m > 2.0 * self._rules.vehicle_radius_m + _STEP_REACH_M:
            return False
        apart = before.p_world[self._firsts] - before.p_world[self._seconds]
        change = now.p_world[self._firsts] - now.p_world[self._seconds] - apart
        span = np.maximum(np.einsum("pk,pk->p", change, change), 1e-18)
        nearest = np.clip(-np.einsum("pk,pk->p", apart, change) / span, 0.0, 1.0)
        distances = np.linalg.norm(apart + nearest[:, None] * change, axis=1)
        worst = int(np.argmin(distances))
        if distances[worst] < 2.0 * self._rules.vehicle_radius_m:
            pair = (int(self._firsts[worst]), int(self._seconds[worst]))
            self.stop("leader_follower" if pair[0] == 0 else "uav_uav", pair)
            return True
        return False

    def _prepare(self, now: Table) -> None:
        waiting = tuple(k for k, state in enumerate(now.states) if state is not FlightState.ACTIVE)
        if not waiting:
            self.started_ns = self._t_ns
        elif self.elapsed_s >= PREPARATION_S:
            self.stop("failsafe", waiting)

    def _judge(self, now: Table) -> None:
        rules, height = self._rules, now.p_world[:, 2]
        assert self.started_ns is not None
        outside = np.flatnonzero((height < rules.altitude_m[0]) | (height > rules.altitude_m[1]))
        gone = tuple(k for k, state in enumerate(now.states) if state not in _IN_CONTROL)
        seen_s = max(now.leader_seen_s, ns_to_seconds(self.started_ns))
        if len(outside):
            self.stop("altitude", tuple(outside.tolist()))
        elif gone:
            self.stop("failsafe", gone)
        elif ns_to_seconds(self._t_ns) - seen_s > rules.leader_unseen_s:
            self.stop("leader_lost", (0,))
        elif now.mission_over:
            self._judge_arrival(now)
        elif self.trial_s >= self._scene.timeout_s:
            self.stop("timeout", (0,))

    def _judge_arrival(self, now: Table) -> None:
        """The leader's pause is over: at the goal, with everybody near it, or not."""
        rules = self._rules
        if np.linalg.norm(now.p_world[0] - self._scene.waypoints_world[-1]) > rules.goal_tolerance_m:
            self.stop("timeout", (0,))
            return
        apart = np.linalg.norm(now.p_world - now.p_world[0], axis=1)
        far = np.flatnonzero(apart > rules.gathered_m)
        self.stop("scattered" if len(far) else "success", tuple(far.tolist()))
