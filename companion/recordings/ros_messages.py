"""Bytes of the few ROS messages that carry a Mid-360's data, in both of ROS's serialisations, to arrays.

A scan of 20,000 points is decoded in one step instead of point by point. ROS 1 packs fields without gaps;
ROS 2 (CDR) aligns each to its own size, counted from behind the four bytes that announce the encoding.

Sources: http://wiki.ros.org/ROS/Technical%20Overview; OMG DDS-XTypes 1.3, section 7.4 (plain CDR, version
1); the message definitions of livox_ros_driver2 and sensor_msgs.
"""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.clock import NANOSECONDS_PER_SECOND
from companion.messages import ByteArray, FloatArray, PointArray

CUSTOM_DIGEST = "e4d6829bdfe657cb6c21a746c86b21a6"
"""How ROS 1 names the definition of CustomMsg that is decoded here; it never changed."""
POINTS_MAX = 1_000_000
TEXT_BYTES_MAX = 4096
FIELDS_MAX = 64
# Offsets count within a frame, and frames of drivers are at most a second long.
OFFSET_MAX_NS = NANOSECONDS_PER_SECOND
STAMPS_AGREE_NS = 10_000_000
INERTIAL_MAX = 1e6
"""Beyond any unit's reading of rates and accelerations."""
_TIME_MAX_S = 4e9
_FAR_POINT = "a point more than a second from its frame's begin"

_CDR_LITTLE = b"\x00\x01"
_POINT = [("offset_ns", "<u4"), ("xyz", "<f4", (3,)), ("reflectivity", "u1"), ("tag", "u1"), ("line", "u1")]
_POINT_ROS1 = np.dtype(_POINT)
_POINT_CDR = np.dtype([*_POINT, ("gap", "u1")])
_FIELD_TYPES = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}


@dataclass(frozen=True, slots=True, eq=False)
class RosPoints:
    """Points of one message, in its order.

    Attributes:
        t_ns: (n,) time of each point, on the clock of the message's header.
        points_lidar: (n, 3) metres, all zero where nothing returned.
        reflectivity: (n,).
        tags: (n,).
        disagreement_ns: time base minus header stamp where both exist.
    """

    t_ns: NDArray[np.int64]
    points_lidar: PointArray
    reflectivity: ByteArray
    tags: ByteArray
    disagreement_ns: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class RosInertial:
    """One inertial message: angular rate (rad/s) and acceleration in the unit of the file, (3,) each."""

    t_ns: int
    gyro_imu: FloatArray
    accel: FloatArray


class _Cursor:
    """Reads fields one after the other; raises ValueError where the message ends too early."""

    def __init__(self, data: bytes, *, cdr: bool) -> None:
        if cdr and data[:2] != _CDR_LITTLE:
            raise ValueError("an unknown encoding")
        self.data = data
        self._cdr = cdr
        self._base = 4 if cdr else 0
        self.position = self._base

    def take(self, size: int, alignment: int) -> int:
        """Return where a field of `size` bytes begins and move behind it."""
        if self._cdr:
            self.position += -(self.position - self._base) % alignment
        start = self.position
        self.position += size
        if self.position > len(self.data):
            raise ValueError("a message that ends too early")
        return start

    def u8(self) -> int:
        return self.data[self.take(1, 1)]

    def u32(self) -> int:
        return int.from_bytes(self.data[(start := self.take(4, 4)) : start + 4], "little")

    def u64(self) -> int:
        return int.from_bytes(self.data[(start := self.take(8, 8)) : start + 8], "little")

    def count(self, most: int) -> int:
        """Return the length of what follows, at most `most`."""
        length = self.u32()
        if length > most:
            raise ValueError("a message with an impossible length")
        return length

    def text(self) -> str:
        length = self.count(TEXT_BYTES_MAX)
        start = self.take(length, 1)
        return self.data[start : start + length].rstrip(b"\0").decode("ascii", "replace")

    def header_ns(self) -> int:
        """Return the stamp of a std_msgs/Header."""
        if not self._cdr:
            self.u32()
        seconds, nanoseconds = self.u32(), self.u32()
        self.text()
        return seconds * NANOSECONDS_PER_SECOND + nanoseconds


def decode_custom(data: bytes, *, cdr: bool) -> RosPoints:
    """Decode a CustomMsg of any Livox driver.

    Args:
        data: the serialised message.
        cdr: whether ROS 2 serialised it.

    Raises:
        ValueError: if the bytes are no such message.
    """
    cursor = _Cursor(data, cdr=cdr)
    header_ns = cursor.header_ns()
    base_ns = cursor.u64()
    cursor.u32()
    cursor.take(4, 1)
    n = cursor.count(POINTS_MAX)
    # The last point's gap is not sent; a byte more makes all points alike.
    layout = _POINT_CDR if cdr else _POINT_ROS1
    gap = int(cdr and n > 0)
    start = cursor.take(n * layout.itemsize - gap, 1)
    raw = np.frombuffer(data[start : cursor.position] + bytes(gap), dtype=layout)
    offsets_ns = raw["offset_ns"].astype(np.int64)
    if n and int(offsets_ns.max()) > OFFSET_MAX_NS:
        raise ValueError(_FAR_POINT)
    disagreement_ns = base_ns - header_ns
    # Inertial messages have the header's clock only, so where the two differ the header counts.
    if abs(disagreement_ns) > STAMPS_AGREE_NS:
        base_ns = header_ns
    return RosPoints(
        base_ns + offsets_ns,
        raw["xyz"].copy(),
        raw["reflectivity"].copy(),
        raw["tag"].copy(),
        disagreement_ns,
    )


def decode_cloud(data: bytes, *, cdr: bool) -> RosPoints:
    """Decode a sensor_msgs/PointCloud2 with a time for each point, as Livox drivers send it.

    `timestamp` may be in nanoseconds (as the driver sends it) or seconds (as its manual says);
    `offset_time` counts nanoseconds from the header's stamp.

    Args:
        data: the serialised message.
        cdr: whether ROS 2 serialised it.

    Raises:
        ValueError: if the bytes are no such message, or its points have no time.
    """
    cursor = _Cursor(data, cdr=cdr)
    header_ns = cursor.header_ns()
    n = cursor.u32() * cursor.u32()
    fields = dict(_field(cursor) for _ in range(cursor.count(FIELDS_MAX)))
    if cursor.u8():
        raise ValueError("a big-endian point cloud")
    step = cursor.u32()
    cursor.u32()
    size = cursor.u32()
    if n > POINTS_MAX or size != n * step or not all(0 < end <= step for _, _, end in fields.values()):
        raise ValueError("a point cloud whose sizes disagree")
    start = cursor.take(size, 1)
    missing = {"x", "y", "z"} - fields.keys()
    if missing or not fields.keys() & {"timestamp", "offset_time"}:
        raise ValueError(f"a point cloud without {'coordinates' if missing else 'a time for each point'}")
    layout = _layout(fields, step)
    raw = np.frombuffer(data[start : start + size], dtype=layout)
    with np.errstate(over="ignore", invalid="ignore"):
        points = np.stack([raw[axis].astype(np.float32) for axis in "xyz"], axis=-1)
        light = next((raw[name] for name in ("intensity", "reflectivity") if name in fields), np.zeros(n))
        reflectivity = np.nan_to_num(np.clip(light, 0, 255)).astype(np.uint8)
    tags = raw["tag"].astype(np.uint8) if "tag" in fields else np.zeros(n, np.uint8)
    if "timestamp" in fields:
        t_ns = _absolute_ns(raw["timestamp"].astype(np.float64), header_ns)
    else:
        offsets_ns = raw["offset_time"].astype(np.float64)
        t_ns = header_ns + _bounded_ns(offsets_ns).astype(np.int64)
    return RosPoints(t_ns, points, reflectivity, tags)


def decode_inertial(data: bytes, *, cdr: bool) -> RosInertial:
    """Decode a sensor_msgs/Imu; the attitude in it is left alone.

    Args:
        data: the serialised message.
        cdr: whether ROS 2 serialised it.

    Raises:
        ValueError: if the bytes are no such message or a value is impossible.
    """
    cursor = _Cursor(data, cdr=cdr)
    header_ns = cursor.header_ns()
    start = cursor.take(37 * 8, 8)
    values = np.array(struct.unpack_from("<37d", data, start))
    # Attitude and its covariance fill the first 13 numbers; each vector is followed by its own covariance.
    gyro, accel = values[13:16], values[25:28]
    if not float(np.abs([gyro, accel]).max()) <= INERTIAL_MAX:
        raise ValueError("an inertial message with impossible values")
    return RosInertial(header_ns, gyro.copy(), accel.copy())


def _field(cursor: _Cursor) -> tuple[str, tuple[str, int, int]]:
    """Return name, format, offset and end of one field of a point cloud."""
    name, offset, kind = cursor.text(), cursor.u32(), cursor.u8()
    cursor.u32()
    if kind not in _FIELD_TYPES:
        raise ValueError("a point cloud with a field of unknown type")
    return name, (_FIELD_TYPES[kind], offset, offset + np.dtype(_FIELD_TYPES[kind]).itemsize)


def _layout(fields: dict[str, tuple[str, int, int]], step: int) -> np.dtype[np.void]:
    """Return the layout of a point cloud's points.

    Raises:
        ValueError: if there is none with such fields.
    """
    try:
        return np.dtype(
            {
                "names": list(fields),
                "formats": [kind for kind, _, _ in fields.values()],
                "offsets": [offset for _, offset, _ in fields.values()],
                "itemsize": step,
            }
        )
    except TypeError:
        raise ValueError("a point cloud with impossible fields") from None


def _absolute_ns(stamps: FloatArray, header_ns: int) -> NDArray[np.int64]:
    """Return times in nanoseconds, of stamps in nanoseconds or seconds."""
    if not len(stamps):
        return np.zeros(0, np.int64)
    in_seconds = abs(float(stamps[0])) < _TIME_MAX_S and header_ns > _TIME_MAX_S
    unit_ns = float(NANOSECONDS_PER_SECOND) if in_seconds else 1.0
    # Small numbers stay exact where the stamps themselves would not.
    return header_ns + _bounded_ns((stamps - header_ns / unit_ns) * unit_ns).astype(np.int64)


def _bounded_ns(offsets_ns: FloatArray) -> FloatArray:
    if len(offsets_ns) and not float(np.abs(offsets_ns).max()) <= OFFSET_MAX_NS:
        raise ValueError(_FAR_POINT)
    return offsets_ns
