"""The script language of the emulated operator: steps, each a condition to wait for and an action."""

from collections.abc import Callable
from dataclasses import dataclass, field

from companion.messages import LandedState, VehicleMode

_VELOCITY_KNOWN, _POSITION_KNOWN, _AIDED = 0b10, 0b1000, 0b100000000
_MAV_STATE_STANDBY, _MAV_STATE_ACTIVE = 3, 4


@dataclass(slots=True)
class OperatorView:
    """What the operator sees on the ground station.

    Attributes:
        connected: the autopilot's heartbeat has arrived.
        estimator_flags: of the last ESTIMATOR_STATUS.
        height: metres above the local origin.
        companion_state: MAV_STATE of the companion's last heartbeat, None before the first.
        companion_was_active: the companion has reported that it commands the vehicle.
        texts: the last status texts, newest last.
    """

    connected: bool = False
    armed: bool = False
    failsafe: bool = False
    mode: VehicleMode = VehicleMode.UNKNOWN
    landed: LandedState = LandedState.UNKNOWN
    estimator_flags: int = 0
    height: float = 0.0
    companion_state: int | None = None
    companion_was_active: bool = False
    texts: list[str] = field(default_factory=list)


Condition = Callable[[OperatorView, float], bool]


@dataclass(frozen=True, slots=True)
class SelectMode:
    """Ask the autopilot for a flight mode."""

    mode: VehicleMode


@dataclass(frozen=True, slots=True)
class Arm:
    """Start or stop the motors."""

    arm: bool = True


@dataclass(frozen=True, slots=True)
class Authorise:
    """Permit the companion to take control, or withdraw the permission."""

    granted: bool = True


@dataclass(frozen=True, slots=True)
class SetParameter:
    """Change a parameter of the autopilot."""

    name: str
    value: int | float


@dataclass(frozen=True, slots=True)
class HoldSticks:
    """Take the transmitter: stream these stick positions from now on, or stop streaming."""

    held: bool = True
    pitch: float = 0.0
    roll: float = 0.0
    throttle: float = 0.0
    yaw: float = 0.0


@dataclass(frozen=True, slots=True)
class Look:
    """Do nothing: the step only waits."""


Action = SelectMode | Arm | Authorise | SetParameter | HoldSticks | Look


@dataclass(frozen=True, slots=True)
class Step:
    """One line of a script.

    Attributes:
        when: true as soon as the action is to happen; sees the view and the seconds since the step began.
        do: the action.
        name: for logs and failures.
        timeout_s: longest wait for the condition and for the action's acknowledgement, each.
    """

    when: Condition
    do: Action
    name: str
    timeout_s: float = 120.0


def connected(view: OperatorView, _: float) -> bool:
    """The autopilot is there."""
    return view.connected


def vision_fused(view: OperatorView, _: float) -> bool:
    """The estimator is aided and knows position and velocity."""
    wanted = _VELOCITY_KNOWN | _POSITION_KNOWN | _AIDED
    return view.estimator_flags & wanted == wanted


def companion_ready(view: OperatorView, _: float) -> bool:
    """The companion reports that it could take control."""
    return view.companion_state == _MAV_STATE_STANDBY


def companion_active(view: OperatorView, _: float) -> bool:
    """The companion reports that it commands the vehicle."""
    return view.companion_state == _MAV_STATE_ACTIVE


def landed_and_disarmed(view: OperatorView, _: float) -> bool:
    """The flight is over."""
    return not view.armed and view.landed is LandedState.ON_GROUND


def above(height: float) -> Condition:
    """Return a condition: airborne and at least `height` metres up."""
    return lambda view, _: view.armed and view.height >= height


def in_mode(mode: VehicleMode) -> Condition:
    """Return a condition: the autopilot flies `mode`."""
    return lambda view, _: view.mode is mode


def after(seconds: float) -> Condition:
    """Return a condition: that long since the step began."""
    return lambda _, elapsed_s: elapsed_s >= seconds


def both(first: Condition, second: Condition) -> Condition:
    """Return a condition: both hold at once."""
    return lambda view, elapsed_s: first(view, elapsed_s) and second(view, elapsed_s)


def takeoff(takeoff_height_m: float) -> list[Step]:
    """Return the way up without GNSS: wait for external vision, then arm into the takeoff mode.

    Args:
        takeoff_height_m: MIS_TAKEOFF_ALT.
    """
    return [
        Step(connected, SetParameter("MIS_TAKEOFF_ALT", float(takeoff_height_m)), "set takeoff height"),
        Step(vision_fused, SelectMode(VehicleMode.TAKEOFF), "select takeoff"),
        Step(after(0.5), Arm(), "arm"),
        Step(above(0.7 * takeoff_height_m), Look(), "climb", timeout_s=60.0),
    ]


def land_now() -> list[Step]:
    """Return the way down from wherever the vehicle is."""
    return [
        Step(connected, SelectMode(VehicleMode.LAND), "land", timeout_s=5.0),
        Step(landed_and_disarmed, Look(), "landed", timeout_s=30.0),
    ]


def takeoff_and_authorise(
    takeoff_height_m: float, authorise_after_s: float, takeover_after_s: float | None = None
) -> list[Step]:
    """Return the usual flight: take off without GNSS, authorise the companion, wait for the landing.

    Args:
        takeoff_height_m: MIS_TAKEOFF_ALT.
        authorise_after_s: hovering time before the companion is authorised.
        takeover_after_s: seconds after the companion took control at which the pilot selects Position
            with centred sticks and then lands; never if None.
    """
    steps = [
        *takeoff(takeoff_height_m),
        Step(both(after(authorise_after_s), companion_ready), Authorise(), "authorise"),
    ]
    if takeover_after_s is not None:
        steps += [
            Step(in_mode(VehicleMode.OFFBOARD), Look(), "companion takes control"),
            Step(after(takeover_after_s), HoldSticks(), "take the transmitter"),
            Step(after(0.5), SelectMode(VehicleMode.POSITION), "take over"),
            Step(after(5.0), SelectMode(VehicleMode.LAND), "land"),
        ]
    return [*steps, Step(landed_and_disarmed, Look(), "landed", timeout_s=3600.0)]
