"""Opens a recording of a Mid-360 by what is in the file, not by what it is called."""

from collections.abc import Iterator
from pathlib import Path

from companion.drivers.livox_settings import LivoxSettings
from companion.errors import LogError
from companion.logs.container import LIBRARY
from companion.logs.container import MAGIC as MCAP_MAGIC
from companion.messages import SensorEvent
from companion.recordings.bag import BagRecording
from companion.recordings.bag_container import BagContainer, Storage
from companion.recordings.bag_settings import BagSettings
from companion.recordings.capture import CaptureSource
from companion.recordings.capture_frames import PCAP_MAGICS, PCAPNG_MAGIC
from companion.recordings.flight_packets import FlightPackets
from companion.recordings.lvx2 import SIGNATURE as LVX_SIGNATURE
from companion.recordings.lvx2 import Lvx2Source
from companion.recordings.packets import PacketRecording, PacketSource
from companion.recordings.recording import Recording

FORMATS = "PCAP, PCAPNG, LVX2, ROS 1 bag, ROS 2 bag (SQLite, MCAP), flight log"

_COMPRESSED = {
    b"\x1f\x8b": "gzip",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"PK\x03\x04": "zip",
}
_HEAD_BYTES = 64


def open_recording(
    path: Path, lidar: LivoxSettings | None = None, bag: BagSettings | None = None
) -> Recording:
    """Open a recording; its format is told by its first bytes.

    Args:
        path: the file (or the folder of a ROS 2 bag).
        lidar: what is filtered, how scans are cut, and which sensor is read when the file holds several:
            the one at `lidar_ip`. A file with one sensor is read whatever its address.
        bag: topics and units, for ROS bags that leave a choice.

    Raises:
        LogError: if the format is unknown, or nothing in the file can be used.
        OSError: if the file is missing or cannot be read.
    """
    settings = lidar or LivoxSettings()
    head = b""
    if not path.is_dir():
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    source = _packet_source(path, head, settings)
    if source is not None:
        return PacketRecording(path, source, settings)
    storage = _bag_storage(path, head)
    if storage is not None:
        return BagRecording(path, BagContainer(path, storage), settings, bag or BagSettings())
    if path.is_dir():
        raise LogError(f"{path}: a folder without metadata.yaml is no ROS 2 bag")
    raise LogError(f"{path}: byte 0: {_described(head)}; known formats are {FORMATS}")


def read_events(
    path: Path, lidar: LivoxSettings | None = None, bag: BagSettings | None = None
) -> Iterator[SensorEvent]:
    """Yield the events of a recording: `open_recording` without looking at its summary.

    Raises:
        LogError: if the format is unknown, or nothing in the file can be used.
        OSError: if the file is missing or cannot be read.
    """
    yield from open_recording(path, lidar, bag).events()


def _packet_source(path: Path, head: bytes, lidar: LivoxSettings) -> PacketSource | None:
    if head[:4] in PCAP_MAGICS:
        return CaptureSource(path, new_generation=False)
    if head.startswith(PCAPNG_MAGIC):
        return CaptureSource(path, new_generation=True)
    if head.startswith(LVX_SIGNATURE):
        return Lvx2Source(path, lidar.lidar_ports)
    if head.startswith(MCAP_MAGIC) and _mcap_library(head) == LIBRARY:
        return FlightPackets(path)
    return None


def _bag_storage(path: Path, head: bytes) -> Storage | None:
    if path.is_dir():
        return "dir" if (path / "metadata.yaml").is_file() else None
    if head.startswith(b"#ROSBAG"):
        return "rosbag1"
    if head.startswith(b"SQLite format 3\0"):
        return ".db3"
    return ".mcap" if head.startswith(MCAP_MAGIC) else None


def _mcap_library(head: bytes) -> str:
    """Return which library wrote an MCAP file: its header holds a profile and that name."""
    position = len(MCAP_MAGIC) + 9
    profile_length = int.from_bytes(head[position : position + 4], "little")
    position += 4 + profile_length
    length = int.from_bytes(head[position : position + 4], "little")
    return head[position + 4 : position + 4 + length].decode(errors="replace")


def _described(head: bytes) -> str:
    """Return what an unusable file begins with."""
    if not head:
        return "the file is empty"
    for magic, name in _COMPRESSED.items():
        if head.startswith(magic):
            return f"compressed with {name}: unpack it first"
    return f"the file begins with {head[:8].hex(' ')}, which is no known format"
