"""Commands to the autopilot: asked for, repeated within bounds, ended by whoever chooses otherwise."""

import math

import pytest

from companion.drivers.mavlink_codec import MavlinkEncoder, MavlinkParser
from companion.drivers.px4_commands import CommandState
from companion.messages import (
    FlightState,
    MavlinkMessage,
    VehicleMode,
)
from tests.drivers.px4_peer import (
    MS,
    SECOND,
    SYSTEM,
    T0,
    acknowledgement,
    connected,
    heartbeat,
)


def commands(messages: list[MavlinkMessage], number: int) -> list[MavlinkMessage]:
    return [m for m in messages if m.name == "COMMAND_LONG" and m.fields["command"] == number]


def test_telemetry_is_asked_for_one_command_after_the_other() -> None:
    session = connected()
    asked = []
    for step in range(30):
        t = T0 + step * 100 * MS
        for m in commands(session.poll(t, None), 511):
            asked.append((m.fields["param1"], m.fields["param2"]))
            session.receive(acknowledgement(511, 4 if m.fields["param1"] == 436 else 0), t + MS)
    expected = {32: 33333, 31: 20000, 331: 33333, 245: 100000, 436: 100000, 230: 100000}
    assert dict(asked) == expected
    assert len(asked) <= len(expected) + 1
    assert session.statistics(T0).commands_denied == 1


def test_a_command_is_repeated_four_times_and_given_up() -> None:
    session = connected()
    sent = session.request_mode(VehicleMode.OFFBOARD, T0)
    times = [T0] * len(commands(sent, 176))
    for step in range(1, 400):
        t = T0 + step * 10 * MS
        session.receive(heartbeat(), t)
        for m in commands(session.poll(t, None), 176):
            times.append(t)
            assert m.fields["confirmation"] == len(times) - 1
    assert [(t - T0) // MS for t in times] == [0, 500, 1000, 1500]
    assert session.mode_request.state is CommandState.TIMED_OUT
    assert session.statistics(T0).commands_timed_out >= 1


@pytest.mark.parametrize(
    ("mode", "number", "parameters"),
    [
        (VehicleMode.OFFBOARD, 176, [1.0, 6.0, 0.0, 0.0]),
        (VehicleMode.HOLD, 176, [1.0, 4.0, 3.0, 0.0]),
        (VehicleMode.LAND, 21, [0.0, 0.0, 0.0, math.nan]),
    ],
)
def test_modes_are_asked_for_with_px4s_numbers(
    mode: VehicleMode, number: int, parameters: list[float]
) -> None:
    (sent,) = commands(connected().request_mode(mode, T0), number)
    assert [sent.fields[f"param{i}"] for i in range(1, 5)] == pytest.approx(parameters, nan_ok=True)
    assert (sent.fields["target_system"], sent.fields["target_component"]) == (SYSTEM, 1)
    (read,) = MavlinkParser().feed(MavlinkEncoder().encode(sent))
    assert read.fields["command"] == number


def test_an_armed_vehicle_keeps_its_armed_flag() -> None:
    session = connected()
    session.receive(heartbeat(armed=True), T0)
    (sent,) = commands(session.request_mode(VehicleMode.OFFBOARD, T0), 176)
    assert sent.fields["param1"] == 129.0


@pytest.mark.parametrize(
    ("result", "state"),
    [
        (0, CommandState.ACCEPTED),
        (1, CommandState.DENIED),
        (2, CommandState.DENIED),
        (5, CommandState.PENDING),
    ],
)
def test_the_outcome_of_a_mode_request_is_kept(result: int, state: CommandState) -> None:
    session = connected()
    session.request_mode(VehicleMode.OFFBOARD, T0)
    session.receive(acknowledgement(176, result, target=(SYSTEM, 190)), T0 + MS)
    before = session.mode_request
    assert (before.state, before.result) == (CommandState.PENDING, None)
    session.receive(acknowledgement(176, result), T0 + MS)
    after = session.mode_request
    assert (after.state, after.result) == (state, result)
    assert commands(session.poll(T0 + SECOND, None), 176) == []


def test_a_pilots_mode_change_ends_a_request_that_was_not_answered() -> None:
    session = connected()
    session.request_mode(VehicleMode.OFFBOARD, T0)
    # OFFBOARD was reached and the pilot took over, back to the mode of before; both answers were lost.
    session.receive(heartbeat(VehicleMode.OFFBOARD), T0 + 100 * MS)
    session.receive(heartbeat(VehicleMode.HOLD), T0 + 200 * MS)
    for step in range(3, 40):
        assert commands(session.poll(T0 + step * 100 * MS, None), 176) == []
    assert session.mode_request.state is CommandState.WITHDRAWN


def test_a_mode_that_is_reached_needs_no_answer() -> None:
    session = connected()
    session.request_mode(VehicleMode.OFFBOARD, T0)
    session.receive(heartbeat(VehicleMode.OFFBOARD), T0 + 100 * MS)
    assert commands(session.poll(T0 + SECOND, None), 176) == []
    assert session.mode_request.state is CommandState.ACCEPTED


def test_a_request_can_be_withdrawn_and_the_next_one_replaces_it() -> None:
    session = connected()
    session.request_mode(VehicleMode.OFFBOARD, T0)
    session.withdraw_mode_request()
    assert session.mode_request.state is CommandState.WITHDRAWN
    session.request_mode(VehicleMode.OFFBOARD, T0)
    session.request_mode(VehicleMode.LAND, T0)
    assert session.mode_request.mode is VehicleMode.LAND
    later = session.poll(T0 + SECOND, None)
    assert commands(later, 176) == []
    assert len(commands(later, 21)) == 1


def test_nothing_is_asked_of_an_autopilot_that_is_gone() -> None:
    session = connected()
    session.request_mode(VehicleMode.OFFBOARD, T0)
    messages = session.poll(T0 + 4 * SECOND, FlightState.READY)
    assert [m.name for m in messages] == ["HEARTBEAT"]
    assert session.mode_request.state is CommandState.WITHDRAWN
    texts = [report.text for report in session.reports()]
    assert texts == [f"autopilot {SYSTEM} connected", "autopilot lost"]
    assert session.reports() == []
