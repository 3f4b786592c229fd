"""A flight step by step: no sockets, no threads, no real time, the same bytes, the same result each time."""

import gc
from collections.abc import Callable
from pathlib import Path

from companion.clock import SystemClock, ns_to_seconds, seconds_to_ns
from companion.config import profile_text
from companion.logs.metadata import FlightMetadata
from companion.logs.writer import FlightLog
from companion.messages import FlightState
from sitl.outcome import Ending
from sitl.referee import Referee
from sitl.scenario import Stage
from sitl.stepped_vehicle import SteppedVehicle

BOOT_NS = 1_000_000_000
"""Host time at power-on; any value but zero, which some fields take for "never"."""

_PROGRESS_PERIOD_NS = seconds_to_ns(1.0)

Progress = Callable[[float, str, float], None]


class Lockstep:
    """One vehicle and its referee, advanced together in steps of 5 ms."""

    def __init__(self, stage: Stage, log: FlightLog) -> None:
        """Switch everything on."""
        self._vehicle = SteppedVehicle(stage, log, BOOT_NS)
        self._referee = Referee(stage, BOOT_NS)

    @property
    def referee(self) -> Referee:
        """Who decides whether the flight has ended, and how."""
        return self._referee

    @property
    def state(self) -> FlightState:
        """The companion's state."""
        return self._vehicle.companion.state

    def end_peer(self) -> None:
        """Let the other odometry process die."""
        self._vehicle.end_peer()

    def step(self) -> None:
        """Advance everything by 5 ms."""
        self._vehicle.move()
        self._vehicle.live()
        self._referee.watch(self._vehicle.simulated.sighting())


def open_log(stage: Stage, log_path: Path) -> FlightLog:
    """Create the log of a flight step by step."""
    metadata = FlightMetadata(
        vehicle=stage.profile.vehicle.name,
        role=stage.profile.role,
        mode="lockstep",
        configuration=profile_text(stage.profile),
        seed=stage.scenario.seed,
    )
    return FlightLog(log_path, stage.profile.log, metadata, threaded=False)


def fly_lockstep(stage: Stage, log_path: Path, on_progress: Progress | None = None) -> Ending:
    """Fly one scenario to its end and write its log.

    Args:
        stage: the scenario with its seed.
        log_path: where the log goes; must not exist.
        on_progress: called once per simulated second with (seconds, state, goal distance in m).
    """
    clock = SystemClock()
    wall_start_ns = clock.now_ns()
    log = open_log(stage, log_path)
    try:
        lockstep = Lockstep(stage, log)
        gc.collect()
        gc.freeze()  # nothing built so far ever becomes garbage during the flight
        referee = lockstep.referee
        next_progress_ns = BOOT_NS
        while not referee.over:
            lockstep.step()
            if on_progress is not None and referee.t_ns >= next_progress_ns:
                next_progress_ns = referee.t_ns + _PROGRESS_PERIOD_NS
                on_progress(referee.elapsed_s, lockstep.state.value, referee.goal_distance_m)
    finally:
        log.close()
    return referee.ending(wall_time_s=ns_to_seconds(clock.now_ns() - wall_start_ns))
