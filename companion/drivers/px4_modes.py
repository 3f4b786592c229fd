"""PX4's numbers for flight modes, landed states and system states.

A custom mode is ``main << 16 | sub << 24``.
"""

from typing import Final

from companion.messages import FlightState, LandedState, VehicleMode

BASE_MODE_CUSTOM: Final = 0x01
BASE_MODE_ARMED: Final = 0x80
AUTOPILOT_PX4: Final = 12
AUTOPILOT_INVALID: Final = 8
TYPE_ONBOARD_CONTROLLER: Final = 18
TYPE_GROUND_STATION: Final = 6

_MAIN_AND_SUB: Final[dict[VehicleMode, tuple[int, int]]] = {
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
_MODE: Final = {numbers: mode for mode, numbers in _MAIN_AND_SUB.items()}
# Variants that are flown by the same hands: position slow, precision landing.
_VARIANTS: Final = {(3, 2): VehicleMode.POSITION, (4, 9): VehicleMode.LAND}

_LANDED: Final = {
    1: LandedState.ON_GROUND,
    2: LandedState.IN_AIR,
    3: LandedState.TAKING_OFF,
    4: LandedState.LANDING,
}

BOOT: Final = 1
_CALIBRATING: Final = 2
_STANDBY: Final = 3
_ACTIVE: Final = 4
_CRITICAL: Final = 5
_EMERGENCY: Final = 6
_TERMINATING: Final = 8
_SYSTEM_STATUS: Final = {
    FlightState.STARTING: _CALIBRATING,
    FlightState.STANDBY: _STANDBY,
    FlightState.READY: _STANDBY,
    FlightState.ENGAGING: _ACTIVE,
    FlightState.ACTIVE: _ACTIVE,
    FlightState.HOLDING: _CRITICAL,
    FlightState.LANDING: _ACTIVE,
    FlightState.PILOT: _STANDBY,
    FlightState.LISTENING: _STANDBY,
    FlightState.LOST: _EMERGENCY,
    FlightState.DONE: _STANDBY,
}


def mode_of(custom_mode: int) -> VehicleMode:
    """Return the flight mode of PX4's custom mode; UNKNOWN for those the companion never deals with."""
    numbers = (custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF)
    return _MODE.get(numbers) or _VARIANTS.get(numbers, VehicleMode.UNKNOWN)


def main_and_sub(mode: VehicleMode) -> tuple[int, int]:
    """Return PX4's main and sub mode.

    Raises:
        ValueError: for UNKNOWN.
    """
    if mode is VehicleMode.UNKNOWN:
        raise ValueError("an unknown mode has no number")
    return _MAIN_AND_SUB[mode]


def custom_mode_of(mode: VehicleMode) -> int:
    """Return PX4's custom mode of a flight mode; raises ValueError for UNKNOWN."""
    main, sub = main_and_sub(mode)
    return main << 16 | sub << 24


def is_armed(base_mode: int) -> bool:
    """Tell whether a heartbeat's base mode says armed."""
    return bool(base_mode & BASE_MODE_ARMED)


def landed_state_of(number: int) -> LandedState:
    """Return the landed state of EXTENDED_SYS_STATE; UNKNOWN for any other number."""
    return _LANDED.get(number, LandedState.UNKNOWN)


def is_failsafe(system_status: int) -> bool:
    """Tell whether the autopilot reports critical, emergency or termination."""
    return system_status in (_CRITICAL, _EMERGENCY, _TERMINATING)


def system_status_of(state: FlightState | None) -> int:
    """Return the MAV_STATE that tells others the companion's state; None is before the first decision."""
    return BOOT if state is None else _SYSTEM_STATUS[state]
