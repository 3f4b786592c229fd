"""PX4's numbers."""

import pytest

from companion.drivers import px4_modes
from companion.messages import FlightState, LandedState, VehicleMode


@pytest.mark.parametrize(
    ("custom_mode", "mode"),
    [
        (50593792, VehicleMode.HOLD),  # as captured: 0x03040000
        (6 << 16, VehicleMode.OFFBOARD),
        (4 << 16 | 2 << 24, VehicleMode.TAKEOFF),
        (4 << 16 | 5 << 24, VehicleMode.RETURN),
        (4 << 16 | 6 << 24, VehicleMode.LAND),
        (4 << 16 | 9 << 24, VehicleMode.LAND),
        (3 << 16, VehicleMode.POSITION),
        (3 << 16 | 2 << 24, VehicleMode.POSITION),
        (3 << 16 | 1 << 24, VehicleMode.UNKNOWN),  # orbit
        (10 << 16, VehicleMode.UNKNOWN),  # termination
        (0, VehicleMode.UNKNOWN),
        (0xFFFFFFFF, VehicleMode.UNKNOWN),
    ],
)
def test_a_custom_mode_is_named(custom_mode: int, mode: VehicleMode) -> None:
    assert px4_modes.mode_of(custom_mode) is mode


@pytest.mark.parametrize("mode", [mode for mode in VehicleMode if mode is not VehicleMode.UNKNOWN])
def test_every_known_mode_goes_there_and_back(mode: VehicleMode) -> None:
    assert px4_modes.mode_of(px4_modes.custom_mode_of(mode)) is mode


def test_an_unknown_mode_has_no_number() -> None:
    with pytest.raises(ValueError, match="unknown mode"):
        px4_modes.custom_mode_of(VehicleMode.UNKNOWN)


def test_base_modes_as_captured() -> None:
    assert [px4_modes.is_armed(base) for base in (0x1D, 0x9D, 0x91, 0x11)] == [False, True, True, False]


def test_landed_states() -> None:
    assert [px4_modes.landed_state_of(number) for number in range(6)] == [
        LandedState.UNKNOWN,
        LandedState.ON_GROUND,
        LandedState.IN_AIR,
        LandedState.TAKING_OFF,
        LandedState.LANDING,
        LandedState.UNKNOWN,
    ]


def test_only_critical_states_are_a_failsafe() -> None:
    assert [status for status in range(9) if px4_modes.is_failsafe(status)] == [5, 6, 8]


def test_every_state_of_the_companion_has_a_system_status() -> None:
    statuses = {state: px4_modes.system_status_of(state) for state in FlightState}
    assert statuses[FlightState.STARTING] == 2
    assert statuses[FlightState.READY] == statuses[FlightState.LISTENING] == 3
    assert statuses[FlightState.ENGAGING] == statuses[FlightState.ACTIVE] == 4
    assert statuses[FlightState.HOLDING] == 5
    assert statuses[FlightState.LOST] == 6
    assert px4_modes.system_status_of(None) == 1
    assert 0 not in statuses.values()
