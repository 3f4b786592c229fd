"""Every state against every combination of facts: the promises hold without exception."""

import itertools
from collections.abc import Iterator

import pytest

from companion.messages import FlightState, VehicleMode
from companion.safety.checks import Facts
from companion.safety.supervisor import COMMANDING, TRANSITIONS, Supervisor

TRUTHS = [
    "link",
    "armed",
    "airborne",
    "failsafe",
    "standing",
    "odometry_usable",
    "odometry_lost",
    "map_jumped",
    "estimates_agree",
    "authorised",
    "revoked",
    "finished",
    "engage_timed_out",
    "mode_left",
    "stopping",
    "stalled",
]
MODES = [VehicleMode.OFFBOARD, VehicleMode.LAND, VehicleMode.POSITION]


def situation(mode: VehicleMode = VehicleMode.OFFBOARD, **changes: bool) -> Facts:
    """Return a healthy vehicle in the air with some facts changed."""
    truths = dict.fromkeys(TRUTHS, False) | dict.fromkeys(
        ["link", "armed", "airborne", "odometry_usable", "estimates_agree"], True
    )
    return Facts(mode=mode, problem="", **(truths | changes))


def all_situations() -> Iterator[Facts]:
    for values in itertools.product([False, True], repeat=len(TRUTHS)):
        truths = dict(zip(TRUTHS, values, strict=True))
        impossible = (truths["odometry_usable"] and truths["odometry_lost"]) or (
            truths["airborne"] and truths["standing"]
        )
        if impossible:
            continue
        for mode in MODES:
            yield Facts(mode=mode, problem="", **truths)


def next_state(state: FlightState, facts: Facts) -> FlightState:
    supervisor = Supervisor()
    supervisor.state = state
    supervisor.step(facts)
    return supervisor.state


def test_every_state_has_its_rules() -> None:
    assert set(TRANSITIONS) == set(FlightState)


def test_control_is_taken_only_when_authorised_flying_and_healthy() -> None:
    for facts in all_situations():
        for state in set(FlightState) - COMMANDING:
            if next_state(state, facts) in COMMANDING:
                assert next_state(state, facts) is FlightState.ENGAGING
                assert facts.authorised
                assert facts.armed
                assert facts.airborne
                assert facts.link
                assert facts.odometry_usable
                assert facts.estimates_agree
                assert not facts.failsafe
                assert not facts.map_jumped


def test_control_ends_when_the_autopilot_leaves_offboard() -> None:
    for facts in all_situations():
        if facts.link and facts.mode is VehicleMode.POSITION:
            for state in (FlightState.ACTIVE, FlightState.HOLDING):
                assert next_state(state, facts) in {FlightState.PILOT, FlightState.LOST}
            assert next_state(FlightState.LANDING, facts) not in {FlightState.ACTIVE, FlightState.HOLDING}


def test_a_moving_command_needs_usable_odometry() -> None:
    for facts in all_situations():
        for state in FlightState:
            if next_state(state, facts) is FlightState.ACTIVE and state is not FlightState.ACTIVE:
                assert facts.odometry_usable
        if not facts.odometry_usable:
            assert next_state(FlightState.ACTIVE, facts) is not FlightState.ACTIVE


def test_a_pilot_keeps_control_until_re_authorised_or_on_the_ground() -> None:
    for facts in all_situations():
        for state in (FlightState.PILOT, FlightState.LISTENING, FlightState.LOST):
            after = next_state(state, facts)
            if after is not state:
                assert facts.authorised or facts.on_ground


def test_being_told_to_stop_a_stall_or_losing_authorisation_ends_control() -> None:
    for facts in all_situations():
        for state in (FlightState.ENGAGING, FlightState.ACTIVE, FlightState.HOLDING):
            if facts.stopping or facts.stalled:
                assert next_state(state, facts) is FlightState.LOST
            elif facts.revoked:
                assert next_state(state, facts) is FlightState.PILOT


@pytest.mark.parametrize(
    ("start", "facts", "expected"),
    [
        (
            FlightState.STARTING,
            situation(VehicleMode.HOLD, armed=False, airborne=False, standing=True),
            FlightState.STANDBY,
        ),
        (FlightState.STARTING, situation(VehicleMode.OFFBOARD), FlightState.LISTENING),
        (FlightState.STARTING, situation(airborne=False, armed=False), FlightState.STARTING),
        (FlightState.STANDBY, situation(VehicleMode.TAKEOFF), FlightState.READY),
        (FlightState.READY, situation(VehicleMode.TAKEOFF), FlightState.READY),
        (FlightState.READY, situation(VehicleMode.TAKEOFF, authorised=True), FlightState.ENGAGING),
        (FlightState.ENGAGING, situation(VehicleMode.OFFBOARD), FlightState.ACTIVE),
        (FlightState.ENGAGING, situation(VehicleMode.TAKEOFF, engage_timed_out=True), FlightState.READY),
        (FlightState.ENGAGING, situation(VehicleMode.POSITION, mode_left=True), FlightState.PILOT),
        (FlightState.ACTIVE, situation(odometry_usable=False), FlightState.HOLDING),
        (FlightState.HOLDING, situation(), FlightState.ACTIVE),
        (FlightState.HOLDING, situation(odometry_usable=False, odometry_lost=True), FlightState.LOST),
        (FlightState.ACTIVE, situation(finished=True), FlightState.LANDING),
        (FlightState.ACTIVE, situation(map_jumped=True), FlightState.LANDING),
        (FlightState.ACTIVE, situation(link=False), FlightState.LOST),
        (FlightState.LANDING, situation(VehicleMode.LAND, armed=False, airborne=False), FlightState.DONE),
        (FlightState.LANDING, situation(VehicleMode.POSITION), FlightState.PILOT),
        (FlightState.PILOT, situation(VehicleMode.OFFBOARD), FlightState.PILOT),
        (FlightState.PILOT, situation(VehicleMode.POSITION, authorised=True), FlightState.ENGAGING),
    ],
)
def test_the_flight_goes_as_expected(start: FlightState, facts: Facts, expected: FlightState) -> None:
    assert next_state(start, facts) is expected


def test_a_refusal_names_what_is_missing() -> None:
    supervisor = Supervisor()
    supervisor.state = FlightState.READY
    assert supervisor.refusal(situation(link=False)) == "no link to the autopilot"
    assert supervisor.refusal(situation(armed=False)) == "vehicle is not flying"
    assert supervisor.refusal(situation(failsafe=True)) == "autopilot is in failsafe"
    assert supervisor.refusal(situation()) == ""
    supervisor.state = FlightState.ACTIVE
    assert supervisor.refusal(situation()) == "already in control"
