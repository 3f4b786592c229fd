"""How well neighbours are seen: scenes flown with our own odometry in the loop, then scored."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.clock import SystemClock, seconds_to_ns
from companion.messages import RegisteredScan
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.tracking.settings import Tape, TrackingSettings
from companion.perception.tracking.tracker import NeighbourTracker
from sitl.bench.swarm_scenes import (
    PLAN_START_S,
    MapFrame,
    NeighbourSights,
    SwarmSettings,
    scene,
    stream,
)
from sitl.bench.synthetic_flights import T_BODY_LIDAR, T_LIDAR_IMU
from sitl.bench.tracking_score import Row, Score
from sitl.kinematics import Kinematics
from sitl.worlds.distractors import DistractorSettings
from sitl.worlds.uav_body import UavBodySettings

OnProgress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Case:
    """What is flown.

    Attributes:
        scene: one of `swarm_scenes.SCENES`.
        neighbours: their number.
        range_m: their distance, where the scene lets it be chosen.
        tape: whether they wear tape, and the tracker looks for it.
        distractors: whether other reflective things stand about.
    """

    scene: str
    neighbours: int
    range_m: float = 5.0
    tape: bool = True
    distractors: bool = False

    @property
    def name(self) -> str:
        """Return the scene, with the range where it was chosen."""
        return f"{self.scene} {self.range_m:g} m" if self.scene in ("ring", "hover", "pass") else self.scene


CASES: tuple[Case, ...] = (
    Case("ring", 3, 1.5),
    Case("ring", 4, 3.0),
    Case("ring", 4, 5.0),
    Case("ring", 5, 7.0),
    Case("ring", 5, 9.0),
    Case("ring", 5, 11.0),
    Case("pass", 4, 2.0),
    Case("pass", 4, 3.0, distractors=True),
    Case("hover", 4, 4.0, distractors=True),
    Case("crowd", 1, distractors=True),
    Case("crowd", 10),
    Case("crowd", 10, distractors=True),
    Case("weave", 4),
    Case("weave", 4, distractors=True),
    Case("aggressive", 4),
    Case("aggressive", 4, distractors=True),
    Case("ring", 4, 5.0, tape=False),
    Case("weave", 4, tape=False),
)
"""What is flown by default: every range, 1 to 10 neighbours, distractors, wind, hard flying, no tape."""


def measure(
    cases: Sequence[Case],
    seeds: Sequence[int],
    seconds: float,
    on_rows: Callable[[list[Row]], None],
    on_progress: OnProgress = lambda text: None,
    settings: TrackingSettings | None = None,
) -> list[Row]:
    """Fly every case with every seed; returns the rows of all cases.

    Args:
        cases: what to fly.
        seeds: of world, flight and noise.
        seconds: duration of each flight from power-on.
        on_rows: called with the rows of each case as soon as they are known.
        on_progress: called with a line about every second of flight.
        settings: of the tracker; what its `tape` says is replaced by each case's.
    """
    rows: list[Row] = []
    for case in cases:
        score = Score(seconds_to_ns(PLAN_START_S))
        for seed in seeds:
            score.start_flight()
            _fly(case, seed, seconds, score, settings or TrackingSettings(), on_progress)
        found = score.rows(case.name, case.neighbours, tape=case.tape, distractors=case.distractors)
        on_rows(found)
        rows += found
    return rows


def _fly(
    case: Case,
    seed: int,
    seconds: float,
    score: Score,
    settings: TrackingSettings,
    on_progress: OnProgress,
) -> None:
    wanted = SwarmSettings(
        uavs=case.neighbours + 1,
        range_m=case.range_m,
        distractors=DistractorSettings() if case.distractors else None,
        body=UavBodySettings(tape=case.tape),
    )
    odometry = LidarInertialOdometry(OdometrySettings(), T_BODY_LIDAR, T_LIDAR_IMU)
    tape = Tape.REFLECTIVE if case.tape else Tape.NONE
    tracker = NeighbourTracker(settings.model_copy(update={"tape": tape}), T_BODY_LIDAR)
    clock = SystemClock()
    frame: MapFrame | None = None
    truths: dict[int, tuple[NeighbourSights, Kinematics]] = {}
    for step in stream(scene(case.scene, seed, wanted), seconds, np.random.default_rng([seed, 2])):
        frame = frame or MapFrame.of(step.truth)
        if step.sights is not None:
            truths[step.sights.sequence] = (step.sights, step.truth)
            if step.sights.sequence % 10 == 0:
                on_progress(f"{case.name}, seed {seed}: {step.t_sensor_ns * 1e-9:.0f} of {seconds:.0f} s")
        for event in step.events:
            for output in odometry.handle(event):
                if isinstance(output, RegisteredScan):
                    before_ns = clock.thread_cpu_ns()
                    tracks = tracker.observe(output)
                    cpu_ms = (clock.thread_cpu_ns() - before_ns) * 1e-6
                    sights, truth = truths.pop(output.sequence)
                    score.add(tracks, output.odometry, sights, truth, frame, cpu_ms)
