"""Datagrams as a ROS bag, as the vendor's driver (livox_ros_driver2) publishes them.

Its habits are kept: frames of 100 ms, slots without return included, accelerations in g, points a
little too close to each other in time (the span of a packet divided by its number of points), and in
ROS 1 stamps that went through seconds as floating point numbers.
"""

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND
from companion.drivers.livox_packets import (
    STANDARD_GRAVITY_M_S2,
    PacketHeader,
    decode_points,
    parse_header,
    parse_inertial,
)
from companion.drivers.livox_settings import LidarPorts
from companion.errors import LogError
from companion.messages import Datagram

POINTS_TOPIC = "/livox/lidar"
IMU_TOPIC = "/livox/imu"
FRAME_ID = "livox_frame"
CUSTOM = "livox_ros_driver2/msg/CustomMsg"
INERTIAL = "sensor_msgs/msg/Imu"
FRAME_NS = 100_000_000
LINES = 4

CUSTOM_POINT_DEFINITION = """\
uint32 offset_time
float32 x
float32 y
float32 z
uint8 reflectivity
uint8 tag
uint8 line
"""
CUSTOM_DEFINITION = """\
std_msgs/Header header
uint64 timebase
uint32 point_num
uint8 lidar_id
uint8[3] rsvd
CustomPoint[] points
"""

BagFormat = Literal["rosbag1", "rosbag2", "rosbag2-mcap"]
Stamps = Literal["sensor", "host"]

_POINT = [("offset", "<u4"), ("xyz", "<f4", (3,)), ("reflectivity", "u1"), ("tag", "u1"), ("line", "u1")]
_POINT_ROS1 = np.dtype(_POINT)
_POINT_CDR = np.dtype([*_POINT, ("gap", "u1")])
_CDR_LITTLE = b"\x00\x01\x00\x00"


def write_bag(
    path: Path,
    datagrams: Iterable[Datagram],
    lidar_ip: str,
    bag_format: BagFormat,
    stamps: Stamps = "sensor",
) -> None:
    """Write the points and inertial samples of one sensor; nothing may exist at `path`.

    Args:
        path: a file for ROS 1, a folder for ROS 2.
        datagrams: in the order of reception.
        lidar_ip: address of the sensor.
        bag_format: ROS 1, or ROS 2 stored in SQLite or MCAP.
        stamps: the sensor's own, as the driver does it when the sensor's clock is synchronised, or the
            time of reception of each packet, as it does otherwise.

    Raises:
        LogError: if the library for bags is missing or something exists at `path`.
    """
    try:
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise LogError(
            "writing ROS bags needs the package rosbags: pip install 'companion[recordings]'"
        ) from error
    if path.exists():
        raise LogError(f"{path}: exists already")
    cdr = bag_format != "rosbag1"
    types = get_typestore(Stores.ROS2_HUMBLE if cdr else Stores.ROS1_NOETIC)
    types.register(get_types_from_msg(CUSTOM_POINT_DEFINITION, CUSTOM.replace("Msg", "Point")))
    types.register(get_types_from_msg(CUSTOM_DEFINITION, CUSTOM))
    bag: Any
    if cdr:
        plugin = StoragePlugin.MCAP if bag_format == "rosbag2-mcap" else StoragePlugin.SQLITE3
        bag = Writer2(path, version=9, storage_plugin=plugin)
    else:
        bag = Writer1(path)
    driver = _Driver(lidar_ip, stamps, cdr=cdr)
    with bag:
        connections = {
            POINTS_TOPIC: bag.add_connection(POINTS_TOPIC, CUSTOM, typestore=types),
            IMU_TOPIC: bag.add_connection(IMU_TOPIC, INERTIAL, typestore=types),
        }
        for datagram in datagrams:
            for topic, data in driver.take(datagram):
                bag.write(connections[topic], datagram.t_ns, data)


class _Driver:
    """The vendor's driver between the sensor and the bag."""

    def __init__(self, lidar_ip: str, stamps: Stamps, *, cdr: bool) -> None:
        ports = LidarPorts()
        self._points_source = (lidar_ip, ports.points)
        self._imu_source = (lidar_ip, ports.imu)
        self._by_host = stamps == "host"
        self._cdr = cdr
        self._sequence = 0
        self._packets: list[tuple[int, PacketHeader, bytes]] = []

    def take(self, datagram: Datagram) -> list[tuple[str, bytes]]:
        """Return topic and content of what is published after a datagram."""
        if datagram.source not in (self._points_source, self._imu_source):
            return []
        header = parse_header(datagram.payload)
        t_ns = datagram.t_ns if self._by_host else header.t_sensor_ns
        if datagram.source == self._imu_source:
            return [(IMU_TOPIC, self._inertial(t_ns, datagram.payload))]
        published = []
        if self._packets and t_ns // FRAME_NS != self._packets[0][0] // FRAME_NS:
            published.append((POINTS_TOPIC, self._frame()))
            self._packets = []
        self._packets.append((t_ns, header, datagram.payload))
        return published

    def _inertial(self, t_ns: int, payload: bytes) -> bytes:
        gx, gy, gz, ax, ay, az = parse_inertial(payload)
        attitude = [0.0, 0.0, 0.0, 1.0 if self._cdr else 0.0]
        accel_g = [value / STANDARD_GRAVITY_M_S2 for value in (ax, ay, az)]
        unknown = [0.0] * 9
        values = [*attitude, *unknown, gx, gy, gz, *unknown, *accel_g, *unknown]
        return self._header(t_ns) + struct.pack("<37d", *values)

    def _frame(self) -> bytes:
        base_ns = self._packets[0][0]
        total = sum(header.slots for _, header, _ in self._packets)
        points = np.zeros(total, dtype=_POINT_CDR if self._cdr else _POINT_ROS1)
        at = 0
        for t_ns, header, payload in self._packets:
            part = points[at : at + header.slots]
            decoded = decode_points(np.frombuffer(payload, np.uint8)[None, :])
            steps = np.arange(header.slots)
            part["offset"] = t_ns - base_ns + steps * (header.span_ns // header.slots)
            part["xyz"] = decoded.points_lidar
            part["reflectivity"], part["tag"] = decoded.reflectivity, decoded.tags
            part["line"] = steps % LINES
            at += header.slots
        lidar_id = int(self._points_source[0].split(".")[0])
        head = struct.pack("<QIB3xI", base_ns, total, lidar_id, total)
        content = points.tobytes()
        return self._header(base_ns) + head + (content[:-1] if self._cdr else content)

    def _header(self, t_ns: int) -> bytes:
        """Return a message's header, padded to where a number of eight bytes may follow."""
        name = FRAME_ID.encode("ascii")
        if self._cdr:
            head = struct.pack("<III", *divmod(t_ns, NANOSECONDS_PER_SECOND), len(name) + 1) + name + b"\0"
            return _CDR_LITTLE + head + bytes(-len(head) % 8)
        self._sequence += 1
        stamp_ns = round(t_ns / NANOSECONDS_PER_SECOND * NANOSECONDS_PER_SECOND)
        seconds, nanoseconds = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
        return struct.pack("<IIII", self._sequence, seconds, nanoseconds, len(name)) + name
