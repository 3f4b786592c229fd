"""Which channels a message goes to, and what is kept of the large ones."""

import base64
import math

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND
from companion.logs import channels
from companion.logs.channels import Channel
from companion.logs.records import (
    CloudView,
    FrameSummary,
    GivenNeighbour,
    GivenNeighbours,
    GridView,
    PathView,
    QueuePlace,
    RuntimeCall,
    ScanMark,
    StampedPose,
    Statistics,
    UnsentMessages,
)
from companion.messages import (
    ControlEvent,
    FloatArray,
    LidarScan,
    Odometry,
    OdometryStatus,
    Output,
    PlanUpdate,
    RegisteredScan,
    SensorEvent,
    Surroundings,
)

Recordable = ControlEvent | Output | SensorEvent | Statistics | QueuePlace | RuntimeCall | UnsentMessages

LEVEL_BAND_M = 0.5
GRID_STEP_M = 0.05
FARTHEST_CELL = 254
EMPTY_CELL = 255

_SIMPLE: dict[type, Channel] = {
    channel.message_type: channel
    for channel in (
        channels.IMU,
        channels.EXTERNAL_ODOMETRY,
        channels.NEIGHBOURS,
        channels.VEHICLE,
        channels.AUTHORISATION,
        channels.TICK,
        channels.CALL,
        channels.QUEUE_PLACE,
        channels.MAVLINK_UNSENT,
        channels.SETPOINT,
        channels.MODE_REQUEST,
        channels.STATE,
        channels.LOG,
        channels.STATISTICS,
    )
}


def views_of(message: Recordable) -> list[tuple[Channel, object]]:
    """Return the channels a message goes to and what is written there, clouds excepted.

    Raises:
        TypeError: if nothing is known of this kind of message.
    """
    channel = _SIMPLE.get(type(message))
    if channel is not None:
        return [(channel, message)]
    if isinstance(message, Odometry):
        pose = StampedPose(message.t_ns, "map", message.p_map, message.q_map_body)
        return [(channels.ODOMETRY, message), (channels.POSE, pose)]
    if isinstance(message, RegisteredScan):
        return [(channels.SCAN, mark_of(message))]
    if isinstance(message, LidarScan):
        return [(channels.LIDAR_FRAMES, summary_of(message))]
    if isinstance(message, PlanUpdate):
        return [(channels.PLAN, message), (channels.PATH, PathView(message.t_ns, message.path_map))]
    if isinstance(message, Surroundings):
        return [(channels.GIVEN, given_of(message)), (channels.GRID, grid_of(message))]
    raise TypeError(f"no channel for a {type(message).__name__}")


def mark_of(scan: RegisteredScan) -> ScanMark:
    """Return what is kept of a registered scan in the order of events."""
    delta = scan.points_map - scan.odometry.p_map.astype(np.float32)
    level = delta[np.abs(delta[:, 2]) <= LEVEL_BAND_M]
    squared = level[:, 0] * level[:, 0] + level[:, 1] * level[:, 1]
    nearest_m = math.sqrt(float(squared.min())) if len(squared) else math.nan
    return ScanMark(scan.t_ns, scan.sequence, len(scan.points_map), scan.odometry.t_ns, nearest_m)


def cloud_of(scan: RegisteredScan, points_max: int) -> CloudView:
    """Return every k-th point of a registered scan, at most `points_max`."""
    step = max(1, -(-len(scan.points_map) // points_max))
    return CloudView(scan.t_ns, scan.points_map[::step].copy(), scan.reflectivity[::step].copy())


def given_of(seen: Surroundings) -> GivenNeighbours:
    """Return the neighbours that there were."""
    others = seen.neighbours
    rows = tuple(
        GivenNeighbour(int(others.track_ids[row]), state[0:3], state[3:6], float(others.ages_s[row]))
        for row, state in enumerate(others.states_heading)
        if state[6] > 0.0
    )
    return GivenNeighbours(seen.t_ns, others.t_ns, rows)


def grid_of(seen: Surroundings) -> GridView:
    """Return the obstacle grid with a byte for each cell."""
    known = np.isfinite(seen.ranges)
    farthest_m = float(seen.ranges[known].max(initial=0.0))
    resolution_m = max(GRID_STEP_M, farthest_m / FARTHEST_CELL)
    steps = np.full(seen.ranges.shape, EMPTY_CELL, np.uint8)
    steps[known] = np.minimum(seen.ranges[known] / resolution_m, FARTHEST_CELL)
    azimuths, elevations = seen.ranges.shape
    cells = base64.b64encode(steps.tobytes()).decode("ascii")
    return GridView(seen.t_ns, seen.t_scan_ns, seen.yaw_map, azimuths, elevations, resolution_m, cells)


def ranges_of(view: GridView) -> FloatArray:
    """Return the ranges (azimuths, elevations) of a recorded grid, m, to within its resolution.

    Raises:
        ValueError: if there are not as many cells as it says.
    """
    cells = np.frombuffer(base64.b64decode(view.cells, validate=True), np.uint8)
    if view.azimuths < 0 or view.elevations < 0 or len(cells) != view.azimuths * view.elevations:
        raise ValueError(f"{len(cells)} cells in a grid of {view.azimuths} x {view.elevations}")
    ranges = np.where(cells == EMPTY_CELL, np.inf, cells * view.resolution_m)
    return ranges.reshape(view.azimuths, view.elevations)


class CloudSampler:
    """Chooses which registered scans are kept as clouds, and how much of them."""

    def __init__(self, rate_hz: float, points_max: int) -> None:
        """Keep at most `rate_hz` clouds a second, of at most `points_max` points."""
        self._period_ns = round(NANOSECONDS_PER_SECOND / rate_hz)
        self._points_max = points_max
        self._next_ns: int | None = None

    def take(self, scan: RegisteredScan, t_ns: int) -> CloudView | None:
        """Return the cloud of a scan handled at host time `t_ns`, None if it comes too soon."""
        if self._next_ns is not None and t_ns < self._next_ns:
            return None
        self._next_ns = t_ns + self._period_ns
        return cloud_of(scan, self._points_max)


class OdometrySampler:
    """Chooses which odometry estimates are kept."""

    def __init__(self, rate_hz: float | None) -> None:
        """Keep at most `rate_hz` a second, all of them if None, and every change of status."""
        self._period_ns = 0 if rate_hz is None else round(NANOSECONDS_PER_SECOND / rate_hz)
        self._next_ns: int | None = None
        self._status: OdometryStatus | None = None

    def takes(self, odometry: Odometry, t_ns: int) -> bool:
        """Return whether an estimate handled at host time `t_ns` is kept."""
        soon = self._next_ns is not None and t_ns < self._next_ns
        if self._period_ns and soon and odometry.status is self._status:
            return False
        self._next_ns = t_ns + self._period_ns
        self._status = odometry.status
        return True


def summary_of(scan: LidarScan) -> FrameSummary:
    """Return the completeness and the clocks of a LiDAR frame."""
    return FrameSummary(
        scan.t_ns,
        scan.sequence,
        scan.t_sensor_start_ns,
        scan.t_sensor_end_ns,
        scan.clock_offset_ns,
        len(scan.points_lidar),
        scan.packets,
        scan.packets_expected,
    )
