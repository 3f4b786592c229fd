"""Which channels a message goes to, and what is kept of the large ones."""

import math

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND
from companion.logs import channels
from companion.logs.channels import Channel
from companion.logs.records import (
    CloudView,
    FrameSummary,
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
    LidarScan,
    Odometry,
    OdometryStatus,
    Output,
    PlanUpdate,
    RegisteredScan,
    SensorEvent,
)

Recordable = ControlEvent | Output | SensorEvent | Statistics | QueuePlace | RuntimeCall | UnsentMessages

LEVEL_BAND_M = 0.5

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
    if isinstance(message, Odometry):
        pose = StampedPose(message.t_ns, "map", message.p_map, message.q_map_body)
        return [(channels.ODOMETRY, message), (channels.POSE, pose)]
    if isinstance(message, RegisteredScan):
        return [(channels.SCAN, mark_of(message))]
    if isinstance(message, LidarScan):
        return [(channels.LIDAR_FRAMES, summary_of(message))]
    if isinstance(message, PlanUpdate):
        return [(channels.PLAN, message), (channels.PATH, PathView(message.t_ns, message.path_map))]
    channel = _SIMPLE.get(type(message))
    if channel is None:
        raise TypeError(f"no channel for a {type(message).__name__}")
    return [(channel, message)]


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
