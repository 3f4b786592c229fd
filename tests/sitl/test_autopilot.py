import math
from dataclasses import replace

import numpy as np
import pytest

from companion.messages import LandedState, VehicleMode
from sitl.autopilot_inputs import ExternalVision, OffboardSetpoint, Sticks, Vector
from sitl.autopilot_modes import CommandResult
from sitl.autopilot_parameters import Parameters
from tests.sitl.autopilot_rig import Rig

ACCEPTED, REJECTED = CommandResult.ACCEPTED, CommandResult.TEMPORARILY_REJECTED


def test_without_gnss_arming_in_hold_is_refused_however_good_external_vision_is() -> None:
    rig = Rig()
    rig.run(2.0)
    assert rig.autopilot.estimator.position_valid
    assert rig.mode() is VehicleMode.HOLD
    assert rig.autopilot.request_arming(True) is REJECTED
    assert not rig.autopilot.armed


def test_without_gnss_takeoff_mode_arms_climbs_and_stays_in_takeoff() -> None:
    rig = Rig({"MIS_TAKEOFF_ALT": 2.0})
    rig.run(1.0)
    assert rig.autopilot.request_mode(VehicleMode.TAKEOFF) is ACCEPTED
    assert rig.autopilot.request_arming(True) is ACCEPTED
    rig.run(2.0)
    assert rig.landed_state() is LandedState.ON_GROUND, "motors spool up and ramp before lift-off"
    assert rig.run(5.0, lambda: rig.landed_state() is LandedState.TAKING_OFF)
    rig.run(10.0)
    assert rig.mode() is VehicleMode.TAKEOFF
    assert rig.landed_state() is LandedState.IN_AIR
    assert rig.body.p[2] == pytest.approx(2.0, abs=0.1)
    assert np.hypot(*rig.body.p[:2]) < 0.1


def test_takeoff_counts_height_and_place_from_where_motors_started() -> None:
    rig = Rig({"MIS_TAKEOFF_ALT": 2.0})
    rig.change = lambda sample: _moved(replace(sample, p_local=_raised(sample, 0.7)), 5.0, 0)
    rig.take_off()
    rig.run(5.0)
    assert rig.body.p[2] == pytest.approx(2.0, abs=0.06)
    assert np.hypot(*rig.body.p[:2]) < 0.1
    assert rig.autopilot.estimator.p_local == pytest.approx((5.0, 0.0, 2.7), abs=0.1)


def test_with_gnss_takeoff_ends_in_hold() -> None:
    rig = Rig(gnss=True)
    rig.run(4.0)
    assert rig.autopilot.request_mode(VehicleMode.TAKEOFF) is ACCEPTED
    assert rig.autopilot.request_arming(True) is ACCEPTED
    assert rig.run(15.0, lambda: rig.mode() is VehicleMode.HOLD)
    rig.run(5.0)
    assert rig.body.p[2] == pytest.approx(2.5, abs=0.2)


@pytest.mark.parametrize("mode", [VehicleMode.HOLD, VehicleMode.MISSION, VehicleMode.RETURN])
def test_modes_that_need_a_geographic_position_are_refused_in_flight_without_gnss(mode: VehicleMode) -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    assert rig.autopilot.request_mode(mode) is REJECTED
    assert rig.mode() is VehicleMode.OFFBOARD


def test_offboard_is_refused_without_a_setpoint_and_admitted_by_a_single_one() -> None:
    rig = Rig()
    rig.take_off()
    assert rig.autopilot.request_mode(VehicleMode.OFFBOARD) is REJECTED
    assert rig.mode() is VehicleMode.TAKEOFF
    rig.autopilot.offboard_setpoint(rig.t_ns, OffboardSetpoint(None, (0.0, 0.0, 0.0), False, None, 0.0))
    rig.run(0.9)
    assert rig.autopilot.request_mode(VehicleMode.OFFBOARD) is ACCEPTED


def test_offboard_arms_on_the_ground_and_climbs_three_seconds_later() -> None:
    rig = Rig()
    rig.run(1.0)
    rig.fly_offboard((0.0, 0.0, 1.0))
    rig.run(0.1)
    assert rig.autopilot.request_mode(VehicleMode.OFFBOARD) is ACCEPTED
    assert rig.autopilot.request_arming(True) is ACCEPTED
    start_ns = rig.t_ns
    assert rig.run(6.0, lambda: rig.body.p[2] > 0.02)
    assert (rig.t_ns - start_ns) * 1e-9 == pytest.approx(3.1, abs=0.4)


def test_landing_takes_the_vehicle_down_at_the_landing_speed_and_disarms_two_seconds_later() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    assert rig.autopilot.request_mode(VehicleMode.LAND) is ACCEPTED
    rig.run(2.0)
    assert rig.landed_state() is LandedState.LANDING
    assert rig.body.v[2] == pytest.approx(-0.7, abs=0.1)
    assert rig.run(10.0, lambda: rig.autopilot.landed)
    landed_ns = rig.t_ns
    assert rig.run(5.0, lambda: not rig.autopilot.armed)
    assert (rig.t_ns - landed_ns) * 1e-9 == pytest.approx(2.0, abs=0.05)


def test_after_an_offboard_flight_the_disarmed_autopilot_shows_offboard_again() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.setpoint = None
    assert rig.run(20.0, lambda: not rig.autopilot.armed)
    assert rig.mode() is VehicleMode.OFFBOARD
    assert not rig.autopilot.failsafe


def test_motors_that_never_lift_off_stop_after_ten_seconds() -> None:
    rig = Rig()
    rig.run(1.0)
    rig.fly_offboard((0.0, 0.0, 0.0))
    rig.run(0.1)
    rig.autopilot.request_mode(VehicleMode.OFFBOARD)
    assert rig.autopilot.request_arming(True) is ACCEPTED
    rig.run(9.9)
    assert rig.autopilot.armed
    rig.run(0.2)
    assert not rig.autopilot.armed


def test_motors_stop_in_the_air_only_by_force() -> None:
    rig = Rig()
    rig.take_off()
    assert rig.autopilot.request_arming(False) is REJECTED
    assert rig.autopilot.request_arming(False, force=True) is ACCEPTED
    assert not rig.autopilot.armed


@pytest.mark.parametrize("map_yaw", [0.0, 1.2, -2.9])
def test_velocity_setpoints_are_in_the_map_of_external_vision_whatever_its_heading(map_yaw: float) -> None:
    rig = Rig(map_yaw=map_yaw)
    rig.take_off_to_offboard()
    rig.fly_offboard((1.0, 0.0, 0.0))
    rig.run(3.0)
    expected = (math.cos(map_yaw), math.sin(map_yaw))
    assert rig.body.v[:2] == pytest.approx(expected, abs=0.05)


def test_a_commanded_yaw_is_flown_to_even_when_only_velocity_was_meant() -> None:
    rig = Rig(map_yaw=0.4)
    rig.body.yaw = 1.0
    rig.take_off_to_offboard()
    rig.fly_offboard((0.0, 0.0, 0.0), yaw=0.0)
    rig.run(5.0)
    assert rig.body.yaw == pytest.approx(0.4, abs=0.03)


def test_a_wrong_velocity_from_external_vision_makes_the_vehicle_really_fly_wrong() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    start_x = rig.body.p[0]

    def drifting(sample: ExternalVision) -> ExternalVision:
        x, y, z = sample.p_local or (0.0, 0.0, 0.0)
        v_x, v_y, v_z = sample.v or (0.0, 0.0, 0.0)
        elapsed_s = rig.t_ns * 1e-9 - start_s
        return replace(sample, p_local=(x - 0.2 * elapsed_s, y, z), v=(v_x - 0.2, v_y, v_z))

    start_s = rig.t_ns * 1e-9
    rig.change = drifting
    rig.run(5.0)
    assert rig.body.p[0] - start_x == pytest.approx(1.0, abs=0.25)


def test_a_fast_stick_takes_over_and_streaming_setpoints_do_not_take_it_back() -> None:
    rig = Rig()
    rig.take_off_to_offboard((0.3, 0.0, 0.0))
    _stick(rig, 0.0, seconds=0.3)
    assert rig.mode() is VehicleMode.OFFBOARD, "still sticks take nothing over"
    _stick(rig, 0.5, seconds=0.1)
    assert rig.mode() is VehicleMode.POSITION
    _stick(rig, 0.0, seconds=3.0)
    assert rig.mode() is VehicleMode.POSITION
    assert rig.autopilot.request_mode(VehicleMode.OFFBOARD) is ACCEPTED, "nothing protects the pilot"


def test_position_mode_is_refused_without_sticks_and_accepted_with_them() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    assert rig.autopilot.request_mode(VehicleMode.POSITION) is REJECTED
    _stick(rig, 0.0, seconds=0.2)
    assert rig.autopilot.request_mode(VehicleMode.POSITION) is ACCEPTED


def test_centred_sticks_in_position_mode_stop_and_hold() -> None:
    rig = Rig()
    rig.take_off_to_offboard((1.0, 0.0, 0.0))
    _stick(rig, 0.0, seconds=0.2)
    rig.autopilot.pilot_select_mode(VehicleMode.POSITION)
    _stick(rig, 0.0, seconds=3.0)
    held = rig.body.p.copy()
    _stick(rig, 0.0, seconds=5.0)
    assert np.linalg.norm(rig.body.p - held) < 0.1


def test_an_external_vision_jump_with_a_counted_reset_moves_no_vehicle_in_velocity_mode() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    before = rig.autopilot.estimator.motion.reset_counter
    place = rig.body.p.copy()
    rig.change = lambda sample: _moved(sample, 1.0, 1)
    rig.run(2.0)
    assert rig.autopilot.estimator.motion.reset_counter - before in (2, 3)
    assert np.linalg.norm(rig.body.p - place) < 0.15
    assert rig.autopilot.estimator.p_local[0] == pytest.approx(rig.body.p[0] + 1.0, abs=0.05)


def test_takeoff_hover_follows_a_counted_reset_instead_of_flying_to_the_old_coordinates() -> None:
    rig = Rig()
    rig.take_off()
    place = rig.body.p.copy()
    rig.change = lambda sample: _moved(sample, 2.0, 1)
    rig.run(4.0)
    assert np.linalg.norm(rig.body.p - place) < 0.2


def test_two_runs_with_one_seed_are_equal_and_another_seed_differs() -> None:
    def flight(seed: int) -> tuple[float, ...]:
        rig = Rig(seed=seed)
        rig.take_off_to_offboard((1.0, 0.0, 0.0))
        return tuple(rig.body.p)

    assert flight(1) == flight(1)
    assert flight(1) != flight(2)


def test_parameters_keep_their_types_and_refuse_unknown_names() -> None:
    parameters = Parameters({"MIS_TAKEOFF_ALT": 3})
    assert parameters["MIS_TAKEOFF_ALT"] == 3.0
    assert not parameters.set("COM_OBL_RC_ACT", 1.5)
    assert not parameters.set("NO_SUCH", 1)
    assert not parameters.set("MIS_TAKEOFF_ALT", math.nan)
    with pytest.raises(KeyError):
        Parameters({"NO_SUCH": 1})


def _stick(rig: Rig, pitch: float, seconds: float) -> None:
    for _ in range(round(seconds / 0.05)):
        rig.autopilot.pilot_sticks(rig.t_ns, Sticks(pitch=pitch))
        rig.run(0.05)


def _raised(sample: ExternalVision, height: float) -> Vector:
    x, y, z = sample.p_local or (0.0, 0.0, 0.0)
    return (x, y, z + height)


def _moved(sample: ExternalVision, distance: float, counter: int) -> ExternalVision:
    x, y, z = sample.p_local or (0.0, 0.0, 0.0)
    return replace(sample, p_local=(x + distance, y, z), reset_counter=counter)
