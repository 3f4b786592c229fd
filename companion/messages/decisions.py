"""What is decided, permitted, sent and told."""

from dataclasses import dataclass
from enum import Enum, IntEnum

from companion.messages.arrays import FloatArray
from companion.messages.vehicle import VehicleMode


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
