"""The pipeline decides from events alone: who may command, and when."""

from dataclasses import replace

import numpy as np

from companion.messages import FlightState, ModeRequest, VehicleMode
from tests.pipeline_rig import WISH, Rig, setpoints, texts


def test_nothing_is_sent_before_an_authorisation() -> None:
    rig = Rig()
    rig.airborne()
    outputs = rig.tick(100)
    assert rig.pipeline.state is FlightState.READY
    assert not setpoints(outputs)
    assert not [output for output in outputs if isinstance(output, ModeRequest)]


def test_engaging_streams_zero_for_half_a_second_before_asking_for_offboard() -> None:
    rig = Rig()
    rig.airborne()
    rig.authorise()
    outputs = rig.tick(30)
    request = next(output for output in outputs if isinstance(output, ModeRequest))
    before = outputs[: outputs.index(request)]
    assert request.mode is VehicleMode.OFFBOARD
    assert len(setpoints(before)) >= 25
    assert all(not output.v_map.any() for output in setpoints(outputs))
    assert rig.role.resets == 1


def test_the_role_commands_once_the_autopilot_is_in_offboard() -> None:
    rig = Rig()
    rig.active()
    sent = setpoints(rig.tick(50))
    assert rig.pipeline.state is FlightState.ACTIVE
    np.testing.assert_allclose(sent[-1].v_map, WISH)
    assert np.linalg.norm(sent[0].v_map) <= 4.0 * 0.02 * 2 + 1e-9


def test_an_authorisation_on_the_ground_is_refused_with_its_reason() -> None:
    rig = Rig()
    rig.tick(3)
    assert texts(rig.authorise()) == ["engage refused: vehicle is not flying"]
    rig.set(VehicleMode.TAKEOFF)
    rig.tick(100)
    assert rig.pipeline.state is FlightState.READY


def test_a_source_that_the_profile_does_not_name_is_refused() -> None:
    rig = Rig()
    rig.airborne()
    assert texts(rig.authorise("ground_station")) == ["engage refused: ground_station not permitted"]
    rig.tick(5)
    assert rig.pipeline.state is FlightState.READY


def test_a_mode_switch_authorises_only_where_the_profile_permits_it() -> None:
    permitted, forbidden = Rig(("mode_switch",)), Rig(("command",))
    for rig in (permitted, forbidden):
        rig.airborne()
        rig.tick(5)
        rig.set(VehicleMode.OFFBOARD)
        rig.tick(5)
    assert permitted.pipeline.state is FlightState.ACTIVE
    assert forbidden.pipeline.state is FlightState.READY


def test_a_takeover_ends_the_stream_and_flicking_back_does_not_resume_it() -> None:
    rig = Rig(("command", "mode_switch"))
    rig.active()
    rig.set(VehicleMode.POSITION)
    assert not setpoints(rig.tick(10))
    assert rig.pipeline.state is FlightState.PILOT
    rig.set(VehicleMode.OFFBOARD)
    assert not setpoints(rig.tick(100))
    assert rig.pipeline.state is FlightState.PILOT


def test_after_a_takeover_a_new_authorisation_starts_from_zero_again() -> None:
    rig = Rig()
    rig.active()
    rig.set(VehicleMode.POSITION)
    rig.tick(10)
    rig.authorise()
    sent = setpoints(rig.tick(10))
    assert rig.pipeline.state is FlightState.ENGAGING
    assert all(not output.v_map.any() for output in sent)
    assert rig.role.resets == 2


def test_a_failsafe_of_the_autopilot_is_never_fought() -> None:
    rig = Rig()
    rig.active()
    rig.vehicle = replace(rig.vehicle, mode=VehicleMode.LAND, failsafe=True)
    outputs = rig.tick(100)
    assert not setpoints(outputs)
    assert not [output for output in outputs if isinstance(output, ModeRequest)]
    assert "pilot: autopilot failsafe" in texts(outputs)
