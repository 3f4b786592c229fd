"""The conversation with the autopilot: what is believed, what is answered, what never leaves."""

import math

import numpy as np
import pytest

from companion.drivers.mavlink_codec import MavlinkEncoder, MavlinkParser
from companion.drivers.px4_commands import CommandState
from companion.drivers.px4_session import Px4Session
from companion.geometry import rotation
from companion.messages import (
    FlightState,
    LandedState,
    MavlinkMessage,
    OdometryStatus,
    Severity,
    StatusText,
    VehicleMode,
)
from tests.drivers.px4_peer import (
    MS,
    SECOND,
    STATION,
    SYSTEM,
    T0,
    a_setpoint,
    acknowledgement,
    an_odometry,
    answer_clock,
    command,
    connected,
    heartbeat,
    message,
    settings,
)


def commands(messages: list[MavlinkMessage], number: int) -> list[MavlinkMessage]:
    return [m for m in messages if m.name == "COMMAND_LONG" and m.fields["command"] == number]


def test_nothing_is_connected_before_a_heartbeat_and_three_seconds_after_the_last() -> None:
    session = Px4Session(settings())
    assert not session.vehicle_state(T0).connected
    session.receive(heartbeat(), T0)
    assert session.vehicle_state(T0 + 3 * SECOND).connected
    assert not session.vehicle_state(T0 + 3 * SECOND + 1).connected


def test_a_foreign_autopilot_is_counted_and_changes_nothing() -> None:
    session = Px4Session(settings())
    session.receive(heartbeat(VehicleMode.OFFBOARD, armed=True, system_id=42), T0)
    state = session.vehicle_state(T0)
    assert (state.connected, state.armed, state.mode) == (False, False, VehicleMode.UNKNOWN)
    assert session.foreign_autopilots() == [42]
    assert session.statistics(T0).foreign == {42: 1}


def test_a_ground_station_is_not_a_foreign_autopilot() -> None:
    session = Px4Session(settings())
    session.receive(MavlinkMessage("HEARTBEAT", 255, 190, {"type": 6, "autopilot": 8}), T0)
    session.receive(MavlinkMessage("HEARTBEAT", 254, 190, {"type": 6, "autopilot": 8}), T0)
    assert session.foreign_autopilots() == []


def test_a_heartbeat_of_another_kind_of_autopilot_is_no_px4() -> None:
    session = Px4Session(settings())
    beat = heartbeat()
    beat.fields["autopilot"] = 3
    session.receive(beat, T0)
    assert not session.vehicle_state(T0).connected
    assert session.statistics(T0).malformed == 1


def test_other_components_of_the_vehicle_are_not_the_autopilot() -> None:
    session = Px4Session(settings())
    session.receive(MavlinkMessage("HEARTBEAT", SYSTEM, 100, heartbeat().fields), T0)
    assert not session.vehicle_state(T0).connected


def test_local_position_and_attitude_arrive_in_the_map() -> None:
    session = connected()
    session.receive(
        message("LOCAL_POSITION_NED", time_boot_ms=1, x=1.0, y=2.0, z=-3.0, vx=0.1, vy=0.2, vz=-0.3), T0 + 5
    )
    # Yawed 90 degrees to the right about down.
    half = math.sqrt(0.5)
    session.receive(message("ATTITUDE_QUATERNION", q1=half, q2=0.0, q3=0.0, q4=half), T0 + 6)
    state = session.vehicle_state(T0 + 7)
    assert state.t_local_ns == T0 + 5
    assert state.p_map == pytest.approx([1.0, -2.0, 3.0])
    assert state.v_map == pytest.approx([0.1, -0.2, 0.3])
    assert float(rotation.yaw_of(state.q_map_body)) == pytest.approx(-math.pi / 2)


@pytest.mark.parametrize("value", [math.nan, math.inf, None, "1", True, [1.0], 1e12])
@pytest.mark.parametrize("field", ["x", "vz"])
def test_a_position_with_a_bad_number_is_counted_and_ignored(field: str, value: object) -> None:
    session = connected()
    good: dict[str, object] = {
        "time_boot_ms": 1,
        "x": 1.0,
        "y": 2.0,
        "z": 3.0,
        "vx": 0.0,
        "vy": 0.0,
        "vz": 0.0,
    }
    session.receive(message("LOCAL_POSITION_NED", **{**good, field: value}), T0 + 5)
    session.receive(message("LOCAL_POSITION_NED", x=1.0), T0 + 6)
    assert session.vehicle_state(T0 + 7).t_local_ns == 0
    assert session.statistics(T0).malformed == 2


def test_mode_changes_are_counted_from_heartbeat_and_current_mode_alike() -> None:
    session = connected()
    assert session.vehicle_state(T0).mode_changes == 0
    session.receive(heartbeat(VehicleMode.OFFBOARD, armed=True, status=4), T0 + SECOND)
    session.receive(message("CURRENT_MODE", standard_mode=0, custom_mode=6 << 16), T0 + SECOND)
    assert session.vehicle_state(T0 + SECOND).mode_changes == 1
    session.receive(message("CURRENT_MODE", standard_mode=0, custom_mode=3 << 16), T0 + SECOND)
    state = session.vehicle_state(T0 + SECOND)
    assert (state.mode, state.mode_changes, state.armed) == (VehicleMode.POSITION, 2, True)


def test_failsafe_landed_state_and_reset_counter_are_reported() -> None:
    session = connected()
    session.receive(heartbeat(VehicleMode.LAND, armed=True, status=5), T0)
    session.receive(message("EXTENDED_SYS_STATE", vtol_state=0, landed_state=4), T0)
    session.receive(message("ODOMETRY", reset_counter=34, pose_covariance=[0.002] + [0.0] * 20), T0)
    state = session.vehicle_state(T0)
    assert (state.failsafe, state.landed, state.estimator_reset_counter) == (True, LandedState.LANDING, 34)
    assert session.health().position_variance_m2 == 0.002


def test_the_companions_heartbeat_tells_its_true_state_once_a_second() -> None:
    session = Px4Session(settings())
    states = [FlightState.STARTING, FlightState.READY, FlightState.ACTIVE, FlightState.HOLDING]
    sent = []
    for step in range(400):
        for m in session.poll(T0 + step * 10 * MS, states[step // 100]):
            assert m.name == "HEARTBEAT"  # nothing else goes to an autopilot that was never heard
            sent.append((m.fields["system_status"], m.fields["type"], m.fields["autopilot"]))
            assert (m.system_id, m.component_id) == (SYSTEM, 191)
    assert sent == [(2, 18, 8), (3, 18, 8), (4, 18, 8), (5, 18, 8)]


def test_clock_offset_and_round_trip_are_measured() -> None:
    session = connected(autopilot_ns=5 * SECOND)
    statistics = session.statistics(T0)
    assert statistics.clock_offset_ns == 5 * SECOND - T0
    assert statistics.round_trip_ns == 0
    (reply,) = session.receive(message("TIMESYNC", tc1=0, ts1=5 * SECOND + 7), T0 + 10)
    assert reply.fields == {"tc1": 5 * SECOND + 10, "ts1": 5 * SECOND + 7}


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


def test_a_fresh_setpoint_leaves() -> None:
    session = connected()
    sent = session.setpoint(a_setpoint(T0), T0 + 10 * MS)
    assert sent is not None
    assert sent.name == "SET_POSITION_TARGET_LOCAL_NED"
    assert sent.fields["time_boot_ms"] == 5010
    assert session.statistics(T0).sent == {"setpoint": 1}


@pytest.mark.parametrize(("age_ms", "leaves"), [(0, True), (200, True), (201, False), (-51, False)])
def test_old_data_moves_nothing(age_ms: int, leaves: bool) -> None:
    session = connected()
    setpoint = a_setpoint(T0)
    assert (session.setpoint(setpoint, T0 + age_ms * MS) is not None) is leaves


def test_standing_still_needs_no_fresh_data_but_a_fresh_decision() -> None:
    session = connected()
    now = T0 + SECOND
    still = a_setpoint(now, (0.0, 0.0, 0.0), 0.0)
    brake = type(still)(now, T0, 0, still.v_map, 0.0, "hold: odometry stale")
    assert session.setpoint(brake, now) is not None
    turning = type(still)(now, T0, 0, still.v_map, 0.1, "turn")
    assert session.setpoint(turning, now) is None
    assert session.setpoint(brake, now + 201 * MS) is None
    assert session.statistics(now).refused == {"setpoint on stale data": 1, "setpoint stale": 1}


def test_a_setpoint_that_is_not_finite_is_counted() -> None:
    session = connected()
    assert session.setpoint(a_setpoint(T0, (math.nan, 0.0, 0.0)), T0) is None
    assert session.statistics(T0).refused == {"setpoint not finite": 1}


def test_no_setpoint_goes_to_an_autopilot_that_is_not_heard() -> None:
    session = Px4Session(settings())
    assert session.setpoint(a_setpoint(T0), T0) is None
    assert session.statistics(T0).refused == {"setpoint not connected": 1}


def test_odometry_carries_the_autopilots_time() -> None:
    session = connected(autopilot_ns=5 * SECOND)
    sent = session.odometry(an_odometry(T0 + 100 * MS), T0 + 140 * MS)
    assert sent is not None
    assert sent.fields["time_usec"] == 5_100_000
    (read,) = MavlinkParser().feed(MavlinkEncoder().encode(sent))
    assert read.fields["x"] == 1.0


def test_odometry_waits_for_the_autopilots_clock() -> None:
    session = Px4Session(settings())
    session.receive(heartbeat(), T0)
    assert session.odometry(an_odometry(T0), T0) is None
    answer_clock(session, T0, 5 * SECOND)
    assert session.odometry(an_odometry(T0), T0) is not None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"status": OdometryStatus.LOST}, "lost"),
        ({"status": OdometryStatus.INITIALISING}, "initialising"),
        ({"quality": 9}, "poor"),
        ({"t_ns": T0 - 201 * MS}, "stale"),
        ({"t_ns": T0 + 51 * MS}, "stale"),
        ({"p_map": np.array([np.nan, 0.0, 0.0])}, "not finite"),
    ],
)
def test_odometry_that_is_not_to_be_trusted_is_not_sent(changes: dict[str, object], reason: str) -> None:
    session = connected()
    assert session.odometry(an_odometry(**{"t_ns": T0, **changes}), T0) is None  # type: ignore[arg-type]
    assert session.statistics(T0).refused == {f"odometry {reason}": 1}


def test_degraded_odometry_is_sent_with_its_quality() -> None:
    sent = connected().odometry(an_odometry(T0, status=OdometryStatus.DEGRADED, quality=30), T0)
    assert sent is not None
    assert sent.fields["quality"] == 30


@pytest.mark.parametrize(("source_hz", "expected"), [(200, 50), (50, 50), (40, 40)])
def test_odometry_leaves_at_its_rate_and_no_faster(source_hz: int, expected: int) -> None:
    session = connected()
    sent = 0
    for step in range(source_hz * 2):
        t = T0 + step * SECOND // source_hz
        sent += session.odometry(an_odometry(t), t) is not None
    assert abs(sent - 2 * expected) <= 2


def test_a_jump_of_the_map_is_never_thinned_out() -> None:
    session = connected()
    assert session.odometry(an_odometry(T0), T0) is not None
    assert session.odometry(an_odometry(T0 + MS), T0 + MS) is None
    sent = session.odometry(an_odometry(T0 + 2 * MS, reset_counter=1), T0 + 2 * MS)
    assert sent is not None


def test_odometry_never_goes_back_in_time() -> None:
    session = connected()
    assert session.odometry(an_odometry(T0), T0) is not None
    assert session.odometry(an_odometry(T0), T0 + 40 * MS) is None


def test_a_configured_ground_station_grants_and_revokes() -> None:
    session = connected()
    (granted,) = session.receive(command(param1=1.0), T0)
    (revoked,) = session.receive(command(param1=0.0), T0 + SECOND)
    assert [(a.t_ns, a.granted, a.source) for a in session.authorisations()] == [
        (T0, True, "ground_station"),
        (T0 + SECOND, False, "ground_station"),
    ]
    assert session.authorisations() == []
    assert granted.name == revoked.name == "COMMAND_ACK"
    assert (granted.fields["command"], granted.fields["result"]) == (31010, 0)
    assert (granted.fields["target_system"], granted.fields["target_component"]) == STATION
    assert (granted.system_id, granted.component_id) == (SYSTEM, 191)


@pytest.mark.parametrize("sender", [(255, 191), (254, 190), (42, 1), (SYSTEM, 1)])
def test_nobody_else_grants(sender: tuple[int, int]) -> None:
    session = connected()
    (reply,) = session.receive(command(sender=sender), T0)
    assert reply.fields["result"] == 2
    assert session.authorisations() == []
    assert session.statistics(T0).denied_authorisations == 1


@pytest.mark.parametrize("param1", [2.0, 0.5, -1.0, math.nan, None, "1"])
def test_a_grant_without_meaning_is_denied(param1: object) -> None:
    session = connected()
    (reply,) = session.receive(command(param1=param1), T0)
    assert reply.fields["result"] == 2
    assert session.authorisations() == []


@pytest.mark.parametrize("target", [(SYSTEM, 1), (SYSTEM, 0), (0, 0), (1, 191)])
def test_a_command_for_somebody_else_is_not_answered(target: tuple[int, int]) -> None:
    session = connected()
    assert session.receive(command(target=target), T0) == []
    assert session.authorisations() == []
    assert session.statistics(T0).wrong_target == 1


def test_a_repeated_grant_is_answered_but_is_no_second_grant() -> None:
    session = connected()
    session.receive(command(confirmation=0), T0)
    (reply,) = session.receive(command(confirmation=1), T0 + SECOND)
    assert reply.fields["result"] == 0
    assert len(session.authorisations()) == 1
    session.receive(command(confirmation=1), T0 + 7 * SECOND)
    assert len(session.authorisations()) == 1


def test_another_command_is_unsupported() -> None:
    (reply,) = connected().receive(command(512), T0)
    assert (reply.fields["command"], reply.fields["result"]) == (512, 3)


def test_an_autopilot_that_starts_anew_is_reported_and_forgotten() -> None:
    session = connected(autopilot_ns=500 * SECOND)
    session.receive(heartbeat(VehicleMode.OFFBOARD, armed=True), T0)
    session.request_mode(VehicleMode.HOLD, T0)
    changes = session.vehicle_state(T0).mode_changes
    for step in range(1, 4):
        t = T0 + step * 100 * MS
        session.receive(heartbeat(VehicleMode.OFFBOARD, armed=True), t)
        answer_clock(session, t, SECOND + step * 100 * MS)
    state = session.vehicle_state(T0 + 300 * MS)
    assert (state.connected, state.armed, state.mode) == (False, False, VehicleMode.UNKNOWN)
    assert state.mode_changes == changes + 1
    assert session.statistics(T0).reboots == 1
    assert session.mode_request.state is CommandState.WITHDRAWN
    assert "autopilot started anew" in [report.text for report in session.reports()]
    # Telemetry is asked for again.
    session.receive(heartbeat(), T0 + SECOND)
    assert len(commands(session.poll(T0 + SECOND, None), 511)) == 1


def test_texts_are_limited_in_rate_and_repetition() -> None:
    session = connected()
    sent = [session.status_text(StatusText(T0 + i, Severity.INFO, f"line {i}")) for i in range(20)]
    assert sum(map(len, sent)) == 8
    assert session.status_text(StatusText(T0 + 2 * SECOND, Severity.INFO, "line 0")) == []
    assert len(session.status_text(StatusText(T0 + 2 * SECOND, Severity.INFO, "other"))) == 1
    assert len(session.status_text(StatusText(T0 + 6 * SECOND, Severity.INFO, "line 0"))) == 1


def test_the_autopilots_texts_are_kept_bounded() -> None:
    session = connected()
    for index in range(100):
        session.receive(message("STATUSTEXT", severity=4, text=f"text {index}", id=0, chunk_seq=0), T0)
    texts = session.autopilot_texts()
    assert len(texts) == 32
    assert texts[-1].text == "text 99"


def test_heartbeats_that_come_too_fast_are_suspect() -> None:
    session = connected()
    assert not session.statistics(T0).suspect
    for step in range(1, 8):
        session.receive(heartbeat(), T0 + step * 100 * MS)
    assert session.statistics(T0 + 700 * MS).suspect
    assert not session.statistics(T0 + 3 * SECOND).suspect


def test_systems_heard_without_end_are_counted_within_bounds() -> None:
    session = Px4Session(settings())
    for system_id in range(1, 250):
        session.receive(heartbeat(system_id=system_id), T0)
    assert len(session.foreign_autopilots()) == 16
