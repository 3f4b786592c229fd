"""The logs of several vehicles of one flight, brought into one frame and to common times.

Every vehicle logs in a map of its own, by a clock of its own. Start poses bring the maps together, or the
truth that a simulator recorded. The time of day, which a log knows for one moment of its clock, brings the
clocks together.
"""

import math
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from companion.clock import NANOSECONDS_PER_SECOND, seconds_to_ns
from companion.errors import LogError
from companion.geometry import rotation
from companion.geometry.trajectory import Trajectory
from companion.logs import channels
from companion.logs.reader import FlightRecording
from companion.logs.records import StampedPose
from companion.logs.swarm_starts import MAX_VEHICLES, StartPose
from companion.messages import FloatArray, LandedState, Odometry, OdometryStatus, VehicleState

RATE_HZ = 20.0
GAP_NS = seconds_to_ns(0.5)
"""A vehicle whose poses pause for longer is not known in between."""

_PERIOD_NS = round(NANOSECONDS_PER_SECOND / RATE_HZ)
_SPACING_NS = seconds_to_ns(0.018)
_MAX_POSES = 2_000_000
_MAX_SAMPLES = 1_000_000
_USABLE = (OdometryStatus.TRACKING, OdometryStatus.DEGRADED)
_MIXED_CLOCKS = (
    "some logs know the time of day and others do not, so their clocks cannot be brought together: "
    "are they of one flight?"
)

Source = Literal["truth", "odometry"]
Progress = Callable[[Path], None]


@dataclass(frozen=True, slots=True, eq=False)
class Vehicle:
    """One vehicle's log.

    Attributes:
        name: of the vehicle.
        role: leader or follower, empty if the log does not say.
        path: of the log.
        shift_ns: to be added to its times so that all logs share one clock.
        in_map: the body in its own map, by the log's own clock; None if it holds no usable odometry.
        in_common: the body in the frame that all share.
        v_common: (n, 3) its velocity at the instants of `in_common`, m/s.
        airborne_ns: first and last instant at which the autopilot said it flew; None if it never did.
    """

    name: str
    role: str
    path: Path
    shift_ns: int
    in_map: Trajectory | None
    in_common: Trajectory
    v_common: FloatArray
    airborne_ns: tuple[int, int] | None


@dataclass(frozen=True, slots=True, eq=False)
class SwarmFlight:
    """A flight of several vehicles at common times.

    Attributes:
        vehicles: in the order of their logs.
        source: where positions come from.
        t_ns: (T,) common instants.
        p: (T, N, 3) positions in the common frame, m.
        v: (T, N, 3) velocities, m/s.
        notes: what must be known to judge the numbers.
    """

    vehicles: tuple[Vehicle, ...]
    source: Source
    t_ns: NDArray[np.int64]
    p: FloatArray
    v: FloatArray
    notes: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vehicles."""
        return tuple(vehicle.name for vehicle in self.vehicles)

    @property
    def t(self) -> FloatArray:
        """Seconds (T,) since the first instant."""
        return np.asarray((self.t_ns - self.t_ns[0]) / NANOSECONDS_PER_SECOND)

    @property
    def leader(self) -> int | None:
        """Number of the only vehicle that flew as leader, None if that is not one."""
        leaders = [number for number, vehicle in enumerate(self.vehicles) if vehicle.role == "leader"]
        return leaders[0] if len(leaders) == 1 else None


def read_swarm(
    paths: Sequence[Path],
    starts: Mapping[str, StartPose] | None = None,
    *,
    airborne: bool = False,
    from_s: float = 0.0,
    to_s: float = math.inf,
    progress: Progress | None = None,
) -> SwarmFlight:
    """Read several logs of one flight and resample them to `RATE_HZ` over the time that all cover.

    Args:
        paths: the logs, one a vehicle.
        starts: where every vehicle's odometry began; without them a simulator's truth is used.
        airborne: leave out times at which not all of them flew.
        from_s: leave out what comes before, in seconds since the common time began.
        to_s: leave out what comes after.
        progress: is told which log is being read.

    Raises:
        LogError: if a log cannot be read, or they are no logs of one flight; the text says why.
    """
    if not 2 <= len(paths) <= MAX_VEHICLES:
        raise LogError(f"{len(paths)} log: a swarm needs 2 to {MAX_VEHICLES}, one of each UAV")
    logs = []
    for path in paths:
        if progress is not None:
            progress(path)
        logs.append(_Collected.of(path))
    for index, log in enumerate(logs):
        if log.name in [other.name for other in logs[:index]]:
            raise LogError(f"{log.path}: a second log of {log.name}; one of each UAV is needed")
    shifts, notes = _clocks(logs)
    if starts is not None:
        source: Source = "odometry"
        missing = [log.name for log in logs if log.name not in starts]
        if missing:
            raise LogError(f"no start pose of {', '.join(missing)}: give one with --start or --starts")
        unknown = sorted(set(starts) - {log.name for log in logs})
        if unknown:
            raise LogError(f"a start pose of {', '.join(unknown)}, of which there is no log")
    else:
        source = "truth"
        for log in logs:
            if not len(log.truth):
                raise LogError(
                    f"{log.path}: holds no truth, so it is no simulated flight: give every UAV's start pose "
                    "with --start or --starts"
                )
    vehicles = []
    for log, shift_ns in zip(logs, shifts, strict=True):
        start = None if starts is None else starts[log.name]
        vehicles.append(log.vehicle(start, shift_ns))
        if log.maps > 1:
            notes.append(f"{log.name}: its map jumped; only the longest stretch in one map counts")
    return _resampled(tuple(vehicles), source, notes, airborne, (from_s, to_s))


class _Poses:
    """Poses and velocities as they come; what goes back in time is left out."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._t = array("q")
        self._map = array("q")
        self._values = array("d")

    def __len__(self) -> int:
        return len(self._t)

    def add(self, t_ns: int, map_number: int, *values: FloatArray) -> None:
        if self._t and t_ns <= self._t[-1]:
            return
        if len(self._t) >= _MAX_POSES:
            raise LogError(f"{self._path}: more than {_MAX_POSES} poses")
        row = np.concatenate(values)
        if not np.all(np.isfinite(row)) or np.linalg.norm(row[3:7]) < 0.5:
            return
        self._t.append(t_ns)
        self._map.append(map_number)
        self._values.extend(row.tolist())

    def longest(self, width: int) -> tuple[NDArray[np.int64], FloatArray, int]:
        """Return instants and rows of the map in which most poses are, and how many maps there were."""
        t = np.array(self._t, dtype=np.int64)
        rows = np.array(self._values, dtype=np.float64).reshape(-1, width)
        numbers, counts = np.unique(np.array(self._map, dtype=np.int64), return_counts=True)
        if len(numbers) < 2:
            return t, rows, len(numbers)
        chosen = np.array(self._map) == numbers[np.argmax(counts)]
        return t[chosen], rows[chosen], len(numbers)


@dataclass(slots=True, eq=False)
class _Collected:
    """What one log holds."""

    path: Path
    name: str
    role: str
    calendar_ns: int
    host_ns: int
    truth: _Poses
    odometry: _Poses
    maps: int = 0
    first_ns: int | None = None
    airborne: list[int] = field(default_factory=list)

    @classmethod
    def of(cls, path: Path) -> "_Collected":
        recording = FlightRecording(path)
        flight = recording.flight
        found = cls(
            path=path,
            name=flight.get("vehicle") or path.stem,
            role=flight.get("role", ""),
            calendar_ns=_integer(flight.get("calendar_ns", "")),
            host_ns=_integer(flight.get("host_ns", "")),
            truth=_Poses(path),
            odometry=_Poses(path),
        )
        next_ns: dict[str, int] = {}
        for entry in recording.encoded(channels.ODOMETRY, channels.TRUTH, channels.VEHICLE):
            if found.first_ns is None:
                found.first_ns = entry.t_ns
            # Odometry comes faster than anybody needs here, and decoding it is most of the work.
            if entry.t_ns < next_ns.get(entry.channel.topic, entry.t_ns):
                continue
            next_ns[entry.channel.topic] = entry.t_ns + _SPACING_NS
            try:
                message = entry.message()
            except ValueError:
                continue
            if isinstance(message, StampedPose):
                found.truth.add(message.t_ns, 0, message.p, message.q)
            elif isinstance(message, Odometry) and message.status in _USABLE:
                found.odometry.add(
                    message.t_ns, message.reset_counter, message.p_map, message.q_map_body, message.v_map
                )
            elif isinstance(message, VehicleState) and message.landed is LandedState.IN_AIR:
                found.airborne[1:] = [message.t_ns]
        return found

    def vehicle(self, start: StartPose | None, shift_ns: int) -> Vehicle:
        """Return the vehicle in the common frame: by its start pose, or by its truth without one."""
        t, rows, self.maps = self.odometry.longest(10)
        in_map = Trajectory(t, rows[:, :3], rotation.normalize(rows[:, 3:7])) if len(t) else None
        if start is not None:
            if in_map is None:
                raise LogError(f"{self.path}: no usable pose on {channels.ODOMETRY.topic}")
            shift_ns += seconds_to_ns(start.clock_offset_s)
            q_common_map = rotation.from_yaw(math.radians(start.yaw_deg))
            in_common = Trajectory(
                t + shift_ns,
                rotation.rotate(q_common_map, in_map.p) + np.array(start.position_m),
                rotation.multiply(q_common_map, in_map.q),
            )
            v_common = rotation.rotate(q_common_map, rows[:, 7:10])
        else:
            t_true, true, _ = self.truth.longest(7)
            in_common = Trajectory(t_true + shift_ns, true[:, :3], rotation.normalize(true[:, 3:7]))
            v_common = _velocity(t_true, true[:, :3], self.path)
        airborne = (self.airborne[0] + shift_ns, self.airborne[-1] + shift_ns) if self.airborne else None
        return Vehicle(self.name, self.role, self.path, shift_ns, in_map, in_common, v_common, airborne)


def _clocks(logs: Sequence[_Collected]) -> tuple[list[int], list[str]]:
    """Return what to add to the times of each log, and what there is to say about it."""
    dated = [log.calendar_ns > 0 for log in logs]
    if not any(dated):
        return [0] * len(logs), []
    if not all(dated):
        raise LogError(_MIXED_CLOCKS)
    if all(log.host_ns > 0 for log in logs):
        return [log.calendar_ns - log.host_ns for log in logs], []
    shifts = [log.calendar_ns - (log.first_ns or 0) for log in logs]
    return shifts, ["clocks: brought together by the logs' first messages, which may be wrong by seconds"]


def _velocity(t_ns: NDArray[np.int64], p: FloatArray, path: Path) -> FloatArray:
    if len(t_ns) < 2:
        raise LogError(f"{path}: a single true pose makes no flight")
    t = (t_ns - t_ns[0]) / NANOSECONDS_PER_SECOND
    return np.asarray(np.gradient(p, t, axis=0))


def _resampled(
    vehicles: tuple[Vehicle, ...],
    source: Source,
    notes: list[str],
    airborne: bool,
    window_s: tuple[float, float],
) -> SwarmFlight:
    starts = [int(vehicle.in_common.t_ns[0]) for vehicle in vehicles]
    ends = [int(vehicle.in_common.t_ns[-1]) for vehicle in vehicles]
    if airborne:
        for vehicle in vehicles:
            if vehicle.airborne_ns is None:
                raise LogError(f"{vehicle.path}: the autopilot never said that it flew")
            starts.append(vehicle.airborne_ns[0])
            ends.append(vehicle.airborne_ns[1])
    first_ns, last_ns = max(starts), min(ends)
    if math.isfinite(window_s[1]):
        last_ns = min(last_ns, first_ns + seconds_to_ns(window_s[1]))
    first_ns += seconds_to_ns(window_s[0])
    count = (last_ns - first_ns) // _PERIOD_NS + 1
    if count < 2:
        late, early = (
            vehicles[int(np.argmax(starts)) % len(vehicles)],
            vehicles[int(np.argmin(ends)) % len(vehicles)],
        )
        raise LogError(
            f"the logs have no time in common: {late.name} begins after {early.name} has ended, or the "
            "clocks were not set alike (see clock_offset_s), or the chosen times are too few"
        )
    if count > _MAX_SAMPLES:
        raise LogError(f"{count} common samples, allowed are {_MAX_SAMPLES}")
    t_ns = first_ns + _PERIOD_NS * np.arange(count, dtype=np.int64)
    known = np.all([_known(vehicle.in_common.t_ns, t_ns) for vehicle in vehicles], axis=0)
    if np.count_nonzero(known) < 2:
        raise LogError("at no time are the poses of all UAVs known")
    if not known.all():
        lost_s = np.count_nonzero(~known) / RATE_HZ
        notes.append(f"{lost_s:.1f} s left out, in which the pose of at least one UAV was not known")
    t_ns = t_ns[known]
    p = np.stack([_interpolated(v.in_common.t_ns, v.in_common.p, t_ns) for v in vehicles], axis=1)
    v = np.stack([_interpolated(w.in_common.t_ns, w.v_common, t_ns) for w in vehicles], axis=1)
    return SwarmFlight(vehicles, source, t_ns, p, v, tuple(notes))


def _known(source_ns: NDArray[np.int64], t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which instants lie between two poses that are not too far apart."""
    after = np.clip(np.searchsorted(source_ns, t_ns), 1, max(1, len(source_ns) - 1))
    if len(source_ns) < 2:
        return np.asarray(t_ns == source_ns[0])
    return np.asarray(source_ns[after] - source_ns[after - 1] <= GAP_NS)


def _interpolated(source_ns: NDArray[np.int64], values: FloatArray, t_ns: NDArray[np.int64]) -> FloatArray:
    """Return values (n, 3) at other instants, linearly."""
    origin_ns = source_ns[0]
    source, wanted = (source_ns - origin_ns).astype(np.float64), (t_ns - origin_ns).astype(np.float64)
    return np.column_stack([np.interp(wanted, source, values[:, axis]) for axis in range(3)])


def _integer(text: str) -> int:
    return int(text) if text.isdecimal() and len(text) < 20 else 0
