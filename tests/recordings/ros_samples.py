"""ROS messages built and serialised by the library for bags itself, independent of our own code."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

POINT_DEFINITION = """
uint32 offset_time      # offset time relative to the base time
float32 x               # X axis, unit:m
float32 y               # Y axis, unit:m
float32 z               # Z axis, unit:m
uint8 reflectivity      # reflectivity, 0~255
uint8 tag               # livox tag
uint8 line              # laser number in lidar
"""
CUSTOM_DEFINITION = """
std_msgs/Header header    # ROS standard message header
uint64 timebase           # The time of first point
uint32 point_num          # Total number of pointclouds
uint8  lidar_id           # Lidar device id number
uint8[3]  rsvd            # Reserved use
CustomPoint[] points      # Pointcloud data
"""
CUSTOM_DIGEST = "e4d6829bdfe657cb6c21a746c86b21a6"
START_NS = 1_700_000_000_300_000_000
INERTIAL = "sensor_msgs/msg/Imu"
CLOUD = "sensor_msgs/msg/PointCloud2"


class Messages:
    """Makes messages of one generation of ROS, with the drivers' definitions of their own types."""

    def __init__(self, *, ros1: bool, package: str = "livox_ros_driver2") -> None:
        self.ros1 = ros1
        self.custom_type = f"{package}/msg/CustomMsg"
        self.store: Any = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        self.store.register(get_types_from_msg(POINT_DEFINITION, f"{package}/msg/CustomPoint"))
        self.store.register(get_types_from_msg(CUSTOM_DEFINITION, self.custom_type))

    def make(self, name: str, *values: object) -> Any:
        return self.store.types[name](*values)

    def header(self, t_ns: int) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", *divmod(t_ns, 10**9))
        number = (7,) if self.ros1 else ()
        return self.make("std_msgs/msg/Header", *number, stamp, "livox_frame")

    def custom(self, t_ns: int, points: Sequence[tuple[float, ...]], base_ns: int | None = None) -> Any:
        """Return a frame of points (offset in ns, x, y, z, reflectivity, tag, line)."""
        point_type = self.custom_type.replace("Msg", "Point")
        made = [self.make(point_type, *point) for point in points]
        base_ns = t_ns if base_ns is None else base_ns
        reserved = np.zeros(3, np.uint8)
        return self.make(self.custom_type, self.header(t_ns), base_ns, len(made), 192, reserved, made)

    def inertial(self, t_ns: int, gyro: tuple[float, ...], accel: tuple[float, ...]) -> Any:
        vector = "geometry_msgs/msg/Vector3"
        attitude = self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        unknown = np.zeros(9)
        return self.make(
            INERTIAL, self.header(t_ns), attitude, unknown,
            self.make(vector, *gyro), unknown, self.make(vector, *accel), unknown,
        )  # fmt: skip

    def cloud(self, t_ns: int, points: "np.ndarray[Any, Any]", fields: list[tuple[str, int, int]]) -> Any:
        """Return a cloud of structured `points` with fields (name, offset, type)."""
        described = [self.make("sensor_msgs/msg/PointField", *field, 1) for field in fields]
        step, n = points.dtype.itemsize, len(points)
        data = np.frombuffer(points.tobytes(), np.uint8)
        return self.make(
            CLOUD, self.header(t_ns), 1, n, described, False, step, step * n, data, True
        )  # fmt: skip

    def serialised(self, message: Any) -> bytes:
        name = message.__msgtype__
        store = self.store
        return bytes(store.serialize_ros1(message, name) if self.ros1 else store.serialize_cdr(message, name))

    def write(self, path: Path, *records: tuple[str, int, Any]) -> Path:
        """Write (topic, time of recording, message) to a bag."""
        bag: Any = Writer1(path) if self.ros1 else Writer2(path, version=9)
        connections: dict[tuple[str, str], Any] = {}
        with bag:
            for topic, t_ns, message in records:
                key = topic, message.__msgtype__
                if key not in connections:
                    connections[key] = bag.add_connection(*key, typestore=self.store)
                bag.write(connections[key], t_ns, self.serialised(message))
        return path
