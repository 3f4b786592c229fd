"""Flight modes of the emulated autopilot: what each needs before it may run, and who ranks above whom."""

from dataclasses import dataclass
from enum import IntEnum

from companion.messages import VehicleMode


class CommandResult(IntEnum):
    """Answer of the autopilot to a command, with MAVLink's numbers."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


@dataclass(frozen=True, slots=True)
class Conditions:
    """What the autopilot can rely on at one instant.

    Attributes:
        local_position, local_velocity, altitude: the estimate's parts are valid.
        global_position: a geographic position is valid.
        manual_control: sticks are being received.
        offboard_signal: a usable setpoint arrived within COM_OF_LOSS_T.
    """

    local_position: bool
    local_velocity: bool
    altitude: bool
    global_position: bool
    manual_control: bool
    offboard_signal: bool


AUTOMATIC_MODES = frozenset(
    {VehicleMode.TAKEOFF, VehicleMode.HOLD, VehicleMode.MISSION, VehicleMode.RETURN, VehicleMode.LAND}
)
MANUAL_MODES = frozenset(
    {
        VehicleMode.MANUAL,
        VehicleMode.STABILIZED,
        VehicleMode.ACRO,
        VehicleMode.ALTITUDE,
        VehicleMode.POSITION,
    }
)
_NOT_FOR_ARMING = frozenset({VehicleMode.RETURN, VehicleMode.LAND, VehicleMode.UNKNOWN})


def can_run(mode: VehicleMode, conditions: Conditions) -> bool:
    """Return whether a mode's requirements are met.

    Hold, Mission and Return need a geographic position; Takeoff and Position a local one; a Mission
    is never loaded here, so Mission never runs.
    """
    if mode is VehicleMode.OFFBOARD:
        return conditions.offboard_signal and conditions.local_velocity
    if mode in (VehicleMode.HOLD, VehicleMode.RETURN):
        return conditions.global_position and conditions.local_position
    if mode is VehicleMode.TAKEOFF:
        return conditions.local_position and conditions.altitude
    if mode is VehicleMode.LAND:
        return True
    if mode is VehicleMode.POSITION:
        return conditions.manual_control and conditions.local_position
    if mode is VehicleMode.ALTITUDE:
        return conditions.manual_control and conditions.altitude
    if mode in (VehicleMode.MANUAL, VehicleMode.STABILIZED, VehicleMode.ACRO):
        return conditions.manual_control
    return False


def can_arm(mode: VehicleMode, conditions: Conditions) -> bool:
    """Return whether motors may start in a mode."""
    return mode not in _NOT_FOR_ARMING and can_run(mode, conditions)
