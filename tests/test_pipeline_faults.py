"""What the pipeline does when something goes wrong in the air."""

from dataclasses import replace

import numpy as np
import pytest

from companion.messages import FlightState, LandedState, ModeRequest, Odometry, StateChange, VehicleMode
from tests.pipeline_rig import Rig, setpoints, texts


def test_stale_odometry_brakes_then_falls_silent() -> None:
    rig = Rig()
    rig.active()
    rig.tick(50)
    rig.odometry_runs = False
    holding = setpoints(rig.tick(40))
    states = [rig.pipeline.state]
    assert not holding[-1].v_map.any()
    rig.tick(40)
    states.append(rig.pipeline.state)
    assert states == [FlightState.HOLDING, FlightState.LOST]
    assert not setpoints(rig.tick(20))


def test_a_short_gap_of_the_odometry_ends_in_flying_on() -> None:
    rig = Rig()
    rig.active()
    rig.odometry_runs = False
    rig.tick(20)
    states = [rig.pipeline.state]
    rig.odometry_runs = True
    rig.tick(2)
    states.append(rig.pipeline.state)
    assert states == [FlightState.HOLDING, FlightState.ACTIVE]


def test_without_scans_the_vehicle_brakes_though_the_inertial_odometry_runs_on() -> None:
    rig = Rig()
    rig.active()
    rig.tick(50)
    rig.scans_run = False
    sent = setpoints(rig.tick(50))
    assert rig.pipeline.state is FlightState.HOLDING
    assert not sent[-1].v_map.any()


def test_no_moving_setpoint_rests_on_data_older_than_200_ms() -> None:
    rig = Rig()
    rig.active()
    rig.odometry_runs = False
    for setpoint in setpoints(rig.tick(60)):
        if setpoint.reason == "role":
            assert setpoint.t_ns - setpoint.t_data_ns <= 200_000_000


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_a_role_that_goes_mad_moves_nothing_beyond_the_limits(bad: float) -> None:
    rig = Rig()
    rig.active()
    rig.role.wish = np.array([bad, 0.0, bad])
    for setpoint in setpoints(rig.tick(100)):
        assert np.isfinite(setpoint.v_map).all()
        assert np.linalg.norm(setpoint.v_map[:2]) <= 2.0 + 1e-9


def test_a_moved_map_ends_the_flight_by_landing() -> None:
    rig = Rig()
    rig.active()
    rig.odometry = replace(rig.odometry, reset_counter=1)
    outputs = rig.tick(2)
    requests = [output for output in outputs if isinstance(output, ModeRequest)]
    assert rig.pipeline.state is FlightState.LANDING
    assert [request.mode for request in requests] == [VehicleMode.LAND]


def test_a_finished_role_lands_and_the_flight_is_done_on_the_ground() -> None:
    rig = Rig()
    rig.active()
    rig.role.finished = True
    outputs = rig.tick(3)
    assert [output.mode for output in outputs if isinstance(output, ModeRequest)] == [VehicleMode.LAND]
    rig.set(VehicleMode.LAND)
    assert not setpoints(rig.tick(5))
    rig.set(VehicleMode.HOLD, airborne=False)
    rig.tick(2)
    assert rig.pipeline.state is FlightState.DONE


def test_a_process_that_wakes_up_in_the_air_only_listens() -> None:
    rig = Rig(("command", "mode_switch"))
    rig.set(VehicleMode.OFFBOARD)
    outputs = rig.tick(100)
    assert rig.pipeline.state is FlightState.LISTENING
    assert not setpoints(outputs)


def test_being_told_to_stop_brakes_for_a_second_and_ends_in_silence() -> None:
    rig = Rig()
    rig.active()
    rig.tick(50)
    rig.pipeline.request_stop(rig.t_ns)
    braking = setpoints(rig.tick(45))
    assert not braking[-1].v_map.any()
    assert not setpoints(rig.tick(20)[5:])
    assert rig.pipeline.state is FlightState.LOST


def test_after_a_stall_nothing_is_sent_without_a_new_authorisation() -> None:
    rig = Rig()
    rig.active()
    rig.t_ns += 600_000_000
    assert not setpoints(rig.tick(50))
    assert rig.pipeline.state is FlightState.LOST


def test_a_permission_that_waited_is_none() -> None:
    rig = Rig()
    rig.airborne()
    rig.authorise()
    rig.t_ns += 600_000_000
    rig.tick(5)
    assert rig.pipeline.state is not FlightState.ENGAGING


def test_a_permission_withdrawn_before_it_was_used_is_none() -> None:
    rig = Rig()
    rig.airborne()
    rig.authorise()
    rig.authorise(granted=False)
    rig.tick(5)
    assert rig.pipeline.state is FlightState.READY


def test_offboard_that_was_there_already_is_no_switch() -> None:
    rig = Rig(("mode_switch",))
    rig.tick()
    rig.set(VehicleMode.OFFBOARD)
    rig.tick(50)
    assert rig.pipeline.state is FlightState.READY


def test_after_a_restart_of_the_odometry_control_is_refused_until_landed() -> None:
    rig = Rig()
    rig.airborne()
    rig.odometry = replace(rig.odometry, reset_counter=1)
    rig.tick()
    assert texts(rig.authorise()) == ["engage refused: the map moved since take-off"]
    rig.tick(5)
    assert rig.pipeline.state is FlightState.READY


def test_a_pilot_on_the_ground_is_not_asked_to_land() -> None:
    rig = Rig()
    rig.active()
    rig.role.finished = True
    rig.tick(3)
    rig.vehicle = replace(rig.vehicle, mode=VehicleMode.POSITION, landed=LandedState.ON_GROUND)
    assert not [output for output in rig.tick(150) if isinstance(output, ModeRequest)]


def test_a_role_that_breaks_makes_the_vehicle_brake_and_fall_silent() -> None:
    rig = Rig()
    rig.active()
    rig.tick(50)
    rig.role.broken = True
    outputs = rig.tick(45)
    assert any(text.startswith("role failed: ZeroDivisionError") for text in texts(outputs))
    assert not setpoints(outputs)[-1].v_map.any()
    rig.tick(10)
    assert not setpoints(rig.tick(10))


def test_a_withdrawn_authorisation_ends_the_stream() -> None:
    rig = Rig()
    rig.active()
    rig.authorise(granted=False)
    assert not setpoints(rig.tick(5))
    assert rig.pipeline.state is FlightState.PILOT


def test_every_change_of_state_is_announced() -> None:
    rig = Rig()
    rig.tick()
    rig.set(VehicleMode.TAKEOFF)
    outputs = rig.tick()
    change = next(output for output in outputs if isinstance(output, StateChange))
    assert (change.previous, change.current) == (FlightState.STANDBY, FlightState.READY)
    assert texts(outputs) == [f"ready: {change.reason}"]


def test_a_pose_that_jumps_is_kept_from_px4_and_ends_the_flight_by_landing() -> None:
    rig = Rig()
    rig.active()
    rig.tick(50)
    rig.odometry = replace(rig.odometry, p_map=np.add(rig.odometry.p_map, [1.0, 0.0, 0.0]))
    sent = rig.pipeline.decide(replace(rig.odometry, t_ns=rig.t_ns + 5_000_000))
    braking = setpoints(rig.tick(20))
    assert not sent
    assert rig.pipeline.state is FlightState.LANDING
    assert not braking[-1].v_map.any()
    rig.tick(10)
    (forwarded,) = rig.pipeline.decide(replace(rig.odometry, t_ns=rig.t_ns + 5_000_000))
    assert isinstance(forwarded, Odometry)
    assert forwarded.reset_counter == 1
