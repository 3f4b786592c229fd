"""One flight of a swarm from the logs of its vehicles: the paper's metrics as numbers and as a page."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from companion.errors import LogError
from companion.logs.figure_page import write_whole
from companion.logs.metrics import DEFAULT_CAP_M, Spread, SwarmMetrics, measure, mission_progress_percent
from companion.logs.swarm_log import Progress, SwarmFlight, read_swarm
from companion.logs.swarm_obstacles import obstacle_distances
from companion.logs.swarm_page import swarm_page
from companion.logs.swarm_starts import StartPose, Vector

COLLISION_M = 0.4
"""Two centres nearer than this have collided: twice the radius of a vehicle."""
OBSTACLE_CONTACT_M = 0.2
GOAL_TOLERANCE_M = 1.0
GATHERED_M = 5.0
SHOWN = ("FR", "MS", "AL", "MDO")
"""The metrics of a single flight, in the order of the paper's table."""


@dataclass(frozen=True, slots=True)
class SwarmRequest:
    """What is to be judged.

    Attributes:
        logs: one a vehicle.
        starts: where every vehicle's odometry began; None to use a simulator's truth.
        waypoints: (k, 3) the leader's way in the common frame; the last is the goal.
        airborne: only times at which all vehicles flew.
        from_s: leave out what comes before, in seconds since the common time began.
        to_s: leave out what comes after.
        cap_m: obstacles farther than this do not count for MDO.
    """

    logs: tuple[Path, ...]
    starts: Mapping[str, StartPose] | None = None
    waypoints: Sequence[Vector] = ()
    airborne: bool = False
    from_s: float = 0.0
    to_s: float = math.inf
    cap_m: float = DEFAULT_CAP_M


@dataclass(frozen=True, slots=True, eq=False)
class SwarmReport:
    """One flight, judged.

    Attributes:
        progress_percent: MP of the leader; None without a goal.
        success: the leader arrived, all others gathered around it, and nobody touched anything that is known;
            None without a goal.
        notes: what must be known to judge the numbers.
    """

    flight: SwarmFlight
    metrics: SwarmMetrics
    waypoints: Sequence[Vector]
    progress_percent: float | None
    success: bool | None
    notes: tuple[str, ...] = field(default=())

    def spread(self, name: str) -> Spread:
        """Return one of the metrics in `SHOWN`."""
        value: Spread = getattr(self.metrics, name)
        return value

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; None where a number is not known."""
        result: dict[str, Any] = {
            "vehicles": list(self.flight.names),
            "source": self.flight.source,
            "duration_s": float(self.metrics.t[-1]),
            "samples": len(self.metrics.t),
        }
        for name in SHOWN:
            value = self.spread(name)
            result |= {name: _plain(value.mean), f"{name}_sd": _plain(value.sd)}
        return result | {
            "MDO_cap_m": _plain(self.metrics.cap_m),
            "MP": self.progress_percent,
            "success": self.success,
            "closest_m": float(self.metrics.minimum_separation_m.min()),
            "nearest_obstacle_m": _plain(_smallest(self.metrics)),
            "notes": list(self.notes),
        }

    def lines(self) -> list[str]:
        """Return the same for the terminal; the first two are the paper's table."""
        cap = f"moments with an obstacle within {self.metrics.cap_m:g} m"
        if not math.isfinite(self.metrics.cap_m):
            cap = "all moments, without a cap"
        nearest = _smallest(self.metrics)
        closest = f"closest pair {self.metrics.minimum_separation_m.min():.2f} m"
        obstacle = f", nearest obstacle {nearest:.2f} m" if math.isfinite(nearest) else ""
        texts = [
            f"{'UAVs':>4}  " + "  ".join(f"{head:>13}" for head in ("FR (m)", "MS (m)", "AL", "MDO (m)")),
            f"{len(self.flight.vehicles):>4}  " + "  ".join(f"{self.cell(name):>13}" for name in SHOWN),
            f"{self.metrics.t[-1]:.1f} s at 20 Hz, positions from {self.flight.source}; MDO over {cap}",
            closest + obstacle,
        ]
        if self.progress_percent is not None:
            verdict = "success" if self.success else "no success"
            texts.append(f"mission progress {self.progress_percent:.1f} %: {verdict}")
        return texts + [f"note: {note}" for note in self.notes]

    def cell(self, name: str) -> str:
        """Return a metric as the paper prints it: mean and standard deviation over time."""
        value = self.spread(name)
        if not math.isfinite(value.mean):
            return "-"
        sd = value.sd if math.isfinite(value.sd) else 0.0
        return f"{value.mean:.2f} ± {sd:.2f}"


def judge(request: SwarmRequest, progress: Progress | None = None) -> SwarmReport:
    """Read the logs of a swarm and compute its metrics.

    Args:
        request: what is to be judged.
        progress: is told which log is being read.

    Raises:
        LogError: if they cannot be read or are no flight of a swarm; the text says why.
    """
    flight = read_swarm(
        request.logs,
        request.starts,
        airborne=request.airborne,
        from_s=request.from_s,
        to_s=request.to_s,
        progress=progress,
    )
    distances, notes = obstacle_distances(flight)
    metrics = measure(flight.t, flight.p, flight.v, distances, cap_m=request.cap_m)
    percent, success = _mission(flight, metrics, request.waypoints)
    return SwarmReport(flight, metrics, request.waypoints, percent, success, (*flight.notes, *notes))


def write_swarm_page(report: SwarmReport, path: Path) -> None:
    """Write a flight's page; an old one is replaced.

    Raises:
        LogError: if it cannot be written or plotly is missing.
    """
    rows = {name: report.cell(name) for name in SHOWN}
    limits = (COLLISION_M, OBSTACLE_CONTACT_M)
    text = swarm_page(report.flight, report.metrics, report.waypoints, rows, report.lines()[2:], limits)
    write_whole(path, text)


def _mission(
    flight: SwarmFlight, metrics: SwarmMetrics, waypoints: Sequence[Vector]
) -> tuple[float | None, bool | None]:
    if not waypoints:
        return None, None
    leader = flight.leader
    if leader is None:
        raise LogError("the logs name no single leader, so there is no progress towards the waypoints")
    start, end, goal = flight.p[0, leader], flight.p[-1, leader], np.array(waypoints[-1])
    arrived = float(np.linalg.norm(end - goal)) <= GOAL_TOLERANCE_M
    gathered = float(np.linalg.norm(flight.p[-1] - end, axis=1).max()) <= GATHERED_M
    apart = float(metrics.minimum_separation_m.min()) >= COLLISION_M
    clear = not _smallest(metrics) < OBSTACLE_CONTACT_M
    success = arrived and gathered and apart and clear
    return mission_progress_percent(start, goal, end, success=success), success


def _smallest(metrics: SwarmMetrics) -> float:
    known = metrics.obstacle_distance_m[np.isfinite(metrics.obstacle_distance_m)]
    return float(known.min()) if len(known) else math.nan


def _plain(value: float) -> float | None:
    return value if math.isfinite(value) else None
