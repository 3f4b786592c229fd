"""Commands and parameter messages of the emulated autopilot, without any link."""

import math
import struct
from typing import Any

from companion.messages import VehicleMode
from sitl.autopilot import Autopilot
from sitl.autopilot_inputs import Sticks
from sitl.autopilot_modes import CommandResult
from sitl.autopilot_parameters import Parameters
from sitl.mavlink_modes import mode_of

RETURN_TO_LAUNCH, LAND, TAKEOFF, DO_SET_MODE, ARM = 20, 21, 22, 176, 400
GET_INTERVAL, SET_INTERVAL, REQUEST_MESSAGE, REQUEST_CAPABILITIES = 510, 511, 512, 520
_LOITER = 17
_FORCE = 21196
_CUSTOM_MODE_ENABLED = 1
_INT32, _REAL32 = 6, 9
_JOYSTICK_MODES = (1, 2, 3)
_MODE_COMMANDS = {
    RETURN_TO_LAUNCH: VehicleMode.RETURN,
    LAND: VehicleMode.LAND,
    TAKEOFF: VehicleMode.TAKEOFF,
    _LOITER: VehicleMode.HOLD,
}


def execute(autopilot: Autopilot, command: int, parameters: tuple[float, ...]) -> CommandResult:
    """Execute one flight command.

    Args:
        autopilot: who executes.
        command: MAV_CMD number.
        parameters: its first three parameters.

    Returns:
        The result to acknowledge with; UNSUPPORTED for commands that this autopilot does not know.
    """
    if command == ARM:
        if parameters[0] not in (0.0, 1.0):
            return CommandResult.UNSUPPORTED
        return autopilot.request_arming(parameters[0] == 1.0, force=parameters[1] == _FORCE)
    if command == DO_SET_MODE:
        return _set_mode(autopilot, parameters)
    if command in _MODE_COMMANDS:
        return autopilot.request_mode(_MODE_COMMANDS[command])
    return CommandResult.UNSUPPORTED


def _set_mode(autopilot: Autopilot, parameters: tuple[float, ...]) -> CommandResult:
    base, main, sub = (int(value) if math.isfinite(value) else 0 for value in parameters[:3])
    mode = mode_of(main, sub)
    if not base & _CUSTOM_MODE_ENABLED or mode is None:
        return CommandResult.TEMPORARILY_REJECTED
    return autopilot.request_mode(mode)


def manual_control(autopilot: Autopilot, t_ns: int, message: Any) -> bool:
    """Take MANUAL_CONTROL as sticks if COM_RC_IN_MODE allows a joystick; return whether it was taken."""
    if int(autopilot.parameters["COM_RC_IN_MODE"]) not in _JOYSTICK_MODES:
        return False
    pitch, roll, yaw = (_stick(value / 1000.0) for value in (message.x, message.y, message.r))
    throttle = _stick(message.z / 500.0 - 1.0)
    autopilot.pilot_sticks(t_ns, Sticks(pitch=pitch, roll=roll, throttle=throttle, yaw=yaw))
    return True


def _stick(value: float) -> float:
    return max(-1.0, min(1.0, value))


def parameter_value(parameters: Parameters, name: str) -> tuple[Any, ...]:
    """Return the fields of PARAM_VALUE; integers travel byte-wise inside the float."""
    value = parameters[name]
    if isinstance(value, int):
        wire, kind = struct.unpack("<f", struct.pack("<i", value))[0], _INT32
    else:
        wire, kind = value, _REAL32
    return (name.encode(), wire, kind, len(parameters), parameters.index_of(name))


def set_parameter(parameters: Parameters, message: Any) -> str | None:
    """Apply PARAM_SET; return the name to report (changed or not), None for an unknown parameter."""
    name = str(message.param_id)
    if name not in parameters:
        return None
    if message.param_type == _INT32:
        parameters.set(name, struct.unpack("<i", struct.pack("<f", message.param_value))[0])
    elif message.param_type == _REAL32 and not parameters.is_integer(name):
        parameters.set(name, message.param_value)
    return name


def requested_parameter(parameters: Parameters, message: Any) -> str | None:
    """Return the name that PARAM_REQUEST_READ asks for, by index or by name; None if there is none."""
    if message.param_index >= 0:
        names = parameters.names()
        return names[message.param_index] if message.param_index < len(names) else None
    name = str(message.param_id)
    return name if name in parameters else None
