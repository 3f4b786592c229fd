import numpy as np
import pytest
from pymavlink.dialects.v20 import development as dialect

from sitl.autopilot_parameters import Parameters
from sitl.mavlink_commands import parameter_value
from sitl.mavlink_emulator import Peer
from sitl.mavlink_frames import FrameCutter, FrameEncoder
from sitl.mavlink_streams import BUILDERS, Snapshot
from tests.sitl.autopilot_rig import Rig
from tests.sitl.mavlink_peer import PeerRig, velocity_target

_MUTATIONS = 30_000


def test_every_stream_packs_to_the_bytes_of_the_reference_library() -> None:
    rig = Rig(gnss=True)
    rig.run(5.0)
    reference = dialect.MAVLink(None, srcSystem=3, srcComponent=1)
    snapshot = Snapshot(rig.autopilot, 5_000_000, 1)
    for name, build in BUILDERS.items():
        values = build(snapshot)
        assert values is not None
        message = dialect.mavlink_map[getattr(dialect, f"MAVLINK_MSG_ID_{name}")](*values)
        reference.seq = 7
        assert FrameEncoder(name).frame(7, 3, 1, values) == message.pack(reference), name


def test_text_and_identifiers_pack_like_the_reference_too() -> None:
    reference = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    values = parameter_value(Parameters(), "MIS_TAKEOFF_ALT")
    expected = dialect.MAVLink_param_value_message(*values).pack(reference)
    assert FrameEncoder("PARAM_VALUE").frame(0, 1, 1, values) == expected


def test_an_unknown_message_has_no_encoder() -> None:
    with pytest.raises(KeyError):
        FrameEncoder("NO_SUCH_MESSAGE")


def test_frames_are_found_at_every_split_of_a_stream_with_noise_between() -> None:
    peers = PeerRig()
    frames = [peers.pack(velocity_target(float(index))) for index in range(3)]
    stream = b"\x00noise" + frames[0] + b"\xfd\x01" + frames[1] + frames[2]
    stream += peers.pack(velocity_target(9.0)) * 3
    for split in range(len(stream)):
        cutter = FrameCutter()
        found = [*cutter.feed(stream[:split]), *cutter.feed(stream[split:])]
        assert [frame.message.vx for frame in found[:3]] == [0.0, 1.0, 2.0]


def test_every_single_bit_flip_is_noticed() -> None:
    frame = PeerRig().pack(velocity_target(1.0))
    for bit in range(8 * len(frame)):
        broken = bytearray(frame)
        broken[bit // 8] ^= 1 << bit % 8
        assert not FrameCutter().feed(bytes(broken))


def test_an_endless_promise_of_length_keeps_the_buffer_bounded() -> None:
    cutter = FrameCutter()
    for _ in range(200):
        cutter.feed(b"\xfd\xff" + bytes(98))
    assert cutter.garbage_bytes > 15_000
    assert cutter.feed(PeerRig().pack(velocity_target(1.0)) * 8)


def test_mutated_frames_never_raise_and_never_stop_the_emulator() -> None:
    rng = np.random.default_rng(5)
    peers = PeerRig()
    peers.run(0.5)
    corpus = _corpus(peers)
    emulator = peers.emulator
    for index in range(_MUTATIONS):
        data = bytearray(corpus[int(rng.integers(len(corpus)))])
        kind = rng.integers(4)
        for _ in range(int(rng.integers(1, 4))):
            data[int(rng.integers(len(data)))] = int(rng.integers(256))
        if kind == 0:
            data = data[: int(rng.integers(1, len(data)))]
        elif kind == 1:
            _seal(data)
        elif kind == 2:
            data += bytes(rng.integers(0, 256, int(rng.integers(40)), dtype=np.uint8))
        emulator.receive(bytes(data), peers.rig.t_ns, Peer.COMPANION if index % 2 else Peer.GROUND)
        if index % 40 == 0:
            peers.run(0.005)
    link = emulator.links[Peer.COMPANION]
    assert link.cutter.bad_frames > 1000
    assert link.cutter.frames > 1000
    peers.run(1.5)
    assert peers.of("HEARTBEAT", since_ns=peers.rig.t_ns - 1_200_000_000)


def _seal(data: bytearray) -> None:
    """Give a mutated frame a right checksum, so that its content is what gets judged."""
    number = data[7] | data[8] << 8 | data[9] << 16
    message = dialect.mavlink_map.get(number)
    if message is None or len(data) != 12 + data[1]:
        return
    crc = dialect.x25crc(bytes(data[1:-2]) + bytes([message.crc_extra])).crc
    data[-2:] = bytes([crc & 0xFF, crc >> 8])


def _corpus(peers: PeerRig) -> list[bytes]:
    zeros = (0.0,) * 3
    huge = [3.0e38, -3.0e38, float("nan")]
    messages = [
        velocity_target(1.0),
        dialect.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0, *huge, *huge, *huge, 1e30, 1e30),
        dialect.MAVLink_odometry_message(
            1, 20, 12, *zeros, [1.0, 0.0, 0.0, 0.0], *zeros, *zeros, [1e38] * 21, [1e38] * 21, 0, 3, 100
        ),
        dialect.MAVLink_odometry_message(
            2**63, 20, 12, *huge, [1.0, 0.0, 0.0, 0.0], *huge, *huge, [-1.0] * 21, [0.0] * 21, 9, 2, -1
        ),
        dialect.MAVLink_vision_position_estimate_message(5, 1e5, 1e5, -1e5, 1.0, 1.0, 1.0, [0.0] * 21, 4),
        dialect.MAVLink_timesync_message(2**62, -(2**62)),
        dialect.MAVLink_timesync_message(0, 5),
        dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3),
        dialect.MAVLink_param_set_message(1, 1, b"EKF2_NOAID_TOUT", 1e30, 9),
        dialect.MAVLink_param_set_message(1, 1, b"MPC_TKO_RAMP_T", 1e-30, 9),
        dialect.MAVLink_param_request_read_message(1, 1, b"COM_OF_LOSS_T", -1),
        dialect.MAVLink_param_request_list_message(1, 1),
        dialect.MAVLink_manual_control_message(1, 1000, -1000, 500, 32767, 0),
        *(
            dialect.MAVLink_command_long_message(1, 1, number, 0, first, second, 3.0, 0, 0, 0, 0)
            for number in (16, 20, 21, 22, 176, 400, 510, 511, 512, 520)
            for first, second in ((1.0, 6.0), (1e38, -1e38), (float("nan"), float("inf")))
        ),
    ]
    return [peers.pack(message) for message in messages]


def test_every_stream_is_read_as_the_reference_library_reads_it() -> None:
    rig = Rig(gnss=True)
    rig.run(5.0)
    reference = dialect.MAVLink(None)
    for name, build in BUILDERS.items():
        values = build(Snapshot(rig.autopilot, 5_000_000, 1))
        assert values is not None
        raw = FrameEncoder(name).frame(7, 3, 1, values)
        (frame,) = FrameCutter().feed(raw)
        expected = reference.decode(bytearray(raw))
        assert frame.message.get_type() == name
        for field in expected.fieldnames:
            assert str(getattr(frame.message, field)) == str(getattr(expected, field)), (name, field)


def test_texts_are_read_as_the_reference_library_reads_them() -> None:
    reference = dialect.MAVLink(None)
    for name, values in (
        ("STATUSTEXT", (4, b"Gr\xfcezi\x00behind the end", 0, 0)),
        ("PARAM_VALUE", parameter_value(Parameters(), "MIS_TAKEOFF_ALT")),
    ):
        raw = FrameEncoder(name).frame(0, 1, 1, values)
        (frame,) = FrameCutter().feed(raw)
        expected = reference.decode(bytearray(raw))
        for field in expected.fieldnames:
            assert getattr(frame.message, field) == getattr(expected, field), (name, field)
