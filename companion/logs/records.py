"""Messages that exist only in the log: views and summaries of what crosses the seams."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from companion.messages import ByteArray, FloatArray, PointArray


@dataclass(frozen=True, slots=True, eq=False)
class StampedPose:
    """A pose in a named frame.

    Attributes:
        t_ns: host time of the pose.
        frame: name of the parent frame: "map", or "world" for the simulator's truth.
        p: position of the body in that frame, (3,) m.
        q: attitude of the body in that frame, (4,) unit quaternion (w, x, y, z).
    """

    t_ns: int
    frame: str
    p: FloatArray
    q: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CloudView:
    """A registered scan thinned out for viewing.

    Attributes:
        t_ns: host reception time of the scan's last packet.
        points_map: (n, 3) metres.
        reflectivity: (n,) as in `LidarScan`.
    """

    t_ns: int
    points_map: PointArray
    reflectivity: ByteArray


@dataclass(frozen=True, slots=True, eq=False)
class PathView:
    """The leader's path as points to draw.

    Attributes:
        t_ns: host time of the plan.
        points_map: (n, 3) metres.
    """

    t_ns: int
    points_map: FloatArray


@dataclass(frozen=True, slots=True)
class ScanMark:
    """Where in the order of control events a registered scan was handled; its points are not stored.

    Attributes:
        t_ns: host reception time of the scan's last packet.
        sequence: the scan's sequence number.
        points: number of registered points.
        t_odometry_ns: time of the pose that registered it.
        nearest_m: distance in the horizontal plane to the nearest point within half a metre of the
            body's height, NaN if there is none.
    """

    t_ns: int
    sequence: int
    points: int
    t_odometry_ns: int
    nearest_m: float


@dataclass(frozen=True, slots=True, eq=False)
class GivenNeighbour:
    """Another UAV as a follower's law was given it, in the own heading frame.

    Attributes:
        track_id: number of its track.
        p_heading: relative position, (3,) m.
        v_heading: relative velocity, (3,) m/s.
        age_s: time since it was last seen.
    """

    track_id: int
    p_heading: FloatArray
    v_heading: FloatArray
    age_s: float


@dataclass(frozen=True, slots=True, eq=False)
class GivenNeighbours:
    """The neighbours that a follower's law was given, at its first decision after a scan.

    Attributes:
        t_ns: host time of the decision.
        t_valid_ns: host time for which positions hold.
        neighbours: nearest first.
    """

    t_ns: int
    t_valid_ns: int
    neighbours: tuple[GivenNeighbour, ...]


@dataclass(frozen=True, slots=True)
class GridView:
    """The obstacle grid that a follower's law was given, a byte a cell.

    Attributes:
        t_ns: host time of the decision.
        t_scan_ns: host time of the scan from which it was made.
        yaw_map: heading in which it was made, rad.
        azimuths: cells around; the first begins straight ahead, and they go on to the left.
        elevations: cells from the lowest to the highest.
        resolution_m: range of one step.
        cells: Base64 of one byte for each cell, elevations fastest: whole steps of range, rounded down, up
            to 254; 255 where nothing is.
    """

    t_ns: int
    t_scan_ns: int
    yaw_map: float
    azimuths: int
    elevations: int
    resolution_m: float
    cells: str


@dataclass(frozen=True, slots=True)
class FrameSummary:
    """What a LiDAR frame consisted of, without its points.

    Attributes:
        t_ns: host reception time of the last packet.
        clock_offset_ns: host time minus sensor time.
        packets, packets_expected: completeness of the frame.
    """

    t_ns: int
    sequence: int
    t_sensor_start_ns: int
    t_sensor_end_ns: int
    clock_offset_ns: int
    points: int
    packets: int
    packets_expected: int


class CallName(Enum):
    """What the runtime may ask of a flight beside its events."""

    STARTING = "starting"
    """What is due to the autopilot before the flight begins."""

    STOP = "stop"
    """Brake and end."""


@dataclass(frozen=True, slots=True)
class RuntimeCall:
    """The runtime asked for something that changes how control goes on.

    Attributes:
        t_ns: host time of the call.
    """

    t_ns: int
    name: CallName


@dataclass(frozen=True, slots=True)
class QueuePlace:
    """Where a sensor event stood in perception's queue, if that does not follow from the raw packets.

    Attributes:
        t_ns: host time of the event.
        kind: "imu", "scan" or "external".
        t_source_ns: time of the event on its source's clock; of a scan, the start.
        place: events taken into the queue before it since the start, -1 if it was left out because
            perception was late.
    """

    t_ns: int
    kind: str
    t_source_ns: int
    place: int


@dataclass(frozen=True, slots=True)
class UnsentMessages:
    """Messages to the autopilot that were decided but never left, because sending was late.

    Attributes:
        t_ns: host time at which they were given up.
        first: messages decided before them since the start.
        count: how many they are.
    """

    t_ns: int
    first: int
    count: int


@dataclass(frozen=True, slots=True)
class Statistics:
    """Counters of one part of the system.

    Attributes:
        t_ns: host time of the reading.
        source: who counts: "lidar", "mavlink", "log".
        values: counters and gauges by name.
    """

    t_ns: int
    source: str
    values: Mapping[str, int | float]
