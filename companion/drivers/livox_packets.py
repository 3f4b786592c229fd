"""Data packets of the Livox Mid-360: points and inertial samples, bytes -> arrays.

No sockets, no state. One packet is checked with `parse_header`; many packets of one shape are decoded
together with `decode_points`. Everything is little-endian, lengths are millimetres on the wire.
"""

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.errors import ProtocolError
from companion.messages import ByteArray, PointArray

HEADER_SIZE = 36
MAX_SLOTS_PER_PACKET = 96
MAX_PACKET_SIZE = 1380
SLOT_PERIOD_NS = 5_000
PACKET_PERIOD_NS = SLOT_PERIOD_NS * MAX_SLOTS_PER_PACKET
IMU_PERIOD_NS = 5_000_000
TIME_INTERVAL_UNIT_NS = 100
STANDARD_GRAVITY_M_S2 = 9.80665
# 146 years: keeps every sum of stamps within 64 bits.
MAX_STAMP_NS = 1 << 62

_HEADER = struct.Struct("<BHHHHBBB12sIQ")
_INERTIAL = struct.Struct("<6f")
_CHECKED_FROM = 28


class DataType(IntEnum):
    """What a data packet carries."""

    IMU = 0
    CARTESIAN_32 = 1
    CARTESIAN_16 = 2
    SPHERICAL = 3


class TimeType(IntEnum):
    """Where the sensor's clock takes its time from."""

    NONE = 0
    PTP = 1
    GPS = 2


HEADER_DTYPE = np.dtype(
    [
        ("version", "u1"), ("length", "<u2"), ("time_interval", "<u2"), ("dot_num", "<u2"),
        ("udp_cnt", "<u2"), ("frame_cnt", "u1"), ("data_type", "u1"), ("time_type", "u1"),
        ("reserved", "V12"), ("crc32", "<u4"), ("timestamp", "<u8"),
    ]
)  # fmt: skip
POINT_DTYPES: dict[DataType, np.dtype[np.void]] = {
    DataType.CARTESIAN_32: np.dtype([("xyz", "<i4", (3,)), ("reflectivity", "u1"), ("tag", "u1")]),
    DataType.CARTESIAN_16: np.dtype([("xyz", "<i2", (3,)), ("reflectivity", "u1"), ("tag", "u1")]),
    DataType.SPHERICAL: np.dtype(
        [("depth", "<u4"), ("theta", "<u2"), ("phi", "<u2"), ("reflectivity", "u1"), ("tag", "u1")]
    ),
}
LENGTH_UNITS_M = {DataType.CARTESIAN_32: 0.001, DataType.CARTESIAN_16: 0.01, DataType.SPHERICAL: 0.001}
ANGLE_UNIT_RAD = np.pi / 18_000.0
_SIZES = {int(kind): dtype.itemsize for kind, dtype in POINT_DTYPES.items()}
INERTIAL_PACKET_SIZE = HEADER_SIZE + _INERTIAL.size


class PacketHeader(NamedTuple):
    """What the header of one data packet says.

    Attributes:
        t_sensor_ns: sensor time of the first slot.
        slots: number of point slots, 1 for an inertial sample.
        span_ns: time from the first to the last slot.
        counter: the stream's free-running packet counter, 16 bits.
    """

    t_sensor_ns: int
    slots: int
    span_ns: int
    counter: int
    data_type: int
    time_type: int
    length: int


@dataclass(frozen=True, slots=True, eq=False)
class DecodedPoints:
    """Slots of several packets, in the packets' order.

    Attributes:
        points_lidar: (n, 3) metres, all zero where nothing returned.
        reflectivity: (n,).
        tags: (n,).
        t_ns: (n,) time of each slot after the given base.
    """

    points_lidar: PointArray
    reflectivity: ByteArray
    tags: ByteArray
    t_ns: NDArray[np.integer]

    def chosen(self, indices: NDArray[np.intp] | slice) -> "DecodedPoints":
        """Return a copy of some of them."""
        return DecodedPoints(
            self.points_lidar[indices].copy(),
            self.reflectivity[indices].copy(),
            self.tags[indices].copy(),
            self.t_ns[indices].copy(),
        )


class ChecksumError(ProtocolError):
    """The packet's CRC-32 does not fit its content."""


def packet_size(data_type: int, slots: int) -> int:
    """Return the size in bytes of a packet of `slots` points."""
    return HEADER_SIZE + slots * _SIZES[data_type]


def parse_header(payload: bytes | memoryview) -> PacketHeader:
    """Check one data packet completely and return its header.

    Args:
        payload: exactly the bytes of one datagram.

    Raises:
        ChecksumError: if only the CRC-32 is wrong.
        ProtocolError: if sizes, type or stamp are impossible.
    """
    if len(payload) < HEADER_SIZE:
        raise ProtocolError(f"a data packet has at least {HEADER_SIZE} bytes, got {len(payload)}")
    version, length, interval, slots, counter, _, data_type, time_type, _, crc32, stamp = _HEADER.unpack_from(
        payload
    )
    if version != 0 or length != len(payload):
        raise ProtocolError(f"version {version}, length {length} in a datagram of {len(payload)} bytes")
    if data_type == DataType.IMU:
        expected = INERTIAL_PACKET_SIZE
        slots_allowed = slots == 1
    elif data_type in _SIZES:
        expected = HEADER_SIZE + slots * _SIZES[data_type]
        slots_allowed = 1 <= slots <= MAX_SLOTS_PER_PACKET
    else:
        raise ProtocolError(f"unknown data type {data_type}")
    if not slots_allowed or length != expected:
        raise ProtocolError(f"{slots} slots of type {data_type} do not fill {length} bytes")
    if stamp >= MAX_STAMP_NS:
        raise ProtocolError(f"impossible time stamp {stamp}")
    if zlib.crc32(payload[_CHECKED_FROM:]) != crc32:
        raise ChecksumError("wrong checksum")
    span_ns = interval * TIME_INTERVAL_UNIT_NS if slots > 1 else 0
    return PacketHeader(stamp, slots, span_ns, counter, data_type, time_type, length)


def parse_inertial(payload: bytes | memoryview) -> tuple[float, float, float, float, float, float]:
    """Return angular rate (rad/s) and specific force (m/s^2) of a checked inertial packet.

    Raises:
        ProtocolError: if the packet is too short or a value is not finite.
    """
    if len(payload) < INERTIAL_PACKET_SIZE:
        raise ProtocolError(f"an inertial packet has {INERTIAL_PACKET_SIZE} bytes, got {len(payload)}")
    values = _INERTIAL.unpack_from(payload, HEADER_SIZE)
    # A difference with itself is zero for finite numbers only.
    if sum(value - value for value in values) != 0.0:
        raise ProtocolError("an inertial sample is not finite")
    gx, gy, gz, ax, ay, az = values
    g = STANDARD_GRAVITY_M_S2
    return gx, gy, gz, ax * g, ay * g, az * g


def decode_points(packets: ByteArray, base_ns: int = 0) -> DecodedPoints:
    """Decode packets of one shape in one go.

    Args:
        packets: (n, size) bytes of checked packets that share data type and number of slots.
        base_ns: sensor time from which slot times count.

    Raises:
        ProtocolError: if the packets differ in shape or the shape is impossible.
    """
    headers = np.ascontiguousarray(packets[:, :HEADER_SIZE]).view(HEADER_DTYPE)[:, 0]
    data_type, slots = int(headers["data_type"][0]), int(headers["dot_num"][0])
    if data_type not in _SIZES or not 1 <= slots <= MAX_SLOTS_PER_PACKET:
        raise ProtocolError(f"{slots} slots of data type {data_type} cannot be decoded")
    if packets.shape[1] != packet_size(data_type, slots):
        raise ProtocolError(f"{slots} slots of type {data_type} do not fill {packets.shape[1]} bytes")
    if np.any(headers["data_type"] != data_type) or np.any(headers["dot_num"] != slots):
        raise ProtocolError("the packets differ in data type or number of slots")
    kind = DataType(data_type)
    points = np.ascontiguousarray(packets[:, HEADER_SIZE:]).view(POINT_DTYPES[kind])
    first_ns = (headers["timestamp"] - np.uint64(base_ns)).astype(np.int64)
    span_ns = headers["time_interval"].astype(np.int64) * TIME_INTERVAL_UNIT_NS
    steps = np.arange(slots, dtype=np.int64)
    t_ns = first_ns[:, None] + steps * span_ns[:, None] // max(slots - 1, 1)
    return DecodedPoints(
        _metres(points, kind).reshape(-1, 3),
        points["reflectivity"].ravel(),
        points["tag"].ravel(),
        t_ns.ravel(),
    )


def _metres(points: NDArray[np.void], kind: DataType) -> PointArray:
    """Return coordinates (..., 3) in metres of raw points of one format."""
    if kind is not DataType.SPHERICAL:
        scaled: PointArray = points["xyz"].astype(np.float32)
        scaled *= np.float32(LENGTH_UNITS_M[kind])
        return scaled
    depth = points["depth"] * LENGTH_UNITS_M[kind]
    theta = points["theta"] * ANGLE_UNIT_RAD
    phi = points["phi"] * ANGLE_UNIT_RAD
    across = depth * np.sin(theta)
    xyz = np.stack([across * np.cos(phi), across * np.sin(phi), depth * np.cos(theta)], axis=-1)
    return xyz.astype(np.float32)
