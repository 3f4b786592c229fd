import json

import jsonschema  # type: ignore[import-untyped]
import numpy as np
import pytest
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.logs import channels, datagram_codec
from companion.logs.channels import BY_TOPIC, CHANNELS, Channel, Encoding
from companion.logs.codec import codec_of
from companion.messages import Datagram, MavlinkMessage
from tests.logs.same import same
from tests.logs.samples import one_of_each

SAMPLES = one_of_each()
JSON_CHANNELS = [channel for channel in CHANNELS if channel.encoding is Encoding.JSON]


def topic(channel: Channel) -> str:
    return channel.topic


def test_every_channel_has_a_sample_and_a_topic_of_its_own() -> None:
    assert set(SAMPLES) == set(CHANNELS)
    assert len(BY_TOPIC) == len(CHANNELS)


@pytest.mark.parametrize("channel", CHANNELS, ids=topic)
def test_a_message_comes_back_bit_for_bit(channel: Channel) -> None:
    codec = codec_of(channel)
    message = SAMPLES[channel]
    assert isinstance(message, channel.message_type)
    assert same(codec.decode(codec.encode(message)), message)


@pytest.mark.parametrize("channel", CHANNELS, ids=topic)
def test_the_same_message_gives_the_same_bytes(channel: Channel) -> None:
    encode = codec_of(channel).encode
    assert encode(SAMPLES[channel]) == encode(one_of_each()[channel])


@pytest.mark.parametrize("channel", JSON_CHANNELS, ids=topic)
def test_json_messages_fulfil_their_schema_and_are_strict_json(channel: Channel) -> None:
    codec = codec_of(channel)

    def refuse(token: str) -> object:
        raise AssertionError(f"{token} is no JSON")

    document = json.loads(codec.encode(SAMPLES[channel]), parse_constant=refuse)
    schema = json.loads(codec.schema)
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(document, schema)


@pytest.mark.parametrize("channel", CHANNELS, ids=topic)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_broken_bytes_are_refused_with_a_value_error(channel: Channel, data: st.DataObject) -> None:
    codec = codec_of(channel)
    good = bytearray(codec.encode(SAMPLES[channel]))
    position = data.draw(st.integers(0, max(0, len(good) - 1)))
    cut = data.draw(st.booleans())
    if cut:
        del good[position:]
    else:
        good[position] ^= data.draw(st.integers(1, 255))
    try:
        decoded = codec.decode(bytes(good))
    except ValueError:
        return
    assert isinstance(decoded, channel.message_type)


def test_other_software_reads_the_pose_and_the_cloud() -> None:
    pose = PoseInFrame.FromString(codec_of(channels.POSE).encode(SAMPLES[channels.POSE]))
    assert pose.frame_id == "map"
    assert pose.timestamp.seconds * 10**9 + pose.timestamp.nanos == 123_456_789_012
    assert (pose.pose.orientation.w, pose.pose.orientation.x, pose.pose.orientation.z) == (0.0, 0.6, 0.8)
    sample = SAMPLES[channels.CLOUD]
    cloud = PointCloud.FromString(codec_of(channels.CLOUD).encode(sample))
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "reflectivity"]
    assert cloud.point_stride == 13
    first = np.frombuffer(cloud.data, dtype="<f4", count=3)
    assert np.array_equal(first, sample.points_map[0])  # type: ignore[attr-defined]


def test_not_a_number_becomes_null_and_text_about_it_stays_text() -> None:
    message = MavlinkMessage("X", 1, 1, {"a": float("nan"), "b": "NaN", "c": float("-inf")})
    encoded = codec_of(channels.MAVLINK_RX).encode(message)
    assert b'"a":null,"b":"NaN","c":-1e999' in encoded


def test_numpy_scalars_are_numbers_and_bytes_are_refused() -> None:
    codec = codec_of(channels.MAVLINK_RX)
    message = MavlinkMessage("X", 1, 1, {"a": np.float32(0.5), "b": np.int16(-3)})
    assert codec.decode(codec.encode(message)) == MavlinkMessage("X", 1, 1, {"a": 0.5, "b": -3})
    with pytest.raises(TypeError, match="bytes has no place"):
        codec.encode(MavlinkMessage("X", 1, 1, {"a": b"raw"}))


addresses = st.tuples(st.ip_addresses(v=4).map(str), st.integers(0, 65535))
datagrams = st.builds(
    Datagram, st.integers(-(2**63), 2**63 - 1), addresses, addresses, st.binary(max_size=1500)
)


@settings(max_examples=50, deadline=None)
@given(st.lists(datagrams, max_size=8).map(tuple))
def test_any_datagrams_survive_a_batch(batch: tuple[Datagram, ...]) -> None:
    assert datagram_codec.decode(datagram_codec.encode(batch)) == batch


@pytest.mark.parametrize(
    "bad",
    [
        Datagram(0, ("::1", 1), ("127.0.0.1", 1), b""),
        Datagram(0, ("127.0.0.1", 65536), ("127.0.0.1", 1), b""),
        Datagram(0, ("127.0.0.1", 1), ("127.0.0.1", 1), bytes(65536)),
    ],
)
def test_what_is_not_udp_over_ipv4_is_refused(bad: Datagram) -> None:
    with pytest.raises(ValueError, match="not a UDP datagram"):
        datagram_codec.encode((bad,))
