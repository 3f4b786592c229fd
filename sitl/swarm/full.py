"""A swarm in full fidelity: packets, odometry, tracking and autopilot of every vehicle, step by step."""

import gc
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from companion.clock import SystemClock, ns_to_seconds, seconds_to_ns
from companion.logs.metrics import DEFAULT_CAP_M
from companion.messages import FlightState
from sitl.dynamics import STEP_NS
from sitl.lockstep import BOOT_NS
from sitl.scenario import Scenario
from sitl.swarm.lockstep import FlightPlan
from sitl.swarm.process import Swarm
from sitl.swarm.record import TrialRecord
from sitl.swarm.referee import SwarmReferee, TrialNames
from sitl.swarm.scene import SwarmScene
from sitl.swarm.settings import TerminationSettings
from sitl.swarm.table import Table
from sitl.swarm.vehicles import Crew, shares

_PROGRESS_PERIOD_NS = seconds_to_ns(1.0)

Progress = Callable[[float, str, float], None]
"""Called with (seconds since power-on, what is going on, the leader's distance to its goal in m)."""


@dataclass(frozen=True, slots=True)
class MemberEnding:
    """How one vehicle ended.

    Attributes:
        number: 0 is the leader.
        state: of its companion.
        leader_distance_m: how far it was from the leader.
        obstacle_contacts: times it touched an obstacle.
        log: its flight log.
    """

    number: int
    state: FlightState
    leader_distance_m: float
    obstacle_contacts: int
    log: Path


@dataclass(frozen=True, slots=True)
class FullFlight:
    """What a flight of a swarm came to.

    Attributes:
        record: the trial, judged.
        members: one entry a vehicle.
        start_s: when all companions were in control, in seconds after power-on; None if they never were.
        sim_time_s, wall_time_s: simulated and real duration.
    """

    record: TrialRecord
    members: tuple[MemberEnding, ...]
    start_s: float | None
    sim_time_s: float
    wall_time_s: float

    @property
    def logs(self) -> list[Path]:
        """The flight logs, the leader's first."""
        return [member.log for member in self.members]


def fly_full(
    scene: SwarmScene,
    crew: Crew,
    setting: Scenario,
    out_dir: Path,
    names: TrialNames,
    *,
    termination: TerminationSettings | None = None,
    cap_m: float = DEFAULT_CAP_M,
    workers: int | None = None,
    packets: bool = False,
    on_progress: Progress | None = None,
) -> FullFlight:
    """Fly one trial in full fidelity.

    Args:
        scene: the world, the start and the leader's way.
        crew: profiles of leader and followers.
        setting: weather, network, vehicle type and operator; its world, start, swarm and vehicle radius are
            not looked at.
        out_dir: gets a folder with a log for every vehicle; there must be no logs in it.
        names: what the trial is called.
        termination: what ends it.
        cap_m: obstacles farther than this do not count for MDO.
        workers: processes, this one included; one for each core by default. Results do not depend on it.
        packets: log what a replay needs, as the profiles say; light logs otherwise.
        on_progress: called once a simulated second.

    Raises:
        LogError, OSError: if a log cannot be created.
        WorkerLostError: if a process dies; what was logged before stays readable.
    """
    clock = SystemClock()
    wall_start_ns = clock.now_ns()
    rules = termination or TerminationSettings()
    # One radius for contacts with obstacles and among each other, as in abstract fidelity.
    setting = setting.model_copy(update={"vehicle_radius_m": rules.vehicle_radius_m})
    plan = FlightPlan(setting, crew, scene, out_dir, packets)
    referee = SwarmReferee(scene, rules, cap_m, BOOT_NS)
    swarm = Swarm(plan, shares(plan.vehicles, workers or len(os.sched_getaffinity(0))))
    try:
        table = _fly(swarm, referee, on_progress)
        swarm.end(table)
    finally:
        swarm.close()
        gc.unfreeze()
    return FullFlight(
        record=referee.record(names),
        members=_endings(plan, table),
        start_s=None if referee.started_ns is None else ns_to_seconds(referee.started_ns - BOOT_NS),
        sim_time_s=referee.elapsed_s,
        wall_time_s=ns_to_seconds(clock.now_ns() - wall_start_ns),
    )


def _fly(swarm: Swarm, referee: SwarmReferee, on_progress: Progress | None) -> Table:
    """Advance everybody until the referee ends the trial; return where they are then."""
    gc.collect()
    gc.freeze()  # nothing built so far becomes garbage during the flight
    t_ns = next_progress_ns = BOOT_NS
    before = swarm.first_table()
    while True:
        now = swarm.move()
        t_ns += STEP_NS
        referee.watch(t_ns, before, now)
        if on_progress is not None and t_ns >= next_progress_ns:
            next_progress_ns = t_ns + _PROGRESS_PERIOD_NS
            on_progress(referee.elapsed_s, _phase(referee), referee.goal_distance_m)
        if referee.over:
            return now
        swarm.live(before, now, start_given=referee.start_given)
        before = now


def _phase(referee: SwarmReferee) -> str:
    if referee.started_ns is not None:
        return "flying"
    return "starting" if referee.start_given else "taking off"


def _endings(plan: FlightPlan, table: Table) -> tuple[MemberEnding, ...]:
    return tuple(
        MemberEnding(
            number=number,
            state=table.states[number],
            leader_distance_m=float(((table.p_world[number] - table.p_world[0]) ** 2).sum() ** 0.5),
            obstacle_contacts=int(table.collisions[number]),
            log=plan.log_path(number),
        )
        for number in range(plan.vehicles)
    )
