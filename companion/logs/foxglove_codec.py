"""Messages in Foxglove's well-known schemas (Protocol Buffers), so that any viewer shows them."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from foxglove import messages as foxglove
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from companion.clock import NANOSECONDS_PER_SECOND
from companion.logs.records import CloudView, PathView, StampedPose
from companion.messages import FloatArray, Severity, StatusText

_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("reflectivity", "u1")])
_LEVELS = {
    Severity.CRITICAL: foxglove.LogLevel.Fatal,
    Severity.ERROR: foxglove.LogLevel.Error,
    Severity.WARNING: foxglove.LogLevel.Warning,
    Severity.NOTICE: foxglove.LogLevel.Info,
    Severity.INFO: foxglove.LogLevel.Info,
}
_IDENTITY = foxglove.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)


def _timestamp(t_ns: int) -> Any:
    seconds, nanoseconds = divmod(t_ns, NANOSECONDS_PER_SECOND)
    return foxglove.Timestamp(sec=seconds, nsec=nanoseconds)


def _pose(p: FloatArray, q: FloatArray) -> Any:
    return foxglove.Pose(
        position=foxglove.Vector3(x=float(p[0]), y=float(p[1]), z=float(p[2])),
        orientation=foxglove.Quaternion(w=float(q[0]), x=float(q[1]), y=float(q[2]), z=float(q[3])),
    )


def _encode_pose(message: StampedPose) -> Any:
    return foxglove.PoseInFrame(
        timestamp=_timestamp(message.t_ns), frame_id=message.frame, pose=_pose(message.p, message.q)
    )


def _encode_path(message: PathView) -> Any:
    poses = [
        foxglove.Pose(position=foxglove.Vector3(x=x, y=y, z=z), orientation=_IDENTITY)
        for x, y, z in message.points_map.tolist()
    ]
    return foxglove.PosesInFrame(timestamp=_timestamp(message.t_ns), frame_id="map", poses=poses)


def _encode_cloud(message: CloudView) -> Any:
    points = np.empty(len(message.points_map), dtype=_POINT)
    points["x"], points["y"], points["z"] = message.points_map.T
    points["reflectivity"] = message.reflectivity
    number = foxglove.PackedElementFieldNumericType
    fields = [
        foxglove.PackedElementField(name=axis, offset=4 * index, type=number.Float32)
        for index, axis in enumerate("xyz")
    ]
    fields.append(foxglove.PackedElementField(name="reflectivity", offset=12, type=number.Uint8))
    return foxglove.PointCloud(
        timestamp=_timestamp(message.t_ns),
        frame_id="map",
        pose=foxglove.Pose(position=foxglove.Vector3(x=0.0, y=0.0, z=0.0), orientation=_IDENTITY),
        point_stride=_POINT.itemsize,
        fields=fields,
        data=points.tobytes(),
    )


def _encode_log(message: StatusText) -> Any:
    # Foxglove has one level for notices and infos: the name keeps MAVLink's severity.
    return foxglove.Log(
        timestamp=_timestamp(message.t_ns),
        level=_LEVELS[message.severity],
        message=message.text,
        name=message.severity.name.lower(),
        file="",
        line=0,
    )


def _t_ns(timestamp: Any) -> int:
    return int(timestamp.seconds) * NANOSECONDS_PER_SECOND + int(timestamp.nanos)


def _decode_pose(raw: Any) -> StampedPose:
    position, orientation = raw.pose.position, raw.pose.orientation
    return StampedPose(
        _t_ns(raw.timestamp),
        raw.frame_id,
        np.array([position.x, position.y, position.z]),
        np.array([orientation.w, orientation.x, orientation.y, orientation.z]),
    )


def _decode_path(raw: Any) -> PathView:
    points = [[pose.position.x, pose.position.y, pose.position.z] for pose in raw.poses]
    return PathView(_t_ns(raw.timestamp), np.array(points, dtype=np.float64).reshape(-1, 3))


def _decode_cloud(raw: Any) -> CloudView:
    if raw.point_stride != _POINT.itemsize:
        raise ValueError(f"points of {raw.point_stride} bytes, expected {_POINT.itemsize}")
    points = np.frombuffer(raw.data, dtype=_POINT)
    positions = np.stack([points["x"], points["y"], points["z"]], axis=-1)
    return CloudView(_t_ns(raw.timestamp), positions, points["reflectivity"].copy())


def _decode_log(raw: Any) -> StatusText:
    try:
        severity = Severity[raw.name.upper()]
    except KeyError as error:
        raise ValueError(f"unknown severity {raw.name!r}") from error
    return StatusText(_t_ns(raw.timestamp), severity, raw.message)


class FoxgloveCodec:
    """Turns messages into one of Foxglove's well-known schemas and back."""

    def __init__(self, schema: str) -> None:
        """Prepare for the schema of this name.

        Raises:
            KeyError: if the schema is not one of those used here.
        """
        self._schema_type, self._to, self._back = _CODECS[schema]
        self._schema = schema

    def schema(self) -> bytes:
        """Return the serialised ``FileDescriptorSet``."""
        return bytes(self._schema_type.get_schema().data)

    @cached_property
    def _message_class(self) -> Callable[[], Any]:
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(self.schema()).file:
            pool.Add(file)
        message_class: Callable[[], Any] = message_factory.GetMessageClass(
            pool.FindMessageTypeByName(self._schema)
        )
        return message_class

    def encode(self, message: object) -> bytes:
        """Return the message's bytes."""
        return bytes(self._to(message).encode())

    def decode(self, data: bytes) -> object:
        """Return the message.

        Raises:
            ValueError: if the bytes are not such a message.
        """
        raw = self._message_class()
        try:
            raw.ParseFromString(data)
        except DecodeError as error:
            raise ValueError(f"not a {self._schema}: {error}") from error
        return self._back(raw)


_CODECS: dict[str, tuple[Any, Callable[[Any], Any], Callable[[Any], object]]] = {
    "foxglove.PoseInFrame": (foxglove.PoseInFrame, _encode_pose, _decode_pose),
    "foxglove.PosesInFrame": (foxglove.PosesInFrame, _encode_path, _decode_path),
    "foxglove.PointCloud": (foxglove.PointCloud, _encode_cloud, _decode_cloud),
    "foxglove.Log": (foxglove.Log, _encode_log, _decode_log),
}
