"""One pass over a recording: what the report needs, as arrays over seconds since the log began."""

from array import array
from dataclasses import dataclass, field

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND
from companion.logs import channels
from companion.logs.log_queue import LogEntry
from companion.logs.obstacle_view import GROUND_CLEARANCE_M, ObstacleView
from companion.logs.reader import FlightRecording, Integrity
from companion.logs.records import (
    CloudView,
    FrameSummary,
    GivenNeighbours,
    GridView,
    ScanMark,
    StampedPose,
    Statistics,
)
from companion.logs.views import ranges_of
from companion.messages import (
    Authorisation,
    FloatArray,
    LandedState,
    ModeRequest,
    Odometry,
    PlanUpdate,
    Setpoint,
    StateChange,
    StatusText,
    VehicleMode,
    VehicleState,
)

_PATHS_MAX = 400
_EVENTS_MAX = 20_000
_WANTED = (
    channels.ODOMETRY,
    channels.TRUTH,
    channels.SETPOINT,
    channels.VEHICLE,
    channels.STATE,
    channels.LOG,
    channels.PLAN,
    channels.SCAN,
    channels.LIDAR_FRAMES,
    channels.STATISTICS,
    channels.CLOUD,
    channels.MODE_REQUEST,
    channels.AUTHORISATION,
    channels.GIVEN,
    channels.GRID,
)

Event = StateChange | StatusText | ModeRequest | Authorisation


class Table:
    """Rows of numbers, compact while they are collected."""

    def __init__(self, columns: str) -> None:
        """Name the columns, separated by spaces; the first is the time."""
        self.columns = columns.split()
        self._data = array("d")

    def add(self, *row: float) -> None:
        """Append one row."""
        if len(row) != len(self.columns):
            raise ValueError(f"{len(row)} values for the columns {self.columns}")
        self._data.extend(row)

    def __len__(self) -> int:
        return len(self._data) // len(self.columns)

    def rows(self) -> FloatArray:
        """Return all rows, (n, columns)."""
        return np.array(self._data, dtype=np.float64).reshape(-1, len(self.columns))

    def last(self, column: str) -> float:
        """Return the newest value of one column.

        Raises:
            IndexError: if there is no row yet.
        """
        return self._data[self.columns.index(column) - len(self.columns)]

    def first(self, column: str) -> float:
        """Return the oldest value of one column.

        Raises:
            IndexError: if there is no row yet.
        """
        return self._data[self.columns.index(column)]

    def __getitem__(self, columns: str) -> FloatArray:
        """Return one column as (n,), or several, separated by spaces, as (n, k)."""
        indices = [self.columns.index(name) for name in columns.split()]
        chosen: FloatArray = self.rows()[:, indices]
        return chosen[:, 0] if len(indices) == 1 else chosen


@dataclass(frozen=True, slots=True)
class Phase:
    """Something that held from one time to another, in seconds."""

    start_s: float
    end_s: float
    label: str


@dataclass(slots=True)
class FlightData:
    """What one recording contains.

    Times are seconds since the first message; frames are those of the messages. `modes` and `landed`
    are change points (time, value) of the autopilot; `states` are those of the companion.
    """

    start_ns: int
    flight: dict[str, str]
    versions: dict[str, str]
    configuration: str
    integrity: Integrity | None = None
    duration_s: float = 0.0
    odometry: Table = field(
        default_factory=lambda: Table("t x y z vx vy vz qw qx qy qz quality status resets sigma")
    )
    truth: Table = field(default_factory=lambda: Table("t x y z qw qx qy qz"))
    setpoints: Table = field(default_factory=lambda: Table("t t_data t_scan vx vy vz yaw_rate"))
    vehicle: Table = field(
        default_factory=lambda: Table("t x y z vx vy vz connected armed failsafe airborne")
    )
    marks: Table = field(default_factory=lambda: Table("t nearest"))
    frames: Table = field(default_factory=lambda: Table("t packets expected offset_ms"))
    lidar: Table = field(default_factory=lambda: Table("t packets lost offset_ms"))
    given: Table = field(default_factory=lambda: Table("t count nearest"))
    grids: Table = field(default_factory=lambda: Table("t nearest"))
    modes: list[tuple[float, VehicleMode]] = field(default_factory=list)
    landed: list[tuple[float, LandedState]] = field(default_factory=list)
    states: list[StateChange] = field(default_factory=list)
    events: list[tuple[float, Event]] = field(default_factory=list)
    plans: list[PlanUpdate] = field(default_factory=list)
    plan_statuses: list[tuple[float, str]] = field(default_factory=list)
    counters: dict[str, dict[str, int | float]] = field(default_factory=dict)
    obstacles: ObstacleView = field(default_factory=ObstacleView)

    def seconds(self, t_ns: int) -> float:
        """Return a host time as seconds since the first message."""
        return (t_ns - self.start_ns) / NANOSECONDS_PER_SECOND


def collect(recording: FlightRecording) -> FlightData:
    """Read a recording once, from front to back.

    Raises:
        LogError: if reading the disk fails.
    """
    data = FlightData(0, recording.flight, recording.versions, recording.configuration)
    first = True
    for entry in recording.messages(*_WANTED):
        if first:
            data.start_ns, first = entry.t_ns, False
        _take(data, entry)
    data.integrity = recording.integrity()
    data.duration_s = (data.integrity.end_ns - data.integrity.start_ns) / NANOSECONDS_PER_SECOND
    return data


def phases(changes: list[tuple[float, str]], end_s: float) -> list[Phase]:
    """Return what held between change points (time, label), the last until `end_s`; repeats are joined."""
    found: list[Phase] = []
    for start_s, label in changes:
        if found and found[-1].label == label:
            continue
        if found:
            found[-1] = Phase(found[-1].start_s, start_s, found[-1].label)
        found.append(Phase(start_s, max(start_s, end_s), label))
    return found


def _take(data: FlightData, entry: LogEntry) -> None:
    match entry.message:
        case Odometry() as message:
            _take_odometry(data, message)
        case StampedPose() as message if entry.channel is channels.TRUTH:
            data.truth.add(data.seconds(message.t_ns), *message.p, *message.q)
        case Setpoint() as message:
            t_scan = data.seconds(message.t_scan_ns) if message.t_scan_ns else np.nan
            t_data = data.seconds(message.t_data_ns)
            data.setpoints.add(data.seconds(message.t_ns), t_data, t_scan, *message.v_map, message.yaw_rate)
        case VehicleState() as message:
            _take_vehicle(data, message)
        case ScanMark() as message:
            data.marks.add(data.seconds(message.t_ns), message.nearest_m)
        case GivenNeighbours() as message:
            ranges = [float(np.linalg.norm(other.p_heading)) for other in message.neighbours]
            data.given.add(data.seconds(message.t_ns), len(ranges), min(ranges, default=np.nan))
        case GridView() as message:
            _take_grid(data, message)
        case FrameSummary() as message:
            offset_ms = message.clock_offset_ns * 1e-6
            data.frames.add(data.seconds(message.t_ns), message.packets, message.packets_expected, offset_ms)
        case CloudView() as message:
            _take_cloud(data, message)
        case Statistics() as message:
            _take_statistics(data, message)
        case PlanUpdate() as message:
            _take_plan(data, message)
        case StateChange() | StatusText() | ModeRequest() | Authorisation() as message:
            if isinstance(message, StateChange):
                data.states.append(message)
            if len(data.events) < _EVENTS_MAX:
                data.events.append((data.seconds(message.t_ns), message))


def _take_odometry(data: FlightData, message: Odometry) -> None:
    variance = float(np.trace(message.covariance_pose[:3, :3]))
    sigma = np.sqrt(variance) if variance >= 0.0 else np.nan
    data.odometry.add(
        data.seconds(message.t_ns),
        *message.p_map,
        *message.v_map,
        *message.q_map_body,
        message.quality,
        message.status,
        message.reset_counter,
        sigma,
    )


def _take_vehicle(data: FlightData, message: VehicleState) -> None:
    t = data.seconds(message.t_ns)
    airborne = message.landed in (LandedState.IN_AIR, LandedState.TAKING_OFF, LandedState.LANDING)
    data.vehicle.add(
        t, *message.p_map, *message.v_map, message.connected, message.armed, message.failsafe, airborne
    )
    if not data.modes or data.modes[-1][1] is not message.mode:
        data.modes.append((t, message.mode))
    if not data.landed or data.landed[-1][1] is not message.landed:
        data.landed.append((t, message.landed))


def _take_cloud(data: FlightData, message: CloudView) -> None:
    if len(data.odometry):
        height = data.odometry.last("z")
        if height - data.odometry.first("z") >= GROUND_CLEARANCE_M:
            data.obstacles.add(message.points_map, height)


def _take_grid(data: FlightData, message: GridView) -> None:
    try:
        nearest = float(ranges_of(message).min(initial=np.inf))
    except ValueError:
        return
    data.grids.add(data.seconds(message.t_ns), nearest if np.isfinite(nearest) else np.nan)


def _take_statistics(data: FlightData, message: Statistics) -> None:
    data.counters[message.source] = dict(message.values)
    values = message.values
    if message.source == "lidar" and {"packets", "lost"} <= values.keys():
        offset_ms = float(values.get("clock_offset_ns", np.nan)) * 1e-6
        data.lidar.add(data.seconds(message.t_ns), values["packets"], values["lost"], offset_ms)


def _take_plan(data: FlightData, message: PlanUpdate) -> None:
    t = data.seconds(message.t_ns)
    if not data.plan_statuses or data.plan_statuses[-1][1] != message.status:
        data.plan_statuses.append((t, message.status))
    data.plans.append(message)
    if len(data.plans) > _PATHS_MAX:
        # Keep the whole flight at half the density rather than only its beginning.
        del data.plans[1:-1:2]
