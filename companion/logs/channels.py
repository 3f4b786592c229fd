"""What a flight log contains: one line per channel."""

from dataclasses import dataclass
from enum import Enum

from companion.logs.records import (
    CloudView,
    FrameSummary,
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
    Authorisation,
    ExternalOdometry,
    ImuSample,
    MavlinkMessage,
    ModeRequest,
    NeighbourTracks,
    Odometry,
    PlanUpdate,
    Setpoint,
    StateChange,
    StatusText,
    Tick,
    VehicleState,
)


class Encoding(Enum):
    """How the messages of a channel become bytes."""

    JSON = "json"
    FOXGLOVE = "protobuf"
    DATAGRAMS = "companion-datagrams"


@dataclass(frozen=True, slots=True)
class Channel:
    """One kind of message in the log.

    Attributes:
        topic: name in the file.
        message_type: class of the messages (a tuple of `Datagram` for raw packets).
        schema: name of the message's schema in the file.
        rate_hz: approximate messages per second in flight, 0 if only now and then.
        journal: the message is a control event, or a call that changes how control goes on; the order
            of all journal channels in the file is the order in which they were handled.
        bulk: dropped first when the disk cannot follow.
        logged: written unless the settings say otherwise.
    """

    topic: str
    message_type: type
    encoding: Encoding
    schema: str
    rate_hz: float
    journal: bool = False
    bulk: bool = False
    logged: bool = True


_JSON, _FOXGLOVE = Encoding.JSON, Encoding.FOXGLOVE

# fmt: off
LIDAR_PACKETS = Channel("/lidar/packets", tuple, Encoding.DATAGRAMS, "companion.Datagrams", 100, bulk=True)
LIDAR_FRAMES = Channel("/lidar/frames", FrameSummary, _JSON, "companion.FrameSummary", 10)
IMU = Channel("/imu", ImuSample, _JSON, "companion.ImuSample", 200, bulk=True, logged=False)
EXTERNAL_ODOMETRY = Channel(
    "/external_odometry", ExternalOdometry, _JSON, "companion.ExternalOdometry", 50
)
MAVLINK_RX = Channel("/mavlink/rx", MavlinkMessage, _JSON, "companion.MavlinkMessage", 150)
MAVLINK_TX = Channel("/mavlink/tx", MavlinkMessage, _JSON, "companion.MavlinkMessage", 100)
MAVLINK_UNSENT = Channel("/mavlink/unsent", UnsentMessages, _JSON, "companion.UnsentMessages", 0)
QUEUE_PLACE = Channel("/perception/queue", QueuePlace, _JSON, "companion.QueuePlace", 0)
ODOMETRY = Channel("/odometry", Odometry, _JSON, "companion.Odometry", 50, journal=True)
SCAN = Channel("/scan", ScanMark, _JSON, "companion.ScanMark", 10, journal=True)
NEIGHBOURS = Channel("/neighbours", NeighbourTracks, _JSON, "companion.NeighbourTracks", 10, journal=True)
VEHICLE = Channel("/vehicle", VehicleState, _JSON, "companion.VehicleState", 30, journal=True)
AUTHORISATION = Channel("/authorisation", Authorisation, _JSON, "companion.Authorisation", 0, journal=True)
TICK = Channel("/tick", Tick, _JSON, "companion.Tick", 50, journal=True)
CALL = Channel("/call", RuntimeCall, _JSON, "companion.RuntimeCall", 0, journal=True)
SETPOINT = Channel("/setpoint", Setpoint, _JSON, "companion.Setpoint", 50)
MODE_REQUEST = Channel("/mode_request", ModeRequest, _JSON, "companion.ModeRequest", 0)
STATE = Channel("/state", StateChange, _JSON, "companion.StateChange", 0)
PLAN = Channel("/plan", PlanUpdate, _JSON, "companion.PlanUpdate", 5)
GIVEN = Channel("/follower/neighbours", GivenNeighbours, _JSON, "companion.GivenNeighbours", 10)
GRID = Channel("/follower/grid", GridView, _JSON, "companion.ObstacleGrid", 10)
LOG = Channel("/log", StatusText, _FOXGLOVE, "foxglove.Log", 0)
POSE = Channel("/pose", StampedPose, _FOXGLOVE, "foxglove.PoseInFrame", 50)
PATH = Channel("/path", PathView, _FOXGLOVE, "foxglove.PosesInFrame", 5)
CLOUD = Channel("/cloud", CloudView, _FOXGLOVE, "foxglove.PointCloud", 5, bulk=True)
TRUTH = Channel("/truth", StampedPose, _FOXGLOVE, "foxglove.PoseInFrame", 50)
STATISTICS = Channel("/statistics", Statistics, _JSON, "companion.Statistics", 1)
# fmt: on

CHANNELS: tuple[Channel, ...] = (
    LIDAR_PACKETS,
    LIDAR_FRAMES,
    IMU,
    EXTERNAL_ODOMETRY,
    MAVLINK_RX,
    MAVLINK_TX,
    MAVLINK_UNSENT,
    QUEUE_PLACE,
    ODOMETRY,
    NEIGHBOURS,
    SCAN,
    VEHICLE,
    AUTHORISATION,
    TICK,
    CALL,
    SETPOINT,
    MODE_REQUEST,
    STATE,
    PLAN,
    GIVEN,
    GRID,
    LOG,
    POSE,
    PATH,
    CLOUD,
    TRUTH,
    STATISTICS,
)
BY_TOPIC: dict[str, Channel] = {channel.topic: channel for channel in CHANNELS}
JOURNAL: tuple[Channel, ...] = tuple(channel for channel in CHANNELS if channel.journal)
