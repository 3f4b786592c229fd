"""Our odometry beside its peers on the same emulated flights."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.geometry.trajectory import Trajectory
from companion.perception.odometry.settings import OdometrySettings
from sitl.bench.comparison import Result, Row, enter, results
from sitl.bench.contenders import Mount
from sitl.bench.courses import course
from sitl.bench.synthetic_flights import SCAN_NS, T_BODY_LIDAR, T_LIDAR_IMU, FlightStep, stream
from sitl.bench.trial import Race

MOUNT = Mount(T_BODY_LIDAR, T_LIDAR_IMU)
OnProgress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """What to fly and who takes part.

    Attributes:
        worlds: names from `sitl.bench.courses.COURSES`.
        systems: names from `sitl.bench.comparison.SYSTEMS`.
        duration_s: of each flight.
        seed: of world and noise.
        settings: of our own odometry, its defaults if None.
    """

    worlds: Sequence[str]
    systems: Sequence[str]
    duration_s: float = 60.0
    seed: int = 1
    settings: OdometrySettings | None = None


class _Truth:
    """The true motion at the ends of scans; memory is taken in advance."""

    def __init__(self, scans: int) -> None:
        self._t_ns = np.full(scans + 1, 0, dtype=np.int64)
        self._motion = np.full((scans + 1, 10), np.nan)
        self._count = 0

    def note(self, step: FlightStep) -> None:
        if step.t_sensor_ns % SCAN_NS == 0:
            truth = step.truth
            self._t_ns[self._count] = step.t_sensor_ns
            self._motion[self._count] = (*truth.p_world, *truth.q_world_body, *truth.v_world)
            self._count += 1

    def trajectory(self) -> Trajectory:
        known = self._motion[: self._count]
        return Trajectory(self._t_ns[: self._count].copy(), known[:, :3].copy(), known[:, 3:7].copy())

    @property
    def v_world(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return self._motion[: self._count, 7:]


def measure(
    plan: Plan,
    on_result: Callable[[Result], None] = lambda result: None,
    on_progress: OnProgress = lambda text: None,
) -> list[Result]:
    """Fly every world once, all systems at the same time.

    Args:
        plan: what to fly and who takes part.
        on_result: called with each result once its flight is over.
        on_progress: called with a short text every second of flight.
    """
    found: list[Result] = []
    for world in plan.worlds:
        for result in _fly(world, plan, on_progress):
            found.append(result)
            on_result(result)
    return found


def _fly(world: str, plan: Plan, on_progress: OnProgress) -> list[Result]:
    scans = int(plan.duration_s * 1e9) // SCAN_NS
    trials, missing = enter(plan.systems, MOUNT, scans, plan.settings)
    race = Race(trials, lambda second: on_progress(f"{world}: {second} of {plan.duration_s:.0f} s"))
    truth = _Truth(scans)
    noise = np.random.default_rng([plan.seed, 1])
    for step in stream(course(world, plan.seed), plan.duration_s, noise):
        truth.note(step)
        for event in step.events:
            race.take(event)
    known = {
        result.row.system: result
        for result in results(world, race, truth.trajectory(), seed=plan.seed, v_true=truth.v_world)
    }
    return [
        known[name] if name in known else Result(Row(world, name, seed=plan.seed, note=missing[name]))
        for name in plan.systems
    ]
