"""Flight modes as PX4 writes them into MAVLink: custom_mode, base_mode and standard_mode."""

from companion.messages import LandedState, VehicleMode
from sitl.autopilot_modes import AUTOMATIC_MODES, MANUAL_MODES

_CODES: dict[VehicleMode, tuple[int, int]] = {
    VehicleMode.MANUAL: (1, 0),
    VehicleMode.ALTITUDE: (2, 0),
    VehicleMode.POSITION: (3, 0),
    VehicleMode.TAKEOFF: (4, 2),
    VehicleMode.HOLD: (4, 3),
    VehicleMode.MISSION: (4, 4),
    VehicleMode.RETURN: (4, 5),
    VehicleMode.LAND: (4, 6),
    VehicleMode.ACRO: (5, 0),
    VehicleMode.OFFBOARD: (6, 0),
    VehicleMode.STABILIZED: (7, 0),
}
_MODES = {code: mode for mode, code in _CODES.items()}
_STANDARD = {
    VehicleMode.POSITION: 1,
    VehicleMode.ALTITUDE: 4,
    VehicleMode.RETURN: 5,
    VehicleMode.MISSION: 6,
    VehicleMode.LAND: 7,
    VehicleMode.TAKEOFF: 8,
}
_LANDED = {
    LandedState.UNKNOWN: 0,
    LandedState.ON_GROUND: 1,
    LandedState.IN_AIR: 2,
    LandedState.TAKING_OFF: 3,
    LandedState.LANDING: 4,
}
_CUSTOM, _AUTO, _GUIDED, _STABILIZE, _MANUAL, _ARMED = 1, 4, 8, 16, 64, 128


def custom_mode(mode: VehicleMode) -> int:
    """Return PX4's number of a mode: main mode in the third byte, sub-mode in the fourth."""
    main, sub = _CODES.get(mode, (0, 0))
    return main << 16 | sub << 24


def mode_of(main: int, sub: int) -> VehicleMode | None:
    """Return the mode that DO_SET_MODE names, None if there is none; AUTO without sub-mode is Hold."""
    if (main, sub) == (4, 0):
        return VehicleMode.HOLD
    return _MODES.get((main, sub if main == 4 else 0))


def base_mode(mode: VehicleMode, armed: bool) -> int:
    """Return the heartbeat's base_mode bits."""
    bits = _CUSTOM | (_ARMED if armed else 0)
    if mode in AUTOMATIC_MODES:
        return bits | _AUTO | _GUIDED | _STABILIZE
    if mode in MANUAL_MODES:
        rate_only = mode in (VehicleMode.MANUAL, VehicleMode.ACRO)
        return bits | _MANUAL | (0 if rate_only else _STABILIZE)
    return bits | _STABILIZE


def standard_mode(mode: VehicleMode) -> int:
    """Return CURRENT_MODE's standard mode, 0 for non-standard ones."""
    return _STANDARD.get(mode, 0)


def landed_code(state: LandedState) -> int:
    """Return EXTENDED_SYS_STATE's landed state."""
    return _LANDED[state]
