import pytest

from companion.messages import VehicleMode
from sitl.autopilot_failsafe import first_possible
from sitl.autopilot_inputs import Sticks
from sitl.autopilot_modes import Conditions, can_arm, can_run
from tests.sitl.autopilot_rig import Rig


def test_losing_setpoints_lands_after_the_loss_time_and_a_short_latency_without_gnss() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.setpoint = None
    last_ns = rig.t_ns
    rig.run(1.0)
    assert rig.mode() is VehicleMode.OFFBOARD
    assert rig.run(1.0, lambda: rig.mode() is VehicleMode.LAND)
    assert 1.0 <= (rig.t_ns - last_ns) * 1e-9 <= 1.15
    assert rig.autopilot.failsafe
    assert rig.autopilot.user_mode is VehicleMode.OFFBOARD


@pytest.mark.parametrize(
    ("action", "gnss", "sticks", "expected"),
    [
        (0, True, False, VehicleMode.RETURN),
        (0, False, False, VehicleMode.LAND),
        (0, False, True, VehicleMode.POSITION),
        (1, False, True, VehicleMode.ALTITUDE),
        (3, True, False, VehicleMode.RETURN),
        (3, False, False, VehicleMode.LAND),
        (4, True, False, VehicleMode.LAND),
        (5, True, False, VehicleMode.HOLD),
        (5, False, False, VehicleMode.LAND),
    ],
)
def test_the_configured_action_follows_the_loss_of_setpoints(
    action: int, gnss: bool, sticks: bool, expected: VehicleMode
) -> None:
    rig = Rig({"COM_OBL_RC_ACT": action}, gnss=gnss)
    _to_offboard(rig, gnss)
    rig.setpoint = None
    for _ in range(30):
        if sticks:
            rig.autopilot.pilot_sticks(rig.t_ns, Sticks())
        rig.run(0.05)
    assert rig.mode() is expected
    assert rig.autopilot.failsafe


@pytest.mark.parametrize(("rate_hz", "stays"), [(5.0, True), (1.05, True), (0.9, False), (0.5, False)])
def test_only_gaps_longer_than_the_loss_time_leave_offboard(rate_hz: float, stays: bool) -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.setpoint_period_ns = round(1e9 / rate_hz)
    left = rig.run(5.0, lambda: rig.mode() is not VehicleMode.OFFBOARD)
    assert left is not stays


@pytest.mark.parametrize("action", [0, 4])
def test_resuming_the_stream_brings_offboard_back_by_itself(action: int) -> None:
    rig = Rig({"COM_OBL_RC_ACT": action})
    rig.take_off_to_offboard()
    rig.setpoint = None
    rig.run(1.5)
    assert rig.mode() is VehicleMode.LAND
    rig.fly_offboard((0.0, 0.0, 0.0))
    rig.run(0.3)
    assert rig.mode() is VehicleMode.OFFBOARD
    assert not rig.autopilot.failsafe


def test_offboard_returns_even_after_touchdown_as_long_as_it_is_armed() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.setpoint = None
    assert rig.run(15.0, lambda: rig.autopilot.landed)
    assert rig.autopilot.armed
    rig.fly_offboard((0.0, 0.0, 1.0))
    rig.run(0.3)
    assert rig.mode() is VehicleMode.OFFBOARD


def test_a_mode_selected_during_the_failsafe_ends_it() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.setpoint = None
    rig.run(1.5)
    rig.autopilot.request_mode(VehicleMode.LAND)
    rig.fly_offboard((0.0, 0.0, 0.0))
    rig.run(0.5)
    assert rig.mode() is VehicleMode.LAND
    assert not rig.autopilot.failsafe


def test_lost_manual_control_lands_at_once_without_gnss() -> None:
    rig = Rig()
    _with_sticks(rig, gnss=False)
    last_ns = rig.t_ns
    assert rig.run(3.0, lambda: rig.mode() is VehicleMode.LAND)
    assert (rig.t_ns - last_ns) * 1e-9 <= 0.7


def test_lost_manual_control_holds_five_seconds_and_then_returns_with_gnss() -> None:
    rig = Rig(gnss=True)
    _with_sticks(rig, gnss=True)
    assert rig.run(1.0, lambda: rig.mode() is VehicleMode.HOLD)
    hold_ns = rig.t_ns
    assert rig.run(7.0, lambda: rig.mode() is VehicleMode.RETURN)
    assert (rig.t_ns - hold_ns) * 1e-9 == pytest.approx(5.0, abs=0.1)


def test_sticks_cannot_take_over_during_the_failsafe_delay_but_a_mode_switch_can() -> None:
    rig = Rig(gnss=True)
    _with_sticks(rig, gnss=True)
    rig.run(1.0)
    assert rig.mode() is VehicleMode.HOLD
    for pitch in (0.0, 0.0, 1.0, 0.0):
        rig.autopilot.pilot_sticks(rig.t_ns, Sticks(pitch=pitch))
        rig.run(0.05)
    assert rig.mode() is VehicleMode.HOLD
    rig.autopilot.pilot_select_mode(VehicleMode.POSITION)
    assert rig.mode() is VehicleMode.POSITION


def test_manual_control_that_never_was_there_is_not_missed() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.run(5.0)
    assert rig.mode() is VehicleMode.OFFBOARD


def test_the_offboard_exemption_ignores_lost_manual_control() -> None:
    rig = Rig({"COM_RCL_EXCEPT": 4})
    _with_sticks(rig, gnss=False)
    rig.run(3.0)
    assert rig.mode() is VehicleMode.OFFBOARD


def test_five_seconds_without_external_vision_end_in_a_blind_landing() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.vision = False
    last_ns = rig.t_ns
    assert rig.run(8.0, lambda: rig.mode() is VehicleMode.LAND)
    assert 4.7 <= (rig.t_ns - last_ns) * 1e-9 <= 5.3
    assert rig.autopilot.failsafe
    rig.run(0.1)
    assert rig.output is not None
    assert not rig.output.horizontal_controlled


def test_a_critical_battery_lands_only_if_configured() -> None:
    for action, expected in ((0, VehicleMode.OFFBOARD), (2, VehicleMode.LAND)):
        rig = Rig({"COM_LOW_BAT_ACT": action})
        rig.take_off_to_offboard()
        rig.autopilot.battery = 0.06
        rig.run(0.1)
        assert rig.mode() is expected


def test_every_mode_has_a_fallback_that_can_run_under_all_conditions() -> None:
    for bits in range(64):
        flags = [bool(bits >> shift & 1) for shift in range(6)]
        conditions = Conditions(*flags)
        for mode in VehicleMode:
            assert can_run(first_possible(mode, conditions), conditions)
            assert not can_arm(mode, conditions) or can_run(mode, conditions)


def _to_offboard(rig: Rig, gnss: bool) -> None:
    if not gnss:
        rig.take_off_to_offboard()
        return
    rig.run(4.0)
    rig.autopilot.request_mode(VehicleMode.TAKEOFF)
    rig.autopilot.request_arming(True)
    assert rig.run(15.0, lambda: rig.mode() is VehicleMode.HOLD)
    rig.fly_offboard((0.0, 0.0, 0.0))
    rig.run(0.1)
    assert rig.autopilot.request_mode(VehicleMode.OFFBOARD) == 0
    rig.fly_offboard((1.0, 0.0, 0.0))
    rig.run(3.0)


def _with_sticks(rig: Rig, gnss: bool) -> None:
    _to_offboard(rig, gnss)
    for _ in range(10):
        rig.autopilot.pilot_sticks(rig.t_ns, Sticks())
        rig.run(0.05)
