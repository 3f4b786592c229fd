"""What reaches the emulated autopilot from outside: setpoints, sticks and external vision.

`local` is the autopilot's own frame turned z-up: forward-left-up as seen from wherever its heading was
zero, which is the odometry's map on external vision and north-west-up on GNSS.
"""

from dataclasses import dataclass
from enum import Enum

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class VisionFrame(Enum):
    """Kind of the frame in which external vision gives its position."""

    ODOMETRY = "odometry"
    NORTH = "north"
    UNSUPPORTED = "unsupported"


@dataclass(frozen=True, slots=True)
class ExternalVision:
    """One external odometry sample as the estimator takes it.

    Attributes:
        t_ns: when the sample was true, by the autopilot's reckoning, on the simulation's clock.
        p_local: position in metres, None if absent or in an unsupported frame.
        v: velocity in m/s, None if absent; in the body frame or in the local frame.
        v_in_body: which of the two.
        q_local_body: attitude, None if absent or not a unit quaternion.
        position_variance, velocity_variance: (3,) in m^2 and m^2/s^2, None if unknown.
        yaw_variance: rad^2, None if unknown.
        quality: 0 to 100, negative for failed.
        reset_counter: changes when the sender's frame jumps.
    """

    t_ns: int
    frame: VisionFrame
    p_local: Vector | None
    v: Vector | None
    v_in_body: bool
    q_local_body: Quaternion | None
    position_variance: Vector | None
    velocity_variance: Vector | None
    yaw_variance: float | None
    quality: int
    reset_counter: int


@dataclass(frozen=True, slots=True)
class OffboardSetpoint:
    """One offboard setpoint; a None part is not commanded.

    Attributes:
        p_local: position, metres.
        v_local: velocity, m/s, in the local frame, or in the heading frame if `v_in_heading`.
        yaw: heading in radians, counter-clockwise.
        yaw_rate: rad/s, counter-clockwise.
    """

    p_local: Vector | None
    v_local: Vector | None
    v_in_heading: bool
    yaw: float | None
    yaw_rate: float | None


@dataclass(frozen=True, slots=True)
class Sticks:
    """Pilot's sticks, each -1 to 1.

    Attributes:
        pitch: forward positive.
        roll: right positive.
        throttle: up positive.
        yaw: clockwise positive, as pilots see it.
    """

    pitch: float = 0.0
    roll: float = 0.0
    throttle: float = 0.0
    yaw: float = 0.0
