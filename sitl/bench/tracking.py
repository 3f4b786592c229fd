"""How well neighbours are seen: scenes flown with our own odometry in the loop, then scored."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from companion.clock import SystemClock, seconds_to_ns
from companion.kernel_cache import load_kernels
from companion.messages import RegisteredScan
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.tracking.settings import Tape, TrackingSettings
from companion.perception.tracking.tracker import NeighbourTracker
from sitl.bench.swarm_scenes import (
    PLAN_START_S,
    MapFrame,
    NeighbourSights,
    SwarmScene,
    SwarmSettings,
    scene,
    stream,
)
from sitl.bench.synthetic_flights import T_BODY_LIDAR, T_LIDAR_IMU
from sitl.bench.tracking_score import FlightScore, Score
from sitl.kinematics import Kinematics
from sitl.wind import WindSettings
from sitl.worlds.distractors import DistractorSettings
from sitl.worlds.uav_body import UavBodySettings

HARD_WIND = WindSettings(mean_world_mps=(4.0, 2.0, 0.0), gust_mps=1.5, vertical_gust_mps=0.5)
"""What blows in windy cases."""


@dataclass(frozen=True, slots=True)
class Case:
    """What is flown.

    Attributes:
        scene: one of `swarm_scenes.SCENES`.
        neighbours: their number.
        range_m: their distance, where the scene lets it be chosen.
        tape: whether they wear tape, and the tracker looks for it.
        distractors: whether other reflective things stand about.
        windy: whether `HARD_WIND` blows.
    """

    scene: str
    neighbours: int
    range_m: float = 5.0
    tape: bool = True
    distractors: bool = False
    windy: bool = False

    @property
    def name(self) -> str:
        """Return the scene, with the range where it was chosen."""
        return f"{self.scene} {self.range_m:g} m" if self.scene in ("ring", "hover", "pass") else self.scene

    def build(self, seed: int) -> SwarmScene:
        """Return its scene."""
        wanted = SwarmSettings(
            uavs=self.neighbours + 1,
            range_m=self.range_m,
            distractors=DistractorSettings() if self.distractors else None,
            body=UavBodySettings(tape=self.tape),
            wind=HARD_WIND if self.windy else None,
        )
        return scene(self.scene, seed, wanted)


CASES: tuple[Case, ...] = (
    Case("ring", 3, 1.5),
    Case("ring", 4, 3.0),
    Case("ring", 4, 5.0),
    Case("ring", 5, 7.0),
    Case("ring", 5, 9.0),
    Case("ring", 5, 11.0),
    Case("ring", 4, 5.0, windy=True),
    Case("pass", 4, 2.0),
    Case("pass", 4, 3.0, distractors=True),
    Case("hover", 4, 4.0, distractors=True),
    Case("crowd", 1, distractors=True),
    Case("crowd", 2, distractors=True),
    Case("crowd", 6, distractors=True),
    Case("crowd", 10),
    Case("crowd", 10, distractors=True),
    Case("weave", 4),
    Case("weave", 4, distractors=True),
    Case("weave", 4, distractors=True, windy=True),
    Case("aggressive", 4),
    Case("aggressive", 4, distractors=True),
    Case("ring", 4, 5.0, tape=False),
    Case("weave", 4, tape=False),
)
"""What is flown by default: every range, 1 to 10 neighbours, distractors, wind, hard flying, no tape."""


@dataclass(frozen=True, slots=True)
class Flight:
    """One flight of a case.

    Attributes:
        case: what is flown.
        seed: of world, motion and noise.
        seconds: from power-on.
        settings: of the tracker; what their `tape` says is replaced by the case's.
    """

    case: Case
    seed: int
    seconds: float
    settings: TrackingSettings


def fly(flight: Flight) -> FlightScore:
    """Fly once and score it; equal flights give equal scores but for the processor times."""
    score = Score(seconds_to_ns(PLAN_START_S))
    tape = Tape.REFLECTIVE if flight.case.tape else Tape.NONE
    tracker = NeighbourTracker(flight.settings.model_copy(update={"tape": tape}), T_BODY_LIDAR)
    odometry = LidarInertialOdometry(OdometrySettings(), T_BODY_LIDAR, T_LIDAR_IMU)
    clock = SystemClock()
    frame: MapFrame | None = None
    truths: dict[int, tuple[NeighbourSights, Kinematics]] = {}
    chance = np.random.default_rng([flight.seed, 2])
    for step in stream(flight.case.build(flight.seed), flight.seconds, chance):
        frame = frame or MapFrame.of(step.truth)
        if step.sights is not None:
            truths[step.sights.sequence] = (step.sights, step.truth)
        for event in step.events:
            begun_ns = clock.thread_cpu_ns()
            outputs = odometry.handle(event)
            for output in outputs:
                if isinstance(output, RegisteredScan):
                    before_ns = clock.thread_cpu_ns()
                    tracks = tracker.observe(output)
                    after_ns = clock.thread_cpu_ns()
                    sights, truth = truths.pop(output.sequence)
                    times_ms = (after_ns - before_ns) * 1e-6, (after_ns - begun_ns) * 1e-6
                    score.add(tracks, output.odometry, sights, truth, frame, times_ms)
    return score.result()


def measure(
    cases: Sequence[Case],
    seeds: Sequence[int],
    seconds: float,
    on_case: Callable[[Case, FlightScore], None],
    on_flight: Callable[[int, int, Flight], None] = lambda done, of, flight: None,
    settings: TrackingSettings | None = None,
    processes: int = 1,
) -> None:
    """Fly every case with every seed; what is found does not depend on the number of processes.

    Args:
        cases: what to fly.
        seeds: of world, flight and noise.
        seconds: duration of each flight from power-on.
        on_case: called with all flights of a case as soon as they are known, in the order of the cases.
        on_flight: called after each flight with the number done, the number of all, and the flight.
        settings: of the tracker.
        processes: that fly at once.
    """
    tracking = settings or TrackingSettings()
    flights = [Flight(case, seed, seconds, tracking) for case in cases for seed in seeds]
    of_case: list[FlightScore] = []
    for number, score in enumerate(_flown(flights, processes), start=1):
        of_case.append(score)
        flight = flights[number - 1]
        on_flight(number, len(flights), flight)
        if len(of_case) == len(seeds):
            on_case(flight.case, FlightScore.joined(of_case))
            of_case = []


def _flown(flights: Sequence[Flight], processes: int) -> Iterator[FlightScore]:
    """Return the scores in the order of the flights."""
    if processes == 1:
        yield from map(fly, flights)
        return
    # A fresh interpreter for each: threads of numerical libraries do not survive a fork.
    fresh = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(processes, len(flights)), fresh, initializer=_begin)
    before = set(multiprocessing.active_children())
    try:
        yield from pool.map(fly, flights)
    except BaseException:
        # Nobody waits for what is still in the air.
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        raise
    pool.shutdown()


def _begin() -> None:
    """Prepare a process: interruptions are left to the parent, which ends its children itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    load_kernels()
