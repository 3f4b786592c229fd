"""MAVLink framing against pymavlink as the oracle, and against damage."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as dialect

from companion.drivers.mavlink_codec import MAX_FRAME_BYTES, MavlinkEncoder, MavlinkParser, message_id
from companion.messages import MavlinkMessage

NAN = math.nan
ODOMETRY: dict[str, object] = {
    "time_usec": 2**60 + 1,
    "frame_id": 20,
    "child_frame_id": 12,
    "x": 0.5,
    "y": -1.25,
    "z": 2.0,
    "q": [1.0, 0.0, 0.0, 0.0],
    "vx": 0.0,
    "vy": 0.0,
    "vz": 0.25,
    "rollspeed": 0.0,
    "pitchspeed": 0.0,
    "yawspeed": 0.0,
    "pose_covariance": [NAN] + [0.5] * 20,
    "velocity_covariance": [0.25] * 21,
    "reset_counter": 200,
    "estimator_type": 3,
    "quality": -1,
}
MESSAGES = [
    MavlinkMessage(
        "HEARTBEAT",
        1,
        1,
        {
            "type": 2,
            "autopilot": 12,
            "base_mode": 29,
            "custom_mode": 50593792,
            "system_status": 3,
            "mavlink_version": 3,
        },
    ),
    MavlinkMessage("ODOMETRY", 1, 191, ODOMETRY),
    MavlinkMessage("TIMESYNC", 1, 191, {"tc1": 0, "ts1": -(2**62)}),
    MavlinkMessage("STATUSTEXT", 7, 191, {"severity": 6, "text": "CMP: ready", "id": 0, "chunk_seq": 0}),
    MavlinkMessage(
        "PARAM_VALUE",
        1,
        1,
        {
            "param_id": "MIS_TAKEOFF_ALT1",
            "param_value": 1.0,
            "param_type": 9,
            "param_count": 899,
            "param_index": 564,
        },
    ),
    MavlinkMessage(
        "CURRENT_MODE", 1, 1, {"standard_mode": 1, "custom_mode": 6 << 16, "intended_custom_mode": 0}
    ),
]


def same(left: object, right: object) -> bool:
    if isinstance(left, float) and isinstance(right, float) and math.isnan(left):
        return math.isnan(right)
    if isinstance(left, list) and isinstance(right, list):
        return len(left) == len(right) and all(map(same, left, right))
    return left == right


def assert_same(found: MavlinkMessage, wanted: MavlinkMessage) -> None:
    assert (found.name, found.system_id, found.component_id) == (
        wanted.name,
        wanted.system_id,
        wanted.component_id,
    )
    assert found.fields.keys() >= wanted.fields.keys()
    for name, value in wanted.fields.items():
        assert same(found.fields[name], value), name


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: m.name)
def test_a_message_survives_the_wire(message: MavlinkMessage) -> None:
    (found,) = MavlinkParser().feed(MavlinkEncoder().encode(message))
    assert_same(found, message)


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: m.name)
def test_our_frame_is_byte_for_byte_pymavlinks(message: MavlinkMessage) -> None:
    kind = dialect.mavlink_map[message_id(message.name)]
    values = [
        value.encode() if isinstance(value, str) else value
        for value in (message.fields[name] for name in kind.fieldnames)
    ]
    sender = dialect.MAVLink(None, message.system_id, message.component_id)
    assert MavlinkEncoder().encode(message) == bytes(kind(*values).pack(sender))


def test_pymavlink_and_we_read_the_same_fields() -> None:
    encoder, oracle = MavlinkEncoder(), dialect.MAVLink(None)
    for message in MESSAGES:
        frame = encoder.encode(message)
        decoded = oracle.decode(bytearray(frame)).to_dict()
        (found,) = MavlinkParser().feed(frame)
        for name in dialect.mavlink_map[message_id(message.name)].fieldnames:
            assert same(found.fields[name], decoded[name]), (message.name, name)


def test_sequence_numbers_are_counted_per_sender_and_wrap() -> None:
    encoder = MavlinkEncoder()
    first, other = MESSAGES[0], MESSAGES[1]
    assert [encoder.encode(first)[4] for _ in range(257)] == [*range(256), 0]
    assert encoder.encode(other)[4] == 0


def test_gaps_in_the_sequence_are_counted_as_losses() -> None:
    encoder, parser = MavlinkEncoder(), MavlinkParser()
    frames = [encoder.encode(MESSAGES[0]) for _ in range(10)]
    for index in (0, 1, 4, 5, 9):
        parser.feed(frames[index])
    assert parser.statistics.lost == 5


@given(cuts=st.lists(st.integers(0, 2000), max_size=12), order=st.permutations(range(len(MESSAGES))))
@settings(max_examples=60, deadline=None)
def test_every_split_of_the_stream_gives_the_same_messages(cuts: list[int], order: list[int]) -> None:
    encoder, parser = MavlinkEncoder(), MavlinkParser()
    stream = b"".join(encoder.encode(MESSAGES[index]) for index in order)
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    found = [m for start, end in itertools.pairwise(edges) for m in parser.feed(stream[start:end])]
    assert [m.name for m in found] == [MESSAGES[index].name for index in order]
    assert parser.buffered_bytes == 0
    assert parser.statistics.skipped_bytes == 0


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: m.name)
def test_every_single_bit_flip_loses_at_most_the_frame_it_hit(message: MavlinkMessage) -> None:
    encoder = MavlinkEncoder()
    before, frame, after = (encoder.encode(m) for m in (MESSAGES[0], message, MESSAGES[2]))
    # A length made longer is only known to be wrong when that many bytes have arrived.
    tail = b"".join(encoder.encode(MESSAGES[0]) for _ in range(20))
    for bit in range(len(frame) * 8):
        damaged = bytearray(frame)
        damaged[bit // 8] ^= 1 << bit % 8
        parser = MavlinkParser()
        found = parser.feed(before + bytes(damaged) + after + tail)
        names = [m.name for m in found]
        assert names.count("HEARTBEAT") >= 21, bit
        assert "TIMESYNC" in names, bit
        assert (
            parser.statistics.bad_checksums + parser.statistics.unknown + parser.statistics.skipped_bytes > 0
        )


@given(data=st.binary(max_size=3000))
@settings(max_examples=150, deadline=None)
def test_noise_never_raises_and_never_fills_the_buffer(data: bytes) -> None:
    parser = MavlinkParser()
    parser.feed(data)
    assert parser.buffered_bytes < MAX_FRAME_BYTES + 13
    recovered = parser.feed(b"\0" * 300 + MavlinkEncoder().encode(MESSAGES[0]))
    assert recovered[-1].name == "HEARTBEAT"


def test_a_signed_frame_is_read_and_counted() -> None:
    sender = dialect.MAVLink(None, 1, 1)
    sender.signing.secret_key = b"k" * 32
    sender.signing.sign_outgoing = True
    frame = bytes(dialect.MAVLink_heartbeat_message(2, 12, 29, 50593792, 3, 3).pack(sender))
    parser = MavlinkParser()
    (found,) = parser.feed(frame)
    assert found.fields["custom_mode"] == 50593792
    assert parser.statistics.signed == 1
    assert parser.buffered_bytes == 0


def test_a_frame_that_demands_an_unknown_feature_is_refused() -> None:
    frame = bytearray(MavlinkEncoder().encode(MESSAGES[0]))
    frame[2] = 0x02
    parser = MavlinkParser()
    assert parser.feed(bytes(frame) + b"\0" * 300) == []
    assert parser.statistics.bad_flags == 1


def test_mavlink_1_is_read() -> None:
    sender = dialect.MAVLink(None, 1, 1)
    message = dialect.MAVLink_heartbeat_message(2, 12, 29, 50593792, 3, 3)
    (found,) = MavlinkParser().feed(bytes(message.pack(sender, force_mavlink1=True)))
    assert found.fields["base_mode"] == 29


def test_a_frame_outside_the_dialect_is_skipped_whole() -> None:
    stranger = bytes.fromhex("fd0300007b010123010060f1e4") + b"\xf0\xe6"
    parser = MavlinkParser()
    found = parser.feed(stranger + MavlinkEncoder().encode(MESSAGES[0]))
    assert [m.name for m in found] == ["HEARTBEAT"]
    assert parser.statistics.unknown == 1
    assert parser.statistics.skipped_bytes == 0


def test_text_that_is_not_utf8_is_read() -> None:
    sender = dialect.MAVLink(None, 1, 1)
    (found,) = MavlinkParser().feed(
        bytes(dialect.MAVLink_statustext_message(6, b"a\xffb\0c", 0, 0).pack(sender))
    )
    assert found.fields["text"] == "a\ufffdb"


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        (MavlinkMessage("NO_SUCH", 1, 1, {}), "not a message"),
        (MavlinkMessage("TIMESYNC", 1, 1, {"tc1": 0}), "needs the field 'ts1'"),
        (MavlinkMessage("TIMESYNC", 1, 1, {"tc1": 0, "ts1": 2**64}), "does not fit"),
        (MavlinkMessage("TIMESYNC", 1, 1, {"tc1": 0, "ts1": 0, "ts2": 0}), "no field 'ts2'"),
        (MavlinkMessage("ODOMETRY", 1, 1, {**ODOMETRY, "q": [1.0]}), "needs 4 values"),
        (MavlinkMessage("ODOMETRY", 1, 1, {**ODOMETRY, "x": "east"}), "does not fit"),
    ],
)
def test_a_message_that_cannot_be_encoded_is_a_broken_contract(
    message: MavlinkMessage, complaint: str
) -> None:
    with pytest.raises(ValueError, match=complaint):
        MavlinkEncoder().encode(message)


def test_an_extension_newer_than_the_dialect_is_written_and_read() -> None:
    fields: dict[str, object] = {"tc1": 1, "ts1": 2, "target_system": 1, "target_component": 191}
    frame = MavlinkEncoder().encode(MavlinkMessage("TIMESYNC", 1, 1, fields))
    assert frame[1] == 18
    (found,) = MavlinkParser().feed(frame)
    assert found.fields == fields


def test_extension_fields_may_be_left_out() -> None:
    fields = {name: ODOMETRY[name] for name in ODOMETRY if name not in ("reset_counter", "quality")}
    (found,) = MavlinkParser().feed(MavlinkEncoder().encode(MavlinkMessage("ODOMETRY", 1, 1, fields)))
    assert found.fields["reset_counter"] == 0
    assert np.isnan(found.fields["pose_covariance"][0])  # type: ignore[index]
