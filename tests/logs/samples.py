"""One message of every kind, and a flight's worth of metadata."""

import numpy as np

from companion.logs import channels
from companion.logs.channels import Channel
from companion.logs.log_queue import LogEntry
from companion.logs.metadata import FlightMetadata
from companion.logs.records import (
    CallName,
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
    Authorisation,
    Datagram,
    ExternalOdometry,
    FlightState,
    ImuSample,
    LandedState,
    MavlinkMessage,
    ModeRequest,
    NeighbourTrack,
    NeighbourTracks,
    Odometry,
    OdometryStatus,
    PlanUpdate,
    RegisteredScan,
    Setpoint,
    Severity,
    StateChange,
    StatusText,
    Tick,
    VehicleMode,
    VehicleState,
)

LIDAR = ("127.0.0.2", 56300)
HOST = ("127.0.0.1", 56301)
METADATA = FlightMetadata(
    vehicle="uav_1",
    role="leader",
    mode="lockstep",
    configuration="vehicle:\n  name: uav_1\n",
    seed=7,
    git_commit="0123abc",
    versions={"companion": "0.1.0", "python": "3.11"},
)


def datagram(t_ns: int, size: int = 1380, fill: int = 0x5A) -> Datagram:
    return Datagram(t_ns, LIDAR, HOST, bytes([fill]) * size)


def odometry(t_ns: int, rng: np.random.Generator) -> Odometry:
    return Odometry(
        t_ns=t_ns,
        t_sensor_ns=t_ns - 1_234_567,
        p_map=rng.normal(size=3),
        q_map_body=np.array([0.5, -0.5, 0.5, -0.5]),
        v_map=rng.normal(size=3),
        omega_body=rng.normal(size=3),
        covariance_pose=rng.normal(size=(6, 6)),
        covariance_velocity=rng.normal(size=(3, 3)),
        quality=87,
        reset_counter=2,
        status=OdometryStatus.DEGRADED,
        reason="corridor",
    )


def external_odometry(t_ns: int, rng: np.random.Generator) -> ExternalOdometry:
    return ExternalOdometry(
        t_ns=t_ns,
        t_source_ns=1_700_000_000_123_456_000,
        clock_offset_ns=t_ns - 1_700_000_000_123_956_789,
        on_lidar_clock=False,
        session=2,
        p_map=rng.normal(size=3),
        q_map_body=np.array([0.5, -0.5, 0.5, -0.5]),
        v_map=np.full(3, np.nan),
        omega_body=rng.normal(size=3),
        covariance_pose=rng.normal(size=(6, 6)),
        covariance_velocity=rng.normal(size=(3, 3)),
        quality=-1,
        reset_counter=255,
    )


def vehicle_state(t_ns: int) -> VehicleState:
    return VehicleState(
        t_ns=t_ns,
        connected=True,
        armed=True,
        mode=VehicleMode.OFFBOARD,
        landed=LandedState.IN_AIR,
        failsafe=False,
        t_local_ns=t_ns - 5_000_000,
        p_map=np.array([1.0, np.nan, -3.5]),
        v_map=np.array([0.1, 1 / 3, -0.0]),
        q_map_body=np.array([1.0, 0.0, 0.0, 0.0]),
        estimator_reset_counter=3,
        mode_changes=4,
    )


def registered_scan(t_ns: int, rng: np.random.Generator, points: int = 5000) -> RegisteredScan:
    return RegisteredScan(
        t_ns=t_ns,
        sequence=12,
        points_map=rng.uniform(-10.0, 10.0, size=(points, 3)).astype(np.float32),
        reflectivity=rng.integers(0, 256, size=points).astype(np.uint8),
        odometry=odometry(t_ns, rng),
        ages_ns=np.linspace(99_980_000, 0, points).astype(np.int32),
    )


def neighbour_tracks(t_ns: int, rng: np.random.Generator, count: int = 2) -> NeighbourTracks:
    tracks = (
        NeighbourTrack(
            track_id=number,
            p_map=rng.normal(size=3),
            v_map=rng.normal(size=3),
            covariance=rng.normal(size=(6, 6)),
            t_born_ns=t_ns - 5_000_000_000,
            t_seen_ns=t_ns - 100_000_000,
            points=7,
            bright_share=1 / 3,
            validated=number % 2 == 0,
        )
        for number in range(count)
    )
    return NeighbourTracks(t_ns, 12, tuple(tracks))


def one_of_each() -> dict[Channel, object]:
    """Return a message for every channel."""
    rng = np.random.default_rng(1)
    t_ns = 123_456_789_012
    points = rng.normal(size=(50, 3)).astype(np.float32)
    mavlink = MavlinkMessage(
        "ODOMETRY",
        1,
        197,
        {
            "time_usec": 2**63,
            "x": 0.1,
            "velocity_covariance": [float("nan"), 0.0, float("inf")],
            "low": float("-inf"),
            "text": 'NaN "quoted" Infinity \\ ü',
            "flag": True,
        },
    )
    return {
        channels.LIDAR_PACKETS: (datagram(5), Datagram(-6, HOST, ("10.0.0.255", 65535), b"")),
        channels.LIDAR_FRAMES: FrameSummary(t_ns, 3, 1, 100_000_001, -55, 20_000, 207, 208),
        channels.IMU: ImuSample(t_ns, 17, rng.normal(size=3), np.array([0.0, 0.0, 9.81])),
        channels.EXTERNAL_ODOMETRY: external_odometry(t_ns, rng),
        channels.MAVLINK_RX: mavlink,
        channels.MAVLINK_TX: MavlinkMessage("HEARTBEAT", 1, 191, {}),
        channels.MAVLINK_UNSENT: UnsentMessages(t_ns, 5000, 2),
        channels.QUEUE_PLACE: QueuePlace(t_ns, "scan", t_ns - 1, -1),
        channels.ODOMETRY: odometry(t_ns, rng),
        channels.SCAN: ScanMark(t_ns, 9, 18_000, t_ns - 1, 1.25),
        channels.NEIGHBOURS: neighbour_tracks(t_ns, rng),
        channels.VEHICLE: vehicle_state(t_ns),
        channels.AUTHORISATION: Authorisation(t_ns, True, "ground_station"),
        channels.TICK: Tick(t_ns),
        channels.CALL: RuntimeCall(t_ns, CallName.STOP),
        channels.SETPOINT: Setpoint(t_ns, t_ns - 1, 0, rng.normal(size=3), -0.25, "hold: odometry stale"),
        channels.MODE_REQUEST: ModeRequest(t_ns, VehicleMode.LAND),
        channels.STATE: StateChange(t_ns, FlightState.READY, FlightState.ENGAGING, "authorised"),
        channels.PLAN: PlanUpdate(t_ns, np.zeros((0, 3)), np.array([1.0, 2.0, 3.0]), 4, "no path"),
        channels.GIVEN: GivenNeighbours(
            t_ns,
            t_ns - 1,
            tuple(GivenNeighbour(n, rng.normal(size=3), rng.normal(size=3), 0.05 * n) for n in range(2)),
        ),
        channels.GRID: GridView(t_ns, t_ns - 1, -1 / 3, 2, 3, 0.05, "AAEC/f7/"),
        channels.LOG: StatusText(t_ns, Severity.NOTICE, "CMP: ready <&> ü"),
        channels.POSE: StampedPose(t_ns, "map", rng.normal(size=3), np.array([0.0, 0.6, 0.0, 0.8])),
        channels.PATH: PathView(t_ns, rng.normal(size=(4, 3))),
        channels.CLOUD: CloudView(t_ns, points, np.arange(50, dtype=np.uint8)),
        channels.TRUTH: StampedPose(t_ns, "world", rng.normal(size=3), np.array([1.0, 0.0, 0.0, 0.0])),
        channels.STATISTICS: Statistics(t_ns, "lidar", {"packets": 5, "loss": 0.25, "offset": float("nan")}),
    }


def entries(count: int, *, period_ns: int = 20_000_000) -> list[LogEntry]:
    """Return small messages on two channels, every `period_ns`."""
    found = []
    for index in range(count):
        t_ns = index * period_ns
        tick = index % 2 == 0
        channel = channels.TICK if tick else channels.VEHICLE
        found.append(LogEntry(channel, t_ns, index // 2, Tick(t_ns) if tick else vehicle_state(t_ns)))
    return found
