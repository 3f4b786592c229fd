import hashlib
import math
import struct
import zlib

import numpy as np
import pytest

from companion.drivers import livox_packets as packets
from companion.drivers.livox_packets import ChecksumError, DataType, decode_points, parse_header
from companion.errors import ProtocolError
from companion.messages import ByteArray
from tests.drivers.livox_vectors import (
    CARTESIAN_16_PACKET,
    CARTESIAN_32_PACKET,
    FULL_PACKET_SHA256,
    IMU_PACKET,
    SPHERICAL_PACKET,
)

PUBLISHED = {
    "imu": bytes.fromhex(IMU_PACKET),
    "cartesian 32": bytes.fromhex(CARTESIAN_32_PACKET),
    "cartesian 16": bytes.fromhex(CARTESIAN_16_PACKET),
    "spherical": bytes.fromhex(SPHERICAL_PACKET),
}
ALL = pytest.mark.parametrize("payload", PUBLISHED.values(), ids=PUBLISHED.keys())
CHECKED_FROM = 28


def array(*payloads: bytes) -> ByteArray:
    return np.frombuffer(b"".join(payloads), dtype=np.uint8).reshape(len(payloads), -1)


def full_packet() -> bytes:
    """Build the published packet of 96 points from its description."""
    body = struct.pack("<Q", 123_456_789_012_345)
    for i in range(96):
        empty = i % 8 == 7
        values = (0, 0, 0, 0, 0) if empty else (1000 + 10 * i, -2000 + i, 3 * i, i, (0, 1, 4, 16)[i % 4])
        body += struct.pack("<iiiBB", *values)
    head = struct.pack("<BHHHHBBB12s", 0, 1380, 4750, 96, 4660, 0, 1, 0, bytes(12))
    return head + struct.pack("<I", zlib.crc32(body)) + body


def decode_one_by_one(payload: bytes, base_ns: int) -> list[tuple[float, float, float, int, int, int]]:
    """Decode a packet slowly, by the words of the protocol."""
    _, _, interval, slots, _, _, kind, _, _, _, stamp = struct.unpack_from("<BHHHHBBB12sIQ", payload)
    out = []
    for i in range(slots):
        t_ns = stamp + i * interval * 100 // max(slots - 1, 1) - base_ns
        if kind == DataType.SPHERICAL:
            depth, theta, phi, reflectivity, tag = struct.unpack_from("<IHHBB", payload, 36 + 10 * i)
            d, t, p = depth / 1000, math.radians(theta / 100), math.radians(phi / 100)
            xyz = (d * math.sin(t) * math.cos(p), d * math.sin(t) * math.sin(p), d * math.cos(t))
        elif kind == DataType.CARTESIAN_16:
            *raw, reflectivity, tag = struct.unpack_from("<hhhBB", payload, 36 + 8 * i)
            xyz = (raw[0] / 100, raw[1] / 100, raw[2] / 100)
        else:
            *raw, reflectivity, tag = struct.unpack_from("<iiiBB", payload, 36 + 14 * i)
            xyz = (raw[0] / 1000, raw[1] / 1000, raw[2] / 1000)
        out.append((*xyz, reflectivity, tag, t_ns))
    return out


def random_packet(rng: np.random.Generator, kind: DataType, slots: int, stamp_ns: int) -> bytes:
    size = packets.packet_size(kind, slots)
    body = struct.pack("<Q", stamp_ns) + rng.integers(0, 256, size - 36, dtype=np.uint8).tobytes()
    head = struct.pack("<BHHHHBBB12s", 0, size, (slots - 1) * 50, slots, 5, 0, kind, 0, bytes(12))
    return head + struct.pack("<I", zlib.crc32(body)) + body


def test_the_published_full_packet_is_reproduced_and_decoded() -> None:
    payload = full_packet()
    assert hashlib.sha256(payload).hexdigest() == FULL_PACKET_SHA256
    header = parse_header(payload)
    assert (header.slots, header.counter, header.span_ns) == (96, 4660, 475_000)
    decoded = decode_points(array(payload), header.t_sensor_ns)
    assert decoded.points_lidar[10] == pytest.approx([1.1, -1.99, 0.03])
    assert decoded.tags[:5].tolist() == [0, 1, 4, 16, 0]
    assert decoded.t_ns.tolist() == [5_000 * i for i in range(96)]
    assert np.flatnonzero(~decoded.points_lidar.any(axis=1)).tolist() == list(range(7, 96, 8))


def test_published_packets_have_the_published_meaning() -> None:
    assert packets.parse_inertial(PUBLISHED["imu"]) == pytest.approx((0.01, -0.02, 0.03, 0.0, 0.0, 9.80665))
    imu = parse_header(PUBLISHED["imu"])
    assert (imu.t_sensor_ns, imu.counter, imu.data_type) == (1_000_000_000, 7, DataType.IMU)
    header = parse_header(PUBLISHED["cartesian 32"])
    assert (header.t_sensor_ns, header.counter, header.time_type) == (1_700_000_000_123_456_789, 513, 1)
    fine = decode_points(array(PUBLISHED["cartesian 32"]), header.t_sensor_ns)
    np.testing.assert_allclose(fine.points_lidar, [[1.0, -2.0, 0.3], [0.0, 0.0, 0.0]], rtol=1e-6)
    assert (fine.reflectivity.tolist(), fine.tags.tolist(), fine.t_ns.tolist()) == (
        [150, 0],
        [16, 0],
        [0, 5_000],
    )
    coarse = decode_points(array(PUBLISHED["cartesian 16"]))
    np.testing.assert_allclose(coarse.points_lidar[0], [1.0, -2.0, 0.3], rtol=1e-6)
    spherical = decode_points(array(PUBLISHED["spherical"]))
    theta, phi = math.radians(82.37), math.radians(296.57)
    expected = [2.256 * math.sin(theta) * math.cos(phi), 2.256 * math.sin(theta) * math.sin(phi)]
    np.testing.assert_allclose(spherical.points_lidar[0], [*expected, 2.256 * math.cos(theta)], rtol=1e-6)


@pytest.mark.parametrize("kind", list(packets.POINT_DTYPES))
@pytest.mark.parametrize("slots", [1, 2, 95, 96])
def test_decoding_many_packets_at_once_equals_decoding_point_by_point(kind: DataType, slots: int) -> None:
    rng = np.random.default_rng(slots)
    stamps = [2**61, 2**61 - 480_000, 2**61 + 960_000]
    payloads = [random_packet(rng, kind, slots, stamp) for stamp in stamps]
    decoded = decode_points(array(*payloads), 2**61)
    slow = [row for payload in payloads for row in decode_one_by_one(payload, 2**61)]
    np.testing.assert_allclose(decoded.points_lidar, [row[:3] for row in slow], rtol=1e-6, atol=1e-5)
    assert decoded.reflectivity.tolist() == [row[3] for row in slow]
    assert decoded.tags.tolist() == [row[4] for row in slow]
    assert decoded.t_ns.tolist() == [row[5] for row in slow]


@ALL
def test_every_split_of_a_packet_is_refused(payload: bytes) -> None:
    for size in range(len(payload)):
        with pytest.raises(ProtocolError):
            parse_header(payload[:size])
    with pytest.raises(ProtocolError):
        parse_header(payload + b"\0")


@ALL
def test_every_bit_flip_under_the_checksum_is_refused(payload: bytes) -> None:
    for bit in range(8 * 24, 8 * len(payload)):
        flipped = bytearray(payload)
        flipped[bit // 8] ^= 1 << bit % 8
        with pytest.raises(ProtocolError):
            parse_header(bytes(flipped))


@ALL
def test_a_wrong_checksum_alone_is_told_apart_from_a_malformed_packet(payload: bytes) -> None:
    with pytest.raises(ChecksumError):
        parse_header(payload[:-1] + bytes([payload[-1] ^ 1]))
    with pytest.raises(ProtocolError) as refused:
        parse_header(b"\x01" + payload[1:])
    assert not isinstance(refused.value, ChecksumError)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_an_inertial_sample_that_is_not_finite_is_refused(value: float) -> None:
    payload = PUBLISHED["imu"][:36] + struct.pack("<6f", 0.0, 0.0, 0.0, 0.0, value, 0.0)
    with pytest.raises(ProtocolError, match="finite"):
        packets.parse_inertial(payload)


def test_packets_of_different_shapes_are_not_decoded_together() -> None:
    rng = np.random.default_rng(3)
    first = random_packet(rng, DataType.CARTESIAN_32, 4, 0)
    second = bytearray(first)
    second[10] = DataType.SPHERICAL
    with pytest.raises(ProtocolError, match="differ"):
        decode_points(array(first, bytes(second)))
    with pytest.raises(ProtocolError):
        decode_points(array(first)[:, :-1])
    with pytest.raises(ProtocolError):
        decode_points(array(PUBLISHED["imu"]))


def test_an_impossible_time_stamp_is_refused() -> None:
    body = struct.pack("<Q", 2**62) + PUBLISHED["imu"][36:]
    payload = PUBLISHED["imu"][:24] + struct.pack("<I", zlib.crc32(body)) + body
    with pytest.raises(ProtocolError, match="stamp"):
        parse_header(payload)
