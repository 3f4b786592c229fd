import itertools
import math
import struct

import pytest
from pymavlink.dialects.v20 import development as dialect

from companion.messages import VehicleMode
from sitl.autopilot_parameters import Parameters
from sitl.mavlink_emulator import Peer
from sitl.mavlink_modes import base_mode, custom_mode, mode_of
from sitl.mavlink_timesync import CONVERGED_AFTER
from tests.sitl.autopilot_rig import Rig
from tests.sitl.mavlink_peer import PeerRig, as_integer, velocity_target

ARM, SET_MODE, LAND = 400, 176, 21
SET_INTERVAL, REQUEST = 511, 512


def airborne() -> PeerRig:
    peers = PeerRig()
    peers.rig.take_off()
    peers.run(0.1)
    return peers


def test_heartbeats_have_the_bits_measured_on_px4() -> None:
    peers = PeerRig()
    peers.run(1.5)
    beat = peers.last("HEARTBEAT")
    assert (beat.type, beat.autopilot, beat.base_mode, beat.custom_mode) == (2, 12, 0x1D, 0x3040000)
    assert beat.system_status == 0, "not ready to arm in Hold without GNSS"
    assert base_mode(VehicleMode.OFFBOARD, armed=True) == 0x91
    assert base_mode(VehicleMode.OFFBOARD, armed=False) == 0x11
    assert base_mode(VehicleMode.RETURN, armed=True) == 0x9D


@pytest.mark.parametrize("mode", [mode for mode in VehicleMode if mode is not VehicleMode.UNKNOWN])
def test_every_mode_survives_its_number(mode: VehicleMode) -> None:
    code = custom_mode(mode)
    assert mode_of(code >> 16 & 0xFF, code >> 24) is mode


def test_heartbeats_stay_at_one_hertz_through_mode_changes() -> None:
    peers = airborne()
    start_ns = peers.rig.t_ns
    for _ in range(5):
        peers.stream_velocity(0.3)
        assert peers.result(SET_MODE, 1, 6) == 0
        peers.stream_velocity(0.3)
        assert peers.result(LAND) == 0
        peers.run(0.4)
    times = [t for t, m in peers.received[Peer.COMPANION] if m.get_type() == "HEARTBEAT" and t > start_ns]
    assert {b - a for a, b in itertools.pairwise(times)} == {1_000_000_000}


def test_a_flight_by_commands_alone_takes_off_flies_offboard_and_lands() -> None:
    peers = PeerRig()
    peers.run(1.0)
    assert peers.result(ARM, 1) == 1, "Hold cannot arm without GNSS"
    assert peers.result(SET_MODE, 1, 4, 2) == 0
    assert peers.result(ARM, 1) == 0
    peers.run(9.0)
    assert peers.last("EXTENDED_SYS_STATE").landed_state == 2
    assert peers.last("HEARTBEAT").custom_mode == custom_mode(VehicleMode.TAKEOFF)
    assert peers.result(SET_MODE, 129, 6) == 1, "no setpoint yet"
    peers.stream_velocity(0.1)
    assert peers.result(SET_MODE, 129, 6) == 0
    peers.stream_velocity(3.0, vx=1.0)
    assert peers.rig.body.v[0] == pytest.approx(1.0, abs=0.1)
    assert peers.result(LAND) == 0
    peers.run(10.0)
    beat = peers.last("HEARTBEAT")
    assert not beat.base_mode & 0x80
    assert peers.last("EXTENDED_SYS_STATE").landed_state == 1


def test_a_lost_stream_shows_as_critical_land_within_a_heartbeat() -> None:
    peers = airborne()
    peers.stream_velocity(0.1)
    assert peers.result(SET_MODE, 1, 6) == 0
    peers.stream_velocity(1.5)
    assert peers.last("HEARTBEAT").base_mode == 0x91
    last_ns = peers.rig.t_ns
    peers.run(2.2)
    critical = [
        t for t, m in peers.received[Peer.COMPANION] if m.get_type() == "HEARTBEAT" and m.system_status == 5
    ]
    assert 1.05 <= (critical[0] - last_ns) * 1e-9 <= 2.1
    assert peers.last("HEARTBEAT").custom_mode == custom_mode(VehicleMode.LAND)


def test_an_acknowledgement_goes_to_the_sender_on_its_link() -> None:
    peers = PeerRig()
    peers.run(0.1)
    peers.command(ARM, 1, peer=Peer.GROUND)
    ack = peers.last("COMMAND_ACK", Peer.GROUND)
    assert (ack.target_system, ack.target_component, ack.result) == (255, 190, 1)
    assert not peers.of("COMMAND_ACK", Peer.COMPANION)


def test_commands_for_somebody_else_are_not_executed() -> None:
    peers = PeerRig()
    peers.run(1.0)
    peers.command(SET_MODE, 1, 4, 2, component=42)
    peers.send(dialect.MAVLink_command_long_message(9, 1, SET_MODE, 0, 1, 4, 2, 0, 0, 0, 0))
    assert peers.rig.mode() is VehicleMode.HOLD
    assert not peers.of("COMMAND_ACK")


def test_unknown_commands_are_unsupported_and_impossible_modes_rejected() -> None:
    peers = PeerRig()
    assert peers.result(31999) == 3
    assert peers.result(SET_MODE, 1, 9, 9) == 1
    assert peers.result(SET_MODE, 0, 4, 2) == 1
    assert peers.result(SET_MODE, math.nan, math.nan, math.inf) == 1
    assert peers.result(ARM, math.nan) == 3


def test_message_intervals_follow_the_measured_limits() -> None:
    peers = PeerRig()
    peers.run(0.1)
    assert peers.result(SET_INTERVAL, 0, 100_000) == 4, "HEARTBEAT stays at 1 Hz"
    assert peers.result(SET_INTERVAL, 436, 100_000) == 0
    assert peers.result(SET_INTERVAL, 245, 100_000) == 0
    assert peers.result(SET_INTERVAL, 230, 100_000) == 0
    assert peers.result(SET_INTERVAL, 30, -1) == 0
    assert peers.result(SET_INTERVAL, 99_999, 100_000) == 4
    assert peers.result(SET_INTERVAL, 31, math.nan) == 4
    start_ns = peers.rig.t_ns
    peers.run(5.0)
    rates = {
        name: len(peers.of(name, since_ns=start_ns + 1)) / 5.0
        for name in ("HEARTBEAT", "CURRENT_MODE", "EXTENDED_SYS_STATE", "ESTIMATOR_STATUS", "ATTITUDE")
    }
    assert rates == pytest.approx(
        {"HEARTBEAT": 1, "CURRENT_MODE": 2, "EXTENDED_SYS_STATE": 10, "ESTIMATOR_STATUS": 10, "ATTITUDE": 0},
        abs=0.21,
    )
    assert peers.result(510, 245) == 0
    assert peers.last("MESSAGE_INTERVAL").interval_us == 100_000


def test_messages_on_request_include_the_version_and_deny_a_home_that_is_not_known() -> None:
    peers = PeerRig()
    peers.run(0.1)
    assert peers.result(REQUEST, 148) == 0
    assert peers.last("AUTOPILOT_VERSION").capabilities == 59647
    assert peers.result(REQUEST, 242) == 2
    assert peers.result(REQUEST, math.nan) == 2
    assert not peers.of("HOME_POSITION")


def test_parameters_are_read_set_and_listed_with_integers_bytewise() -> None:
    peers = PeerRig()
    peers.send(dialect.MAVLink_param_request_read_message(1, 1, b"COM_OBL_RC_ACT", -1))
    value = peers.last("PARAM_VALUE")
    assert (value.param_id, value.param_type, as_integer(value.param_value)) == ("COM_OBL_RC_ACT", 6, 4)
    peers.send(dialect.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", 3.25, 9))
    assert peers.last("PARAM_VALUE").param_value == 3.25
    assert peers.rig.parameters["MIS_TAKEOFF_ALT"] == 3.25
    three = struct.unpack("<f", struct.pack("<i", 3))[0]
    peers.send(dialect.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", three, 6))
    assert peers.rig.parameters["COM_OBL_RC_ACT"] == 3
    peers.send(dialect.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", 2.0, 9))
    assert peers.rig.parameters["COM_OBL_RC_ACT"] == 3, "a value of the wrong type changes nothing"
    before = len(peers.of("PARAM_VALUE"))
    peers.send(dialect.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    peers.send(dialect.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9))
    assert len(peers.of("PARAM_VALUE")) == before
    peers.send(dialect.MAVLink_param_request_list_message(1, 1))
    peers.run(0.5)
    listed = peers.of("PARAM_VALUE")[before:]
    assert [v.param_index for v in listed] == list(range(len(Parameters())))


def test_a_ground_stations_command_reaches_the_companion_and_its_answer_returns() -> None:
    peers = PeerRig()
    peers.send(dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3))
    assert peers.last("HEARTBEAT", Peer.GROUND).get_srcComponent() == 191
    peers.send(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), Peer.GROUND)
    peers.command(31010, 1, peer=Peer.GROUND, component=191)
    forwarded = peers.last("COMMAND_LONG")
    assert (forwarded.command, forwarded.get_srcSystem(), forwarded.target_component) == (31010, 255, 191)
    assert not peers.of("COMMAND_ACK", Peer.GROUND)
    peers.send(dialect.MAVLink_command_ack_message(31010, 0, 0, 0, 255, 190))
    assert peers.last("COMMAND_ACK", Peer.GROUND).get_srcComponent() == 191
    peers.send(dialect.MAVLink_statustext_message(6, b"CMP: ready"))
    assert peers.last("STATUSTEXT", Peer.GROUND).text == "CMP: ready"


def test_forwarding_ends_with_its_parameter() -> None:
    peers = PeerRig(Rig({"MAV_FWDEXTSP": 0}))
    peers.send(dialect.MAVLink_statustext_message(6, b"CMP: ready"))
    assert not peers.of("STATUSTEXT", Peer.GROUND)


def test_setpoints_in_foreign_frames_are_no_proof_of_life() -> None:
    peers = airborne()
    message = velocity_target(0.0)
    message.coordinate_frame = 9
    peers.send(message)
    assert peers.emulator.counters.setpoints_refused == 1
    assert peers.result(SET_MODE, 1, 6) == 1


def test_status_bits_are_those_of_a_flight_without_gnss() -> None:
    peers = PeerRig()
    peers.rig.vision = False
    peers.run(0.5)
    status = peers.last("SYS_STATUS")
    assert status.onboard_control_sensors_present == 0x300C00F
    assert status.onboard_control_sensors_health == 0x320883F
    assert peers.last("ESTIMATOR_STATUS").flags == 229
    peers.rig.vision = True
    peers.run(2.0)
    assert peers.last("SYS_STATUS").onboard_control_sensors_health == 0x320C83F
    assert peers.last("ESTIMATOR_STATUS").flags == 495
    peers.rig.take_off()
    peers.run(1.1)
    assert peers.last("SYS_STATUS").onboard_control_sensors_health == 0x1320C83F
    assert peers.last("ESTIMATOR_STATUS").flags == 367
    peers.rig.vision = False
    peers.run(2.0)
    assert peers.last("ESTIMATOR_STATUS").flags == 111
    peers.run(4.5)
    assert peers.last("ESTIMATOR_STATUS").flags == 101


def test_gnss_adds_its_bits_and_messages() -> None:
    peers = PeerRig(Rig(gnss=True))
    peers.run(6.0)
    assert peers.last("SYS_STATUS").onboard_control_sensors_present == 0x300C02F
    assert peers.last("SYS_STATUS").onboard_control_sensors_health == 0x1320C83F
    assert peers.last("ESTIMATOR_STATUS").flags == 1023
    assert peers.last("HEARTBEAT").system_status == 3
    assert peers.of("GLOBAL_POSITION_INT")
    assert peers.result(REQUEST, 242) == 0


def test_positions_are_sent_z_down_in_the_frame_of_external_vision() -> None:
    peers = PeerRig(Rig(map_yaw=0.7))
    peers.rig.take_off_to_offboard((1.0, 0.5, 0.0))
    peers.rig.run(2.0)
    peers.run(0.2)
    position, odometry = peers.last("LOCAL_POSITION_NED"), peers.last("ODOMETRY")
    x, y, z = peers.rig.autopilot.estimator.p_local
    assert (position.x, position.y, position.z) == pytest.approx((x, -y, -z), abs=0.05)
    assert (position.vx, position.vy) == pytest.approx((1.0, -0.5), abs=0.1)
    assert (odometry.frame_id, odometry.estimator_type, odometry.quality) == (1, 8, 0)
    attitude = peers.last("ATTITUDE")
    assert attitude.yaw == pytest.approx(-(peers.rig.body.yaw - 0.7), abs=0.02)


def test_a_pilots_stick_takes_over_through_manual_control() -> None:
    peers = airborne()
    peers.stream_velocity(0.1)
    assert peers.result(SET_MODE, 1, 6) == 0
    for x in (0, 0, 600, 600):
        message = dialect.MAVLink_manual_control_message(1, x, 0, 500, 0, 0)
        peers.send(message, Peer.GROUND)
        peers.stream_velocity(0.05)
    assert peers.rig.mode() is VehicleMode.POSITION


def test_external_odometry_of_the_wrong_kind_is_counted_and_not_fused() -> None:
    peers = PeerRig()
    peers.rig.vision = False
    for kind in (7, 6, 3):
        for _ in range(10):
            peers.send(_odometry(peers, kind))
            peers.run(0.03)
        assert peers.rig.aided() is (kind == 3)
    assert peers.emulator.counters.odometry_dropped == 20


def test_a_zero_stamp_works_until_timesync_converges_and_then_stops_all_fusion() -> None:
    peers = PeerRig()
    peers.rig.vision = False
    sync = peers.emulator.links[Peer.COMPANION].timesync
    _live(peers, seconds=2.0, stamp_us=0)
    assert peers.rig.aided()
    assert sync.samples < CONVERGED_AFTER
    _live(peers, seconds=48.5, stamp_us=None)
    assert sync.converged
    assert peers.rig.aided()
    _live(peers, seconds=1.0, stamp_us=0)
    assert not peers.rig.aided()
    _live(peers, seconds=1.0, stamp_us=None)
    assert peers.rig.aided()


def test_the_autopilot_answers_time_requests_with_its_boot_clock() -> None:
    peers = PeerRig(clock_slow=0.007)
    peers.run(10.0)
    peers.send(dialect.MAVLink_timesync_message(0, 987_654_321))
    answer = [m for m in peers.of("TIMESYNC") if m.tc1 != 0][-1]
    assert answer.ts1 == 987_654_321
    assert answer.tc1 == pytest.approx(9.93e9, abs=1e4)


def test_refusals_are_told_to_the_ground_station_only() -> None:
    peers = PeerRig()
    peers.run(1.0)
    peers.result(ARM, 1)
    peers.run(0.1)
    assert peers.of("STATUSTEXT", Peer.GROUND)
    assert not peers.of("STATUSTEXT", Peer.COMPANION)


_UNIX_US = 1_700_000_000_000_000


def _live(peers: PeerRig, seconds: float, stamp_us: int | None) -> None:
    """Answer every time request at once and send external vision at 25 Hz, on a clock of one's own."""
    inbox = peers.received[Peer.COMPANION]
    for step in range(round(seconds / 0.005)):
        seen = len(inbox)
        peers.run(0.005)
        now_us = _UNIX_US + peers.rig.t_ns // 1000
        for _, message in inbox[seen:]:
            if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                peers.send(dialect.MAVLink_timesync_message(now_us * 1000, message.ts1))
        if step % 8 == 0:
            peers.send(_odometry(peers, 3, now_us if stamp_us is None else stamp_us))


def _odometry(peers: PeerRig, kind: int, stamp_us: int | None = None):  # type: ignore[no-untyped-def]
    stamp = peers.rig.t_ns // 1000 if stamp_us is None else stamp_us
    covariance = [4e-4] + [0.0] * 20
    zeros = (0.0,) * 3
    return dialect.MAVLink_odometry_message(
        stamp, 20, 12, *zeros, [1.0, 0.0, 0.0, 0.0], *zeros, *zeros, covariance, covariance, 0, kind, 100
    )
