"""From a flight log (or any file with the sensor's packets) to the formats of other programs."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np

from companion.drivers.livox_packets import parse_header
from companion.errors import LogError, ProtocolError
from companion.geometry.trajectory import Trajectory
from companion.logs.channels import TRUTH
from companion.logs.reader import FlightRecording
from companion.logs.records import StampedPose
from companion.logs.tum import require_place, write_tum
from companion.messages import Datagram
from companion.recordings.packets import PacketRecording
from companion.recordings.source import open_recording
from sitl.recording_writers.captures import write_pcap, write_pcapng
from sitl.recording_writers.lvx2 import write_lvx2
from sitl.recording_writers.ros_bags import BagFormat, Stamps, write_bag

Format = Literal["pcap", "pcapng", "lvx2", "rosbag1", "rosbag2", "rosbag2-mcap"]


def convert(
    log: Path, out: Path, to: Format, *, stamps: Stamps = "sensor", truth: Path | None = None
) -> dict[str, object]:
    """Write the packets of a recording in another format.

    Args:
        log: a flight log, a network capture or an LVX2 file.
        out: where to; nothing may exist there.
        to: the format.
        stamps: in bags: the sensor's time, or the time of reception.
        truth: where to write the true motion of an emulated flight (TUM), on the clock of the stamps.

    Returns:
        The sensor's address, the number of packets, and how many malformed ones were left out.

    Raises:
        LogError: if the recording holds no packets, no truth that was asked for, or `out` exists.
    """
    recording = open_recording(log)
    if not isinstance(recording, PacketRecording):
        raise LogError(f"{log}: a {recording.kind} does not hold the sensor's packets")
    for path in (out, truth):
        if path is not None and path.exists():
            raise LogError(f"{path}: exists already")
    if truth is not None:
        require_place(truth)
    poses = _truth(log, recording.kind) if truth is not None else None
    good = _Good(recording.datagrams())
    _writer(to, recording.lidar_ip, stamps)(out, good)
    if truth is not None and poses is not None:
        by_host = to in get_args(BagFormat) and stamps == "host"
        shift_ns = 0 if by_host else good.clock_offset_ns
        write_tum(truth, Trajectory(poses.t_ns - shift_ns, poses.p, poses.q))
    return {"sensor": recording.lidar_ip, "packets": good.count, "malformed": good.malformed}


class _Good:
    """Passes on the packets that a driver would accept.

    Attributes:
        count, malformed: how many were passed on and left out.
        clock_offset_ns: host time minus sensor time, by the packet that was least on its way.
    """

    def __init__(self, datagrams: Iterator[Datagram]) -> None:
        self._datagrams = datagrams
        self.count = 0
        self.malformed = 0
        self.clock_offset_ns = 0

    def __iter__(self) -> Iterator[Datagram]:
        for datagram in self._datagrams:
            try:
                header = parse_header(datagram.payload)
            except ProtocolError:
                self.malformed += 1
                continue
            offset_ns = datagram.t_ns - header.t_sensor_ns - header.span_ns
            self.clock_offset_ns = min(self.clock_offset_ns, offset_ns) if self.count else offset_ns
            self.count += 1
            yield datagram


def _writer(to: Format, lidar_ip: str, stamps: Stamps) -> Callable[[Path, _Good], None]:
    if to == "pcap":
        return write_pcap
    if to == "pcapng":
        return write_pcapng
    if to == "lvx2":
        return lambda out, datagrams: write_lvx2(out, datagrams, lidar_ip)
    return lambda out, datagrams: write_bag(out, datagrams, lidar_ip, to, stamps)


def _truth(log: Path, kind: str) -> Trajectory:
    """Return the true motion of the body, by host time."""
    poses: list[StampedPose] = []
    if kind == "flight log":
        poses = [cast(StampedPose, entry.message) for entry in FlightRecording(log).messages(TRUTH)]
    if not poses:
        raise LogError(f"{log}: holds no true motion; only emulated flights do")
    t_ns = np.array([pose.t_ns for pose in poses], dtype=np.int64)
    return Trajectory(t_ns, np.array([pose.p for pose in poses]), np.array([pose.q for pose in poses]))
