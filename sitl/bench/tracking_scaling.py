"""What the tracker and the obstacle grid cost, and how that grows with points and neighbours.

Swarms fly in a walled yard, where every beam returns from nearby, with our own odometry in the loop. The
scans are recorded, thinned or filled up, and given to fresh trackers several times over; a tracker does
the same work each time, so of each scan the least time counts.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from companion.clock import SystemClock
from companion.messages import FloatArray, RegisteredScan
from companion.perception.occupancy import GridSettings, ObstacleGrid
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.tracking.settings import TrackingSettings
from companion.perception.tracking.tracker import NeighbourTracker
from sitl.bench.swarm_scenes import PLAN_START_S, SwarmSettings, scene, stream
from sitl.bench.synthetic_flights import T_BODY_LIDAR, T_LIDAR_IMU
from sitl.worlds.primitives import Cylinder, Ground, World

TRACKER_LIMIT_MS = 8.0
"""Most that the tracker may take for a scan with ten neighbours, on average (median)."""

GRID_LIMIT_MS = 2.0
"""The same of the grid."""

DENSITIES = (0.125, 0.25, 0.5, 1.0, 2.0, 3.0)
"""How many points are looked at, as shares of what the sensor gives."""

NEIGHBOURS = (0, 1, 5, 10, 19)
"""How many neighbours fly, each time with all the points of the sensor."""

_TEN = 10
_YARD_M = 9.8
_PILLARS = 64
_PILLAR_M = 0.6
_WALL_HEIGHT_M = 16.0
_JITTER_M = 0.01
_SETTLED_SCANS = 10


@dataclass(frozen=True, slots=True)
class Cost:
    """Processor time of one way to look at one flight.

    Attributes:
        what: what is varied: "points", "neighbours", or "all bright", where every point is tape.
        points: of a scan, on average.
        neighbours: number that flies.
        validated: number that the tracker knew, on average.
        tracker_ms: median.
        tracker_p99_ms: 99th percentile.
        grid_ms: median.
    """

    what: str
    points: int
    neighbours: int
    validated: float
    tracker_ms: float
    tracker_p99_ms: float
    grid_ms: float

    def as_dict(self) -> dict[str, object]:
        """Return the row for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Growth:
    """Whether the promises hold.

    Attributes:
        exponent: b of the best fit of time = a * points^b.
        n_log_n_exponent: the same of points * log(points) over the same numbers of points.
        tracker_ms: with ten neighbours and all points of the sensor.
        grid_ms: the same.
    """

    exponent: float
    n_log_n_exponent: float
    tracker_ms: float
    grid_ms: float

    @property
    def holds(self) -> bool:
        """Return whether all of them do."""
        return (
            self.exponent <= self.n_log_n_exponent
            and self.tracker_ms <= TRACKER_LIMIT_MS
            and self.grid_ms <= GRID_LIMIT_MS
        )

    def as_dict(self) -> dict[str, object]:
        """Return it for JSON."""
        limits = {"tracker_limit_ms": TRACKER_LIMIT_MS, "grid_limit_ms": GRID_LIMIT_MS}
        return {**asdict(self), **limits, "holds": self.holds}


def measure(
    seed: int, seconds: float, repeats: int, on_cost: Callable[[Cost], None] = lambda cost: None
) -> tuple[list[Cost], Growth]:
    """Measure everything in this process, on one thread.

    Args:
        seed: of flights and noise.
        seconds: of each flight from power-on, more than 7.
        repeats: how often each is done.
        on_cost: called as soon as a figure is known.
    """
    costs: list[Cost] = []
    chance = np.random.default_rng([seed, 3])

    def note(cost: Cost) -> None:
        costs.append(cost)
        on_cost(cost)

    for neighbours in NEIGHBOURS:
        scans = record(neighbours, seed, seconds)
        if neighbours == _TEN:
            for density in DENSITIES:
                looked = [at_density(scan, density, chance) for scan in scans]
                note(_cost("points", neighbours, looked, repeats, density))
            retro = [replace(scan, reflectivity=np.full_like(scan.reflectivity, 255)) for scan in scans]
            note(_cost("all bright", neighbours, retro, repeats))
        else:
            note(_cost("neighbours", neighbours, scans, repeats))
    return costs, growth([cost for cost in costs if cost.what == "points"])


def growth(costs: Sequence[Cost]) -> Growth:
    """Return how time grows over rows that differ in the number of points; one is of `DENSITIES` 1."""
    points = np.array([cost.points for cost in costs], np.float64)
    times = np.array([cost.tracker_ms for cost in costs])
    usual = costs[DENSITIES.index(1.0)]
    return Growth(
        _exponent(points, times), _exponent(points, points * np.log(points)), usual.tracker_ms, usual.grid_ms
    )


def record(neighbours: int, seed: int, seconds: float) -> list[RegisteredScan]:
    """Fly a crowd in the yard; return the scans of our own odometry from when the plan begins."""
    crowd = scene("crowd", seed, SwarmSettings(uavs=neighbours + 1))
    odometry = LidarInertialOdometry(OdometrySettings(), T_BODY_LIDAR, T_LIDAR_IMU)
    steps = stream(replace(crowd, world=yard()), seconds, np.random.default_rng([seed, 2]))
    outputs = (
        (step.t_sensor_ns, output)
        for step in steps
        for event in step.events
        for output in odometry.handle(event)
    )
    return [
        output for t_ns, output in outputs if isinstance(output, RegisteredScan) and t_ns > PLAN_START_S * 1e9
    ]


def yard() -> World:
    """Return a round yard behind a wall of pillars, all of it in the tracker's range from its middle."""
    angles = np.linspace(0.0, 2.0 * np.pi, _PILLARS, endpoint=False)
    # Every third one stands out, or the odometry could not tell where it turns.
    radii = np.where(np.arange(_PILLARS) % 3 == 0, _YARD_M - 0.5, _YARD_M)
    places = zip((radii * np.cos(angles)).tolist(), (radii * np.sin(angles)).tolist(), strict=True)
    # Every beam of the field of view ends at the wall.
    wall = [
        Cylinder(start_world_m=(x, y, -1.0), end_world_m=(x, y, _WALL_HEIGHT_M), radius_m=_PILLAR_M)
        for x, y in places
    ]
    return World.of([Ground(), *wall])


def at_density(scan: RegisteredScan, density: float, rng: np.random.Generator) -> RegisteredScan:
    """Return a scan with a share of its points, or with more points next to them.

    Args:
        scan: as seen.
        density: number of points wanted, as a share of the present ones.
        rng: of the choice, and of where the added ones lie.
    """
    count = len(scan.points_map)
    whole, rest = divmod(round(density * count), max(count, 1))
    chosen = np.concatenate([np.tile(np.arange(count), whole), rng.permutation(count)[:rest]])
    points = scan.points_map[chosen]
    points[count:] += rng.normal(0.0, _JITTER_M, (max(len(chosen) - count, 0), 3)).astype(np.float32)
    return replace(
        scan, points_map=points, reflectivity=scan.reflectivity[chosen], ages_ns=scan.ages_ns[chosen]
    )


def _cost(
    what: str, neighbours: int, scans: Sequence[RegisteredScan], repeats: int, density: float = 1.0
) -> Cost:
    usual = TrackingSettings()
    settings = usual.model_copy(update={"points_per_steradian": density * usual.points_per_steradian})
    runs = [_time(scans, settings) for _ in range(repeats)]
    # A tracker that has just begun has little to do.
    least = np.min([times for times, _ in runs], axis=0)[_SETTLED_SCANS:]
    return Cost(
        what,
        round(float(np.mean([len(scan.points_map) for scan in scans]))),
        neighbours,
        float(np.mean(runs[0][1][_SETTLED_SCANS:])),
        float(np.median(least[:, 0])),
        float(np.percentile(least[:, 0], 99.0)),
        float(np.median(least[:, 1])),
    )


def _time(scans: Sequence[RegisteredScan], settings: TrackingSettings) -> tuple[FloatArray, FloatArray]:
    """Return processor times (s, 2) of tracker and grid in ms, and how many were validated (s,)."""
    tracker, grid = NeighbourTracker(settings, T_BODY_LIDAR), ObstacleGrid(GridSettings())
    clock = SystemClock()
    times, validated = np.zeros((len(scans), 2)), np.zeros(len(scans))
    for k, scan in enumerate(scans):
        start_ns = clock.thread_cpu_ns()
        tracks = tracker.observe(scan)
        tracked_ns = clock.thread_cpu_ns()
        grid.of(scan, tracks)
        times[k] = (tracked_ns - start_ns) * 1e-6, (clock.thread_cpu_ns() - tracked_ns) * 1e-6
        validated[k] = sum(track.validated for track in tracks.tracks)
    return times, validated


def _exponent(points: FloatArray, times: FloatArray) -> float:
    """Return b of the best fit of a * points^b, by the logarithms."""
    slope = float(np.polyfit(np.log(points), np.log(np.maximum(times, 1e-6)), 1)[0])
    return slope if math.isfinite(slope) else math.inf
