"""The conversation with the autopilot: what is believed and how it is told."""

import math

import pytest

from companion.drivers.px4_commands import CommandState
from companion.drivers.px4_session import Px4Session
from companion.geometry import rotation
from companion.messages import (
    FlightState,
    LandedState,
    MavlinkMessage,
    VehicleMode,
)
from tests.drivers.px4_peer import (
    MS,
    SECOND,
    SYSTEM,
    T0,
    answer_clock,
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
