"""Files of Livox Viewer 2 (LVX2) as a source of datagrams.

A file holds frames of 50 ms, a frame holds packages, and a package is a data packet of the sensor under
another header. The original packets are put together again, so that the receiver that flies reads them.
Their time of arrival is not in the file; the time of their last slot stands in for it.

Source: LVX2 Specifications v1.0, 2023.
"""

import os
import socket
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from companion.drivers.livox_packets import (
    HEADER_SIZE,
    INERTIAL_PACKET_SIZE,
    MAX_PACKET_SIZE,
    MAX_STAMP_NS,
    POINT_DTYPES,
    SLOT_PERIOD_NS,
    TIME_INTERVAL_UNIT_NS,
    DataType,
)
from companion.drivers.livox_settings import LidarPorts
from companion.messages import Datagram
from companion.recordings.recording import damage

SIGNATURE = b"livox_tech"
MAGIC = 0xAC0EA767
VERSION = (2, 0, 0, 0)
FRAME_MS = 50
MID_360, MID_360S = 9, 35

FILE_HEAD = struct.Struct("<16s4BIIB")
"""Signature, version, magic; frame duration in ms, number of devices."""
DEVICE = struct.Struct("<16s16s4sBBB6f")
"""Serial number, hub, LiDAR ID, reserved, device type, extrinsic enabled, its angles (deg) and shift (m)."""
FRAME_HEAD = struct.Struct("<qqq")
"""Offset of this frame and of the next one in the file, index."""
PACKAGE_HEAD = struct.Struct("<B4sBBQHBIB4x")
"""Version, LiDAR ID, reserved, time type, stamp (ns), packet counter, data type, bytes of points, frame."""

_POINT_SIZES = {int(kind): dtype.itemsize for kind, dtype in POINT_DTYPES.items()}
_PACKET_HEAD = struct.Struct("<BHHHHBBB12xIQ")
_STAMP = struct.Struct("<Q")
_HOST = ("0.0.0.0", 0)


@dataclass(frozen=True, slots=True)
class _Device:
    serial: str
    lidar_ip: str
    device_type: int
    moved: bool


class Lvx2Source:
    """An LVX2 file.

    Attributes:
        kind: "lvx2".
        skipped: packages of the last pass that are no data packets.
        notes: what the file's header has to say.
    """

    def __init__(self, path: Path, ports: LidarPorts) -> None:
        """Read the header; the packages will seem to come from `ports` of the device.

        Raises:
            LogError: if it is no LVX2 file.
            OSError: if reading the disk fails.
        """
        self.kind = "lvx2"
        self.skipped: Counter[str] = Counter()
        self._path = path
        self._ports = ports
        with path.open("rb") as file:
            self._size = os.fstat(file.fileno()).st_size
            devices = self._devices(file)
            self._first_frame = file.tell()
        self.notes = [note for device in devices for note in _notes_on(device)]

    def datagrams(self) -> Iterator[Datagram]:
        """Yield the packages as the packets they were, from the beginning.

        Raises:
            LogError: where the file is cut or damaged, after everything before that was yielded.
            OSError: if reading the disk fails.
        """
        self.skipped = Counter()
        with self._path.open("rb") as file:
            offset = self._first_frame
            file.seek(offset)
            while head := file.read(FRAME_HEAD.size):
                if len(head) < FRAME_HEAD.size:
                    raise damage(self._path, offset, "the file ends within a frame's header")
                current, following, _ = FRAME_HEAD.unpack(head)
                if current != offset or following < offset + FRAME_HEAD.size:
                    raise damage(
                        self._path, offset, f"a frame that claims to reach from {current} to {following}"
                    )
                yield from self._packages(file, offset + FRAME_HEAD.size, following)
                offset = following

    def _devices(self, file: BinaryIO) -> list[_Device]:
        head = file.read(FILE_HEAD.size)
        if len(head) < FILE_HEAD.size:
            raise damage(self._path, 0, "no complete LVX2 header")
        signature, *version, magic, _, count = FILE_HEAD.unpack(head)
        if not signature.startswith(SIGNATURE) or magic != MAGIC:
            raise damage(self._path, 0, "no LVX2 header")
        if version[0] != VERSION[0]:
            raise damage(
                self._path, 16, f"an LVX file of version {version[0]}.{version[1]}; version 2 is known"
            )
        devices = []
        for _ in range(count):
            offset = file.tell()
            entry = file.read(DEVICE.size)
            if len(entry) < DEVICE.size:
                raise damage(self._path, offset, "the file ends within the list of devices")
            serial, _, lidar_id, _, device_type, enabled, *extrinsic = DEVICE.unpack(entry)
            text = serial.split(b"\0", 1)[0].decode("ascii", "replace")
            moved = bool(enabled) and any(extrinsic)
            devices.append(_Device(text, socket.inet_ntoa(lidar_id), device_type, moved))
        return devices

    def _packages(self, file: BinaryIO, offset: int, end: int) -> Iterator[Datagram]:
        while offset < end:
            head = file.read(PACKAGE_HEAD.size)
            if len(head) < PACKAGE_HEAD.size:
                raise damage(self._path, offset, "the file ends within a frame")
            length = PACKAGE_HEAD.unpack(head)[7]
            behind = offset + PACKAGE_HEAD.size + length
            if behind > end:
                raise damage(self._path, offset, f"a package of {length} bytes reaches beyond its frame")
            if behind > self._size:
                raise damage(self._path, offset, "the file ends within a package")
            if length > MAX_PACKET_SIZE - HEADER_SIZE:
                self.skipped["malformed packages"] += 1
                file.seek(behind)
            else:
                datagram = self._datagram(head, file.read(length))
                if datagram is None:
                    self.skipped["malformed packages"] += 1
                else:
                    yield datagram
            offset = behind

    def _datagram(self, head: bytes, data: bytes) -> Datagram | None:
        version, lidar_id, _, time_type, stamp, counter, data_type, length, frame = PACKAGE_HEAD.unpack(head)
        inertial = data_type == DataType.IMU
        size = INERTIAL_PACKET_SIZE - HEADER_SIZE if inertial else _POINT_SIZES.get(data_type, 0)
        if version != 0 or size == 0 or length == 0 or length % size or stamp >= MAX_STAMP_NS:
            return None
        slots = length // size
        span_ns = 0 if inertial else (slots - 1) * SLOT_PERIOD_NS
        content = _STAMP.pack(stamp) + data
        packet_head = _PACKET_HEAD.pack(
            0,
            HEADER_SIZE + length,
            span_ns // TIME_INTERVAL_UNIT_NS,
            slots,
            counter,
            frame,
            data_type,
            time_type,
            zlib.crc32(content),
            stamp,
        )
        port = self._ports.imu if inertial else self._ports.points
        return Datagram(stamp + span_ns, (socket.inet_ntoa(lidar_id), port), _HOST, packet_head + data)


def _notes_on(device: _Device) -> list[str]:
    name = f"{device.lidar_ip} (serial {device.serial or 'unknown'})"
    notes = []
    if device.device_type not in (MID_360, MID_360S):
        notes.append(f"{name} is a device of type {device.device_type}, read as if it were a Mid-360")
    if device.moved:
        notes.append(f"the file's extrinsic of {name} is not applied: points stay in the sensor's frame")
    return notes
