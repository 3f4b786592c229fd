"""What crosses the seams between modules: frozen values, times in integer nanoseconds.

Frames: `map` has z up as the accelerometer felt it at rest (its bias makes the map lean by a few tenths of
a degree, for good: the frame never turns), its origin and yaw where the odometry started; `body` is
forward-left-up; `lidar` and `imu` are the sensor's point frame and its inertial chip (parallel axes).
Two clocks exist. `t_ns` is the host's monotonic clock; `t_sensor_ns` is the LiDAR's own clock, which
stamps points and IMU samples and is the only time used inside the odometry.
"""

from companion.messages.arrays import ByteArray, Float32Array, FloatArray, PointArray
from companion.messages.decisions import (
    Authorisation,
    FlightState,
    ModeRequest,
    PlanUpdate,
    Setpoint,
    Severity,
    StateChange,
    StatusText,
    Tick,
    VelocityCommand,
)
from companion.messages.motion import (
    Odometry,
    OdometryStatus,
    RegisteredScan,
)
from companion.messages.neighbours import (
    Neighbours,
    NeighbourTrack,
    NeighbourTracks,
    Surroundings,
)
from companion.messages.sensing import (
    Datagram,
    ExternalOdometry,
    ImuSample,
    LidarScan,
    MavlinkMessage,
)
from companion.messages.vehicle import (
    LandedState,
    VehicleMode,
    VehicleState,
)

SensorEvent = ImuSample | LidarScan | ExternalOdometry
PerceptionUpdate = Odometry | RegisteredScan | NeighbourTracks
ControlEvent = Odometry | RegisteredScan | NeighbourTracks | VehicleState | Authorisation | Tick
Output = Setpoint | ModeRequest | Odometry | StateChange | StatusText | PlanUpdate | Surroundings

__all__ = [
    "Authorisation",
    "ByteArray",
    "ControlEvent",
    "Datagram",
    "ExternalOdometry",
    "FlightState",
    "Float32Array",
    "FloatArray",
    "ImuSample",
    "LandedState",
    "LidarScan",
    "MavlinkMessage",
    "ModeRequest",
    "NeighbourTrack",
    "NeighbourTracks",
    "Neighbours",
    "Odometry",
    "OdometryStatus",
    "Output",
    "PerceptionUpdate",
    "PlanUpdate",
    "PointArray",
    "RegisteredScan",
    "SensorEvent",
    "Setpoint",
    "Severity",
    "StateChange",
    "StatusText",
    "Surroundings",
    "Tick",
    "VehicleMode",
    "VehicleState",
    "VelocityCommand",
]
