"""What crosses the seams between modules: frozen values, times in integer nanoseconds.

Frames: `map` is gravity aligned with z up, its origin and yaw where the odometry started; `body` is
forward-left-up; `lidar` and `imu` are the sensor's point frame and its inertial chip (parallel axes).
Two clocks exist. `t_ns` is the host's monotonic clock; `t_sensor_ns` is the LiDAR's own clock, which
stamps points and IMU samples and is the only time used inside the odometry.
"""

from dataclasses import dataclass
from enum import Enum, IntEnum

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
PointArray = NDArray[np.float32]
ByteArray = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Datagram:
    """One UDP datagram: what a socket received or is to send.

    `t_ns` is the host time of reception, or of sending as decided by the sender.
    """

    t_ns: int
    source: tuple[str, int]
    destination: tuple[str, int]
    payload: bytes


@dataclass(frozen=True, slots=True)
class MavlinkMessage:
    """One MAVLink message with its fields by name (arrays as lists, strings without NUL padding)."""

    name: str
    system_id: int
    component_id: int
    fields: dict[str, object]


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """One inertial measurement in the IMU frame.

    Attributes:
        gyro_imu: angular rate, shape (3,), rad/s.
        accel_imu: specific force, shape (3,), m/s^2 (about +9.81 on z at rest, upright).
    """

    t_ns: int
    t_sensor_ns: int
    gyro_imu: FloatArray
    accel_imu: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LidarScan:
    """The returns of one frame cut by sensor time; slots without return are already dropped.

    Attributes:
        t_ns: host reception time of the last packet.
        t_sensor_start_ns, t_sensor_end_ns: limits of the frame.
        clock_offset_ns: host time minus sensor time, as estimated now.
        points_lidar: shape (n, 3), metres, not de-skewed, in firing order.
        offsets_ns: shape (n,), int32, time of each point after `t_sensor_start_ns`.
        reflectivity: shape (n,), 0-150 diffuse, 151-255 retro-reflective.
        tags: shape (n,), the sensor's confidence bits.
        packets, packets_expected: completeness of the frame.
    """

    t_ns: int
    sequence: int
    t_sensor_start_ns: int
    t_sensor_end_ns: int
    clock_offset_ns: int
    points_lidar: PointArray
    offsets_ns: NDArray[np.int32]
    reflectivity: ByteArray
    tags: ByteArray
    packets: int
    packets_expected: int


@dataclass(frozen=True, slots=True, eq=False)
class ExternalOdometry:
    """Own motion as another process on this computer estimates it, checked and turned into our frames.

    Attributes:
        t_ns: host time of reception.
        t_source_ns: when the state was valid, on the sender's clock.
        clock_offset_ns: host time minus the sender's clock, as estimated now.
        on_lidar_clock: the sender's clock is the LiDAR's own, so `t_source_ns` is sensor time.
        session: grows by one whenever another sender, or the same one with another clock, begins.
        p_map, q_map_body: pose of the body in the sender's frame with z up, (3,) m and (4,) (w, x, y, z).
        v_map: velocity of the body origin, (3,) m/s; not a number when the sender states none.
        omega_body: angular rate, (3,) rad/s; not a number when the sender states none.
        covariance_pose: (6, 6); position in map (m^2), then rotation in body (rad^2).
        covariance_velocity: (3, 3) in map (m^2/s^2).
        quality: -1 failed, 0 not stated, else 1 to 100.
        reset_counter: the sender's own, 0 to 255.
    """

    t_ns: int
    t_source_ns: int
    clock_offset_ns: int
    on_lidar_clock: bool
    session: int
    p_map: FloatArray
    q_map_body: FloatArray
    v_map: FloatArray
    omega_body: FloatArray
    covariance_pose: FloatArray
    covariance_velocity: FloatArray
    quality: int
    reset_counter: int

    @property
    def t_valid_ns(self) -> int:
        """Host time at which the state was valid."""
        return self.t_source_ns + self.clock_offset_ns


class OdometryStatus(IntEnum):
    """Health of the own-motion estimate."""

    INITIALISING = 0
    TRACKING = 1
    DEGRADED = 2
    LOST = 3


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Own motion at one instant.

    Attributes:
        t_ns: host time at which the state is valid (sensor time plus clock offset).
        p_map, q_map_body: pose of the body, (3,) m and (4,) unit quaternion (w, x, y, z).
        v_map: velocity of the body origin, (3,) m/s.
        omega_body: angular rate, (3,) rad/s.
        covariance_pose: (6, 6); position in map (m^2), then rotation in body (rad^2).
        covariance_velocity: (3, 3) in map (m^2/s^2).
        quality: 0 (do not use) to 100.
        reset_counter: grows by one whenever the map frame jumps.
        reason: why the status is not TRACKING; empty otherwise.
    """

    t_ns: int
    t_sensor_ns: int
    p_map: FloatArray
    q_map_body: FloatArray
    v_map: FloatArray
    omega_body: FloatArray
    covariance_pose: FloatArray
    covariance_velocity: FloatArray
    quality: int
    reset_counter: int
    status: OdometryStatus
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredScan:
    """One scan moved into the map by the odometry.

    Attributes:
        t_ns: host reception time of the scan's last packet.
        sequence: the scan's sequence number.
        points_map: (n, 3) de-skewed points, metres.
        reflectivity: (n,) as in `LidarScan`.
        odometry: pose at the scan's end.
        ages_ns: (n,) how long before the scan's end each point was measured; what moves by itself was
            elsewhere then.
    """

    t_ns: int
    sequence: int
    points_map: PointArray
    reflectivity: ByteArray
    odometry: Odometry
    ages_ns: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class NeighbourTrack:
    """Another UAV as the tracker follows it.

    Attributes:
        track_id: its number; never used again for another one.
        p_map: (3,) centre of its body at the time of `NeighbourTracks`, m.
        v_map: (3,) m/s.
        covariance: (6, 6) of position, then velocity, in the map.
        t_born_ns: host time of its first observation.
        t_seen_ns: host time of the newest scan in which it was observed.
        points: returns of its body in that scan's stack.
        bright_share: share of them that came from reflective tape.
        validated: it has proved to be a UAV; others are candidates and must not be relied on.
    """

    track_id: int
    p_map: FloatArray
    v_map: FloatArray
    covariance: FloatArray
    t_born_ns: int
    t_seen_ns: int
    points: int
    bright_share: float
    validated: bool


@dataclass(frozen=True, slots=True, eq=False)
class NeighbourTracks:
    """All tracks after one scan.

    Attributes:
        t_ns: host time for which positions hold: the scan's end.
        sequence: the scan's sequence number.
        tracks: in order of their numbers.
    """

    t_ns: int
    sequence: int
    tracks: tuple[NeighbourTrack, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """The nearest other UAVs, as a follower's controller sees them.

    The heading frame has its origin in the own body, x where the nose points, z up.

    Attributes:
        t_ns: host time for which positions hold.
        track_ids: (k,) numbers of the tracks, nearest first; -1 where there is none.
        states_heading: (k, 7) relative position m, relative velocity m/s, and 1 where there is a neighbour
            (all zero otherwise).
        covariances_heading: (k, 6, 6) of relative position and velocity; zero where there is none.
        ages_s: (k,) time since each was last seen; zero where there is none.
    """

    t_ns: int
    track_ids: NDArray[np.int64]
    states_heading: FloatArray
    covariances_heading: FloatArray
    ages_s: FloatArray


class VehicleMode(Enum):
    """Flight mode of the autopilot."""

    UNKNOWN = "unknown"
    MANUAL = "manual"
    STABILIZED = "stabilized"
    ACRO = "acro"
    ALTITUDE = "altitude"
    POSITION = "position"
    OFFBOARD = "offboard"
    TAKEOFF = "takeoff"
    HOLD = "hold"
    MISSION = "mission"
    RETURN = "return"
    LAND = "land"


class LandedState(Enum):
    """Whether the autopilot believes it flies."""

    UNKNOWN = "unknown"
    ON_GROUND = "on_ground"
    IN_AIR = "in_air"
    TAKING_OFF = "taking_off"
    LANDING = "landing"


@dataclass(frozen=True, slots=True, eq=False)
class VehicleState:
    """Latest values received from the autopilot.

    Attributes:
        t_ns: host time of this summary.
        connected: a heartbeat of the configured system arrived within 3 s.
        failsafe: the autopilot reports a critical state.
        t_local_ns: host time of the newest local position or attitude, whichever is older; 0 without one.
        p_map, v_map, q_map_body: the autopilot's own estimate turned into map axes.
        estimator_reset_counter: the autopilot's count of its estimate's jumps.
        mode_changes: number of mode changes seen since connecting.
    """

    t_ns: int
    connected: bool
    armed: bool
    mode: VehicleMode
    landed: LandedState
    failsafe: bool
    t_local_ns: int
    p_map: FloatArray
    v_map: FloatArray
    q_map_body: FloatArray
    estimator_reset_counter: int
    mode_changes: int


@dataclass(frozen=True, slots=True)
class Tick:
    """Time to decide on the next setpoint."""

    t_ns: int


@dataclass(frozen=True, slots=True)
class Authorisation:
    """An operator's explicit permission (or its withdrawal) to take control of the vehicle.

    `source` is one of the profile's authorisation sources: ``ground_station``, ``mode_switch`` or
    ``command``.
    """

    t_ns: int
    granted: bool
    source: str


@dataclass(frozen=True, slots=True, eq=False)
class VelocityCommand:
    """What a role wants: a velocity, and since when it has been true.

    Attributes:
        t_ns: host time of the newest sensor data it rests on.
        v_map: (3,) m/s.
        yaw_rate: rad/s, positive counter-clockwise seen from above.
    """

    t_ns: int
    v_map: FloatArray
    yaw_rate: float


@dataclass(frozen=True, slots=True, eq=False)
class Setpoint:
    """The velocity that the supervisor approved for sending.

    Attributes:
        t_ns: host time of the decision.
        t_data_ns: host time of the newest sensor data behind it.
        t_scan_ns: host reception time of the newest scan's last packet behind it, 0 if none.
        v_map: (3,) m/s, within all limits, finite.
        yaw_rate: rad/s.
        reason: what the vehicle is doing, for logs ("follow path", "hold: odometry stale").
    """

    t_ns: int
    t_data_ns: int
    t_scan_ns: int
    v_map: FloatArray
    yaw_rate: float
    reason: str


@dataclass(frozen=True, slots=True)
class ModeRequest:
    """Ask the autopilot for a mode: OFFBOARD to engage, LAND to end."""

    t_ns: int
    mode: VehicleMode


class FlightState(Enum):
    """State of the companion, published in its heartbeat, status texts and log."""

    STARTING = "starting"
    STANDBY = "standby"
    READY = "ready"
    ENGAGING = "engaging"
    ACTIVE = "active"
    HOLDING = "holding"
    LANDING = "landing"
    PILOT = "pilot"
    LISTENING = "listening"
    LOST = "lost"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class StateChange:
    """The supervisor moved from one state to another."""

    t_ns: int
    previous: FlightState
    current: FlightState
    reason: str


class Severity(IntEnum):
    """MAVLink's severities of a status text."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


@dataclass(frozen=True, slots=True)
class StatusText:
    """One line for the ground station; at most 50 characters are transmitted."""

    t_ns: int
    severity: Severity
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class PlanUpdate:
    """The leader's present path.

    Attributes:
        path_map: (n, 3) polyline from the vehicle to the local goal, metres; (0, 3) without path.
        goal_map: (3,) the waypoint being approached.
        waypoint: its index.
        status: "planned", "kept", "no path", "holding" or "arrived".
    """

    t_ns: int
    path_map: FloatArray
    goal_map: FloatArray
    waypoint: int
    status: str


SensorEvent = ImuSample | LidarScan | ExternalOdometry
PerceptionUpdate = Odometry | RegisteredScan
ControlEvent = Odometry | RegisteredScan | VehicleState | Authorisation | Tick
Output = Setpoint | ModeRequest | Odometry | StateChange | StatusText | PlanUpdate
