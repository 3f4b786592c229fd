"""Datagrams as a file of Livox Viewer 2: points only, since the format has no place for inertial samples.

Source: LVX2 Specifications v1.0, 2023.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO

from companion.drivers.livox_packets import HEADER_SIZE, DataType, parse_header
from companion.drivers.livox_protocol import pack_ip
from companion.drivers.livox_settings import LidarPorts
from companion.errors import LogError
from companion.messages import Datagram
from companion.recordings.lvx2 import (
    DEVICE,
    FILE_HEAD,
    FRAME_HEAD,
    FRAME_MS,
    MAGIC,
    MID_360,
    PACKAGE_HEAD,
    SIGNATURE,
    VERSION,
)

_FRAME_NS = FRAME_MS * 1_000_000
_FRAME_COUNTER_AT = 9
_ALLOWED = (DataType.CARTESIAN_32, DataType.CARTESIAN_16)


def write_lvx2(path: Path, datagrams: Iterable[Datagram], lidar_ip: str, serial: str = "UNKNOWN") -> None:
    """Write the point packets of one sensor; an older file is replaced.

    Args:
        path: where to.
        datagrams: in the order of reception; all but the sensor's points are left out.
        lidar_ip: address of the sensor.
        serial: its serial number, at most 16 ASCII characters.

    Raises:
        LogError: if the sensor sent spherical coordinates, for which the format has no place.
    """
    source = (lidar_ip, LidarPorts().points)
    lidar_id = pack_ip(lidar_ip)
    with path.open("wb") as file:
        file.write(FILE_HEAD.pack(SIGNATURE, *VERSION, MAGIC, FRAME_MS, 1))
        extrinsic = [0.0] * 6
        file.write(DEVICE.pack(serial.encode("ascii"), b"", lidar_id, 0, MID_360, 0, *extrinsic))
        frame: list[bytes] = []
        number, index, offset = None, 0, file.tell()
        for datagram in datagrams:
            if datagram.source != source:
                continue
            header = parse_header(datagram.payload)
            if header.data_type not in _ALLOWED:
                raise LogError(f"LVX2 holds cartesian points only, not data type {header.data_type}")
            if frame and header.t_sensor_ns // _FRAME_NS != number:
                offset = _write_frame(file, offset, index, frame)
                frame, index = [], index + 1
            number = header.t_sensor_ns // _FRAME_NS
            points = datagram.payload[HEADER_SIZE:]
            frame_counter = datagram.payload[_FRAME_COUNTER_AT]
            package = (0, lidar_id, 0, header.time_type, header.t_sensor_ns, header.counter, header.data_type)
            frame.append(PACKAGE_HEAD.pack(*package, len(points), frame_counter) + points)
        if frame:
            _write_frame(file, offset, index, frame)


def _write_frame(file: BinaryIO, offset: int, index: int, packages: list[bytes]) -> int:
    """Write one frame at `offset` and return where the next one begins."""
    following = offset + FRAME_HEAD.size + sum(len(package) for package in packages)
    file.write(FRAME_HEAD.pack(offset, following, index) + b"".join(packages))
    return following
