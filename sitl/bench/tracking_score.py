"""How well neighbours were tracked: every scan's tracks against where the neighbours truly were.

Truth is moved into the companion's map by the own pose as estimated and as it truly was at the same
instant, for what counts is where a neighbour is from here; the error of the own position is the
odometry's and is judged there.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import linear_sum_assignment

from companion.clock import NANOSECONDS_PER_SECOND, seconds_to_ns
from companion.geometry import rotation
from companion.messages import FloatArray, NeighbourTrack, NeighbourTracks, Odometry
from sitl.bench.swarm_truth import MapFrame, NeighbourSights
from sitl.kinematics import Kinematics

MATCH_M = 0.5
"""A track this near to a neighbour is that neighbour's, if no other one is nearer."""

CURRENT_S = 0.5
"""Tracks unseen for longer are last-seen slots and count neither way."""

ACQUIRE_S = 0.5
"""A neighbour counts as missed only after it could be seen without a break for this long."""

FARTHEST_M = 12.0
"""Neighbours farther away are beyond what the tracker looks at."""

SIGHT = np.dtype(
    [
        ("flight", np.int32), ("scan", np.int64), ("neighbour", np.int32), ("range_m", np.float64),
        ("visible", np.bool_), ("counted", np.bool_), ("steady", np.bool_), ("matched", np.bool_),
        ("fresh", np.bool_),
        ("error_p", np.float64, 3), ("error_v", np.float64, 3), ("error_relative_v", np.float64, 3),
        ("white_p", np.float64, 3), ("white_v", np.float64, 3),
    ]
)  # fmt: skip
"""One neighbour at one scan.

`visible`: in the field of view, not hidden and in range while the own vehicle flies; `counted`: the same
for long enough; `steady`: it hardly accelerated lately; `matched`: a validated track was there, and what
follows is known: `fresh`: this very scan showed it; errors along the line of sight, across it and upwards,
the last one of the velocity as seen from the own vehicle; then position and velocity errors in units of
the covariance's root.
"""

STEP = np.dtype(
    [
        ("flight", np.int32), ("scan", np.int64), ("track", np.int64), ("range_m", np.float64),
        ("true", np.bool_),
    ]
)  # fmt: skip
"""One validated current track at one scan; `true` if it is the one track of a neighbour there."""

_STEADY_S = 0.5
_STEADY_MPS2 = 0.7
_SLACK_NS = 10_000_000  # scans end a little before or after their hundred milliseconds


@dataclass(frozen=True, slots=True, eq=False)
class FlightScore:
    """What was seen in flights of one case.

    Attributes:
        sights: (m,) of `SIGHT`.
        steps: (k,) of `STEP`.
        tracker_ms: (s,) processor time of the tracker for each scan.
        scan_ms: (s,) the same of odometry and tracker together, from the scan's last packet on.
        acquired_s: (a,) times from coming into sight until validated.
        switches: changes of a neighbour's track number.
        flown_s: time scored.
        uav_s: the same, once for every neighbour.
    """

    sights: NDArray[np.void]
    steps: NDArray[np.void]
    tracker_ms: FloatArray
    scan_ms: FloatArray
    acquired_s: FloatArray
    switches: int
    flown_s: float
    uav_s: float

    @classmethod
    def joined(cls, flights: "list[FlightScore]") -> "FlightScore":
        """Return all flights as one; they are numbered in the order given."""
        firsts = np.cumsum([0, *(1 + flight.sights["flight"].max(initial=0) for flight in flights)])
        sights = np.concatenate([flight.sights for flight in flights])
        steps = np.concatenate([flight.steps for flight in flights])
        sights["flight"] += np.repeat(firsts[:-1], [len(flight.sights) for flight in flights])
        steps["flight"] += np.repeat(firsts[:-1], [len(flight.steps) for flight in flights])
        return cls(
            sights,
            steps,
            np.concatenate([flight.tracker_ms for flight in flights]),
            np.concatenate([flight.scan_ms for flight in flights]),
            np.concatenate([flight.acquired_s for flight in flights]),
            sum(flight.switches for flight in flights),
            sum(flight.flown_s for flight in flights),
            sum(flight.uav_s for flight in flights),
        )


class Score:
    """Gathers what happens in one flight."""

    def __init__(self, counted_from_ns: int) -> None:
        """Begin.

        Args:
            counted_from_ns: sensor time before which nothing can be missed.
        """
        self._counted_from_ns = counted_from_ns
        self._sights: list[NDArray[np.void]] = []
        self._steps: list[NDArray[np.void]] = []
        self._times_ms: list[tuple[float, float]] = []
        self._acquired_s: list[float] = []
        self._switches = 0
        self._flown_ns = self._uav_ns = 0
        self._last_ns: int | None = None
        self._numbers: dict[int, int] = {}
        self._visible_since: dict[int, int] = {}
        self._waiting: set[int] = set()
        self._velocities: deque[tuple[int, FloatArray]] = deque(maxlen=32)

    def result(self) -> FlightScore:
        """Return everything so far."""
        times = np.array(self._times_ms).reshape(-1, 2)
        return FlightScore(
            np.concatenate([np.zeros(0, SIGHT), *self._sights]),
            np.concatenate([np.zeros(0, STEP), *self._steps]),
            times[:, 0],
            times[:, 1],
            np.array(self._acquired_s),
            self._switches,
            self._flown_ns / NANOSECONDS_PER_SECOND,
            self._uav_ns / NANOSECONDS_PER_SECOND,
        )

    def add(
        self,
        tracks: NeighbourTracks,
        odometry: Odometry,
        sights: NeighbourSights,
        truth: Kinematics,
        frame: MapFrame,
        times_ms: tuple[float, float],
    ) -> None:
        """Judge the tracks after one scan.

        Args:
            tracks: what the tracker returned.
            odometry: the own motion it used.
            sights: the truth of the neighbours at the scan's end.
            truth: the true own motion then.
            frame: where the map began.
            times_ms: processor time of the tracker, and of odometry and tracker together.
        """
        t_ns = sights.t_sensor_ns
        passed_ns = 0 if self._last_ns is None else t_ns - self._last_ns
        self._last_ns = t_ns
        self._flown_ns += passed_ns
        self._uav_ns += passed_ns * len(sights.range_m)
        self._times_ms.append(times_ms)
        p_true, v_true, v_own = _in_estimated_map(sights, truth, odometry, frame)
        current = [
            track
            for track in tracks.tracks
            if track.validated and tracks.t_ns - track.t_seen_ns <= seconds_to_ns(CURRENT_S) + _SLACK_NS
        ]
        p = np.array([track.p_map for track in current]).reshape(-1, 3)
        away = np.linalg.norm(p_true[:, None] - p[None], axis=2)
        pairs = zip(*linear_sum_assignment(np.where(away <= MATCH_M, away, 1e3)), strict=True)
        matches = {int(i): int(j) for i, j in pairs if away[i, j] <= MATCH_M}
        self._steps.append(_steps(sights.sequence, current, p - odometry.p_map, set(matches.values())))
        steady = self._steady(t_ns, sights.v_world)
        found = np.zeros(len(p_true), SIGHT)
        found["scan"], found["range_m"], found["steady"] = sights.sequence, sights.range_m, steady
        for i in range(len(p_true)):
            sight = found[i]
            visible = bool(sights.visible[i]) and float(sights.range_m[i]) < FARTHEST_M
            sight["neighbour"] = i
            sight["visible"] = visible and t_ns >= self._counted_from_ns
            sight["counted"] = self._note(i, t_ns, visible, i in matches)
            if i in matches:
                track = current[matches[i]]
                self._switches += int(self._numbers.get(i, track.track_id) != track.track_id)
                self._numbers[i] = track.track_id
                sight["fresh"] = track.t_seen_ns == tracks.t_ns
                _enter_errors(sight, track, p_true[i], v_true[i], odometry.v_map - v_own, odometry.p_map)
        self._sights.append(found)

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


def _in_estimated_map(
    sights: NeighbourSights, truth: Kinematics, odometry: Odometry, frame: MapFrame
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what an exact sensor would enter into the map.

    The true positions and velocities (n, 3) of the neighbours, and the own velocity (3,).
    """
    turn = rotation.multiply(odometry.q_map_body, rotation.conjugate(frame.attitudes(truth.q_world_body)))
    away = frame.positions(sights.p_world) - frame.positions(truth.p_world)
    p_map = odometry.p_map + rotation.rotate(turn, away)
    own: FloatArray = rotation.rotate(turn, frame.velocities(truth.v_world))
    return p_map, rotation.rotate(turn, frame.velocities(sights.v_world)), own


def _steps(
    scan: int, current: list[NeighbourTrack], away_map: FloatArray, true: set[int]
) -> NDArray[np.void]:
    steps = np.zeros(len(current), STEP)
    steps["scan"] = scan
    steps["track"] = [track.track_id for track in current]
    steps["range_m"] = np.linalg.norm(away_map, axis=1)
    steps["true"] = [j in true for j in range(len(current))]
    return steps


def _enter_errors(
    sight: np.void,
    track: NeighbourTrack,
    p_true: FloatArray,
    v_true: FloatArray,
    own_error_v: FloatArray,
    p_own: FloatArray,
) -> None:
    e_p, e_v = track.p_map - p_true, track.v_map - v_true
    along = (p_true - p_own) / max(float(np.linalg.norm(p_true - p_own)), 1e-9)
    across = np.array([-along[1], along[0], 0.0]) / max(float(np.hypot(along[0], along[1])), 1e-9)
    axes = np.array([along, across, np.cross(along, across)])
    sight["matched"] = True
    sight["error_p"], sight["error_v"] = axes @ e_p, axes @ e_v
    sight["error_relative_v"] = axes @ (e_v - own_error_v)
    sight["white_p"] = _whitened(track.covariance[:3, :3], e_p)
    sight["white_v"] = _whitened(track.covariance[3:, 3:], e_v)


def _whitened(covariance: FloatArray, error: FloatArray) -> FloatArray:
    """Return an error (3,) in units of its covariance's root: unit variance on each axis if that is true."""
    return np.asarray(solve_triangular(np.linalg.cholesky(covariance), error, lower=True))
