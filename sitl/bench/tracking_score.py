"""How well neighbours were tracked: every scan's tracks against where the neighbours truly were.

Truth is moved into the companion's map by the own pose as estimated and as it truly was at the same
instant, for what counts is where a neighbour is from here; the error of the own position is the
odometry's and is judged there.
"""

from collections import deque
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtri

from companion.clock import NANOSECONDS_PER_SECOND, seconds_to_ns
from companion.geometry import rotation
from companion.messages import FloatArray, NeighbourTrack, NeighbourTracks, Odometry
from sitl.bench.swarm_truth import MapFrame, NeighbourSights
from sitl.kinematics import Kinematics

MATCH_M = 0.5
"""A track this near to a neighbour is that neighbour's."""

CURRENT_S = 0.5
"""Tracks unseen for longer are last-seen slots and count neither way."""

ACQUIRE_S = 0.5
"""A neighbour counts as missed only after it could be seen without a break for this long."""

BANDS_M = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0)
"""Neighbours farther than the last one are beyond what the tracker looks at."""

_INDEPENDENT_STEPS = 10  # errors of a track a second apart count as independent
_STEADY_S = 0.5
_STEADY_MPS2 = 0.7
_SLACK_NS = 10_000_000  # scans end a little before or after their hundred milliseconds


@dataclass(frozen=True, slots=True)
class Row:
    """Figures of one case in one band of range.

    Attributes:
        scene: its name.
        tape: whether the neighbours wear it.
        distractors: whether other reflective things stand about.
        neighbours: number of them.
        band_m: band of range, or "all".
        range_m: mean range of the counted neighbours.
        counted: neighbour-steps that count for the detection rate.
        track_steps: validated track-steps that count for the precision.
        detection_rate: share of the counted neighbour-steps with a validated track.
        precision: share of validated track-steps at a true neighbour.
        position_rmse_m: of matched tracks, all three axes together.
        velocity_rmse_mps: the same of the velocity.
        velocity_rmse_steady_mps: the same where the neighbour hardly accelerated.
        position_nees: mean squared error by covariance and degree of freedom; 1 if the covariance is true.
        position_nees_bounds: where that mean lies in 95 % of all runs, if the covariance is true and errors
            a second apart are independent.
        velocity_nees: the same as for the position...
        velocity_nees_bounds: ...with its bounds.
        position_rmse_axes_m: along the line of sight, across it and upwards.
        velocity_rmse_axes_mps: the same.
        id_switches_per_min: changes of a neighbour's track number, by minute of flight.
        acquired_s: median time from coming into sight until validated.
        latency_ms: median processor time of the tracker for one scan.
        latency_p99_ms: its 99th percentile.
    """

    scene: str
    tape: bool
    distractors: bool
    neighbours: int
    band_m: str
    range_m: float | None
    counted: int
    track_steps: int
    detection_rate: float | None
    precision: float | None
    position_rmse_m: float | None
    velocity_rmse_mps: float | None
    velocity_rmse_steady_mps: float | None
    position_nees: float | None
    position_nees_bounds: tuple[float, float] | None
    velocity_nees: float | None
    velocity_nees_bounds: tuple[float, float] | None
    position_rmse_axes_m: tuple[float, ...] | None
    velocity_rmse_axes_mps: tuple[float, ...] | None
    id_switches_per_min: float
    acquired_s: float | None
    latency_ms: float | None
    latency_p99_ms: float | None

    def as_dict(self) -> dict[str, object]:
        """Return the row for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class _Sight:
    """One neighbour at one scan; the figures of the match are None without one."""

    range_m: float
    counted: bool
    steady: bool
    error_p: FloatArray | None = None
    error_v: FloatArray | None = None
    nees_p: float | None = None
    nees_v: float | None = None


class Score:
    """Gathers what happened in all flights of one case."""

    def __init__(self, counted_from_ns: int) -> None:
        """Begin.

        Args:
            counted_from_ns: sensor time in each flight before which nothing can be missed.
        """
        self._counted_from_ns = counted_from_ns
        self._sights: list[_Sight] = []
        self._steps: list[tuple[float, bool]] = []
        self._cpu_ms: list[float] = []
        self._acquired_s: list[float] = []
        self._switches = 0
        self._flown_ns = 0
        self.start_flight()

    def start_flight(self) -> None:
        """Forget who was who: another flight begins."""
        self._last_ns: int | None = None
        self._numbers: dict[int, int] = {}
        self._visible_since: dict[int, int] = {}
        self._waiting: set[int] = set()
        self._velocities: deque[tuple[int, FloatArray]] = deque(maxlen=32)

    def add(
        self,
        tracks: NeighbourTracks,
        odometry: Odometry,
        sights: NeighbourSights,
        truth: Kinematics,
        frame: MapFrame,
        cpu_ms: float,
    ) -> None:
        """Judge the tracks after one scan.

        Args:
            tracks: what the tracker returned.
            odometry: the own pose it used.
            sights: the truth of the neighbours at the scan's end.
            truth: the true own motion then.
            frame: where the map began.
            cpu_ms: processor time that the tracker took.
        """
        t_ns = sights.t_sensor_ns
        self._flown_ns += t_ns - (t_ns if self._last_ns is None else self._last_ns)
        self._last_ns = t_ns
        self._cpu_ms.append(cpu_ms)
        p_true, v_true = _in_estimated_map(sights, truth, odometry, frame)
        steady = self._steady(t_ns, sights.v_world)
        current = [
            track
            for track in tracks.tracks
            if track.validated and tracks.t_ns - track.t_seen_ns <= seconds_to_ns(CURRENT_S) + _SLACK_NS
        ]
        p = np.array([track.p_map for track in current]).reshape(-1, 3)
        away = np.linalg.norm(p_true[:, None] - p[None], axis=2)
        for j in range(len(current)):
            far = float(np.linalg.norm(p[j] - odometry.p_map))
            self._steps.append((far, bool(np.min(away[:, j], initial=np.inf) <= MATCH_M)))
        rows, columns = linear_sum_assignment(np.where(away <= MATCH_M, away, 1e3))
        matches = {int(i): current[j] for i, j in zip(rows, columns, strict=True) if away[i, j] <= MATCH_M}
        for i in range(len(p_true)):
            visible = bool(sights.visible[i]) and float(sights.range_m[i]) < BANDS_M[-1]
            counted = self._note(i, t_ns, visible, i in matches)
            sight = _Sight(float(sights.range_m[i]), counted, bool(steady[i]))
            if i in matches:
                track = matches[i]
                self._switches += int(self._numbers.get(i, track.track_id) != track.track_id)
                self._numbers[i] = track.track_id
                sight = _errors(sight, track, p_true[i], v_true[i], odometry.p_map)
            self._sights.append(sight)

    def _note(self, i: int, t_ns: int, visible: bool, found: bool) -> bool:
        """Follow one neighbour's visibility; return whether it counts now."""
        if not visible:
            self._visible_since.pop(i, None)
            self._waiting.discard(i)
            return False
        if i not in self._visible_since:
            self._visible_since[i] = t_ns
            self._waiting.add(i)
        since_ns = t_ns - self._visible_since[i]
        if found and i in self._waiting:
            self._waiting.discard(i)
            self._acquired_s.append(since_ns / NANOSECONDS_PER_SECOND)
        return t_ns >= self._counted_from_ns and since_ns >= seconds_to_ns(ACQUIRE_S) - _SLACK_NS

    def _steady(self, t_ns: int, v_world: FloatArray) -> NDArray[np.bool_]:
        """Return which neighbours have hardly accelerated lately."""
        self._velocities.append((t_ns, v_world))
        while t_ns - self._velocities[0][0] > seconds_to_ns(_STEADY_S) + _SLACK_NS:
            self._velocities.popleft()
        span_s = max((t_ns - self._velocities[0][0]) / NANOSECONDS_PER_SECOND, 1e-3)
        change = np.array([np.linalg.norm(v_world - v, axis=1) for _, v in self._velocities]).max(axis=0)
        return np.asarray((span_s > 0.9 * _STEADY_S) & (change / span_s <= _STEADY_MPS2))

    def rows(self, scene: str, neighbours: int, *, tape: bool, distractors: bool) -> list[Row]:
        """Return the figures of all ranges together, then of each band that anything was seen in."""
        limits = [("all", 0.0, np.inf)]
        limits += [(f"{low:g}-{high:g}", low, high) for low, high in pairwise(BANDS_M)]
        rows = []
        for name, low, high in limits:
            counted = [sight for sight in self._sights if sight.counted and low <= sight.range_m < high]
            matched = [sight for sight in counted if sight.error_p is not None]
            e_p, e_v = _stacked([s.error_p for s in matched]), _stacked([s.error_v for s in matched])
            steady = _stacked([s.error_v for s in matched if s.steady])
            bounds = _nees_bounds(len(matched) // _INDEPENDENT_STEPS)
            steps = [true for far, true in self._steps if low <= far < high]
            if name != "all" and not counted and not steps:
                continue
            rows.append(
                Row(
                    scene=scene,
                    tape=tape,
                    distractors=distractors,
                    neighbours=neighbours,
                    band_m=name,
                    range_m=_mean([sight.range_m for sight in counted]),
                    counted=len(counted),
                    track_steps=len(steps),
                    detection_rate=len(matched) / len(counted) if counted else None,
                    precision=sum(steps) / len(steps) if steps else None,
                    position_rmse_m=_rmse(e_p),
                    velocity_rmse_mps=_rmse(e_v),
                    velocity_rmse_steady_mps=_rmse(steady),
                    position_nees=_mean([sight.nees_p for sight in matched]),
                    position_nees_bounds=bounds,
                    velocity_nees=_mean([sight.nees_v for sight in matched]),
                    velocity_nees_bounds=bounds,
                    position_rmse_axes_m=_rmse_axes(e_p),
                    velocity_rmse_axes_mps=_rmse_axes(e_v),
                    id_switches_per_min=self._switches / max(self._flown_ns * 1e-9 / 60.0, 1e-9),
                    acquired_s=float(np.median(self._acquired_s)) if self._acquired_s else None,
                    latency_ms=float(np.median(self._cpu_ms)) if self._cpu_ms else None,
                    latency_p99_ms=float(np.percentile(self._cpu_ms, 99.0)) if self._cpu_ms else None,
                )
            )
        return rows


def _in_estimated_map(
    sights: NeighbourSights, truth: Kinematics, odometry: Odometry, frame: MapFrame
) -> tuple[FloatArray, FloatArray]:
    """Return the true positions and velocities (n, 3) as an exact sensor would enter them into the map."""
    turn = rotation.multiply(odometry.q_map_body, rotation.conjugate(frame.attitudes(truth.q_world_body)))
    away = frame.positions(sights.p_world) - frame.positions(truth.p_world)
    p_map = odometry.p_map + rotation.rotate(turn, away)
    return p_map, rotation.rotate(turn, frame.velocities(sights.v_world))


def _errors(
    sight: _Sight, track: NeighbourTrack, p_true: FloatArray, v_true: FloatArray, p_own: FloatArray
) -> _Sight:
    e_p, e_v = track.p_map - p_true, track.v_map - v_true
    along = (p_true - p_own) / max(float(np.linalg.norm(p_true - p_own)), 1e-9)
    across = np.array([-along[1], along[0], 0.0]) / max(float(np.hypot(along[0], along[1])), 1e-9)
    axes = np.array([along, across, np.cross(along, across)])
    return _Sight(
        sight.range_m,
        sight.counted,
        sight.steady,
        axes @ e_p,
        axes @ e_v,
        float(e_p @ np.linalg.solve(track.covariance[:3, :3], e_p)) / 3.0,
        float(e_v @ np.linalg.solve(track.covariance[3:, 3:], e_v)) / 3.0,
    )


def _mean(values: list[float] | list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _stacked(errors: list[FloatArray | None]) -> FloatArray:
    return np.array([error for error in errors if error is not None]).reshape(-1, 3)


def _rmse(errors: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))) if len(errors) else None


def _rmse_axes(errors: FloatArray) -> tuple[float, ...] | None:
    return tuple(np.sqrt(np.mean(errors**2, axis=0)).tolist()) if len(errors) else None


def _nees_bounds(samples: int) -> tuple[float, float] | None:
    """Return the 95 % bounds of the mean of independent normalised squares of three axes each."""
    freedom = 3 * samples
    if not freedom:
        return None
    return float(chdtri(freedom, 0.975) / freedom), float(chdtri(freedom, 0.025) / freedom)
