"""Whatever happens to a file, reading it ends in events or in the one documented error."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from companion.errors import LogError
from companion.logs.metadata import FlightMetadata
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import ImuSample, LidarScan, SensorEvent
from companion.recordings.source import open_recording
from sitl.recording_writers.captures import write_pcap, write_pcapng
from sitl.recording_writers.lvx2 import write_lvx2
from sitl.recording_writers.ros_bags import write_bag
from tests.recordings.emulated import LIDAR_IP, SETTINGS, datagrams

SENT = datagrams(0.25)


def flight_log(path: Path) -> None:
    log = FlightLog(path, LogSettings(), FlightMetadata("test", "leader", "lockstep", ""), threaded=False)
    for datagram in SENT:
        log.record(datagram, datagram.t_ns)
    log.close()


WRITERS: dict[str, Callable[[Path], None]] = {
    "pcap": lambda path: write_pcap(path, SENT),
    "pcapng": lambda path: write_pcapng(path, SENT),
    "lvx2": lambda path: write_lvx2(path, SENT, LIDAR_IP),
    "bag": lambda path: write_bag(path, SENT, LIDAR_IP, "rosbag1"),
    "db3": lambda path: write_bag(path, SENT, LIDAR_IP, "rosbag2"),
    "mcap": lambda path: write_bag(path, SENT, LIDAR_IP, "rosbag2-mcap"),
    "flight": flight_log,
}


@pytest.fixture(scope="module", params=list(WRITERS))
def content(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A whole file of each format."""
    path = tmp_path_factory.mktemp("whole") / "recording"
    WRITERS[request.param](path)
    if path.is_dir():
        path = next(file for file in path.iterdir() if file.suffix in (".db3", ".mcap"))
    return path.read_bytes()


def outcome(path: Path) -> str:
    """Read a file to its end and return what came of it; events must be sound."""
    try:
        recording = open_recording(path, SETTINGS)
        for event in recording.events():
            check(event)
        return "whole" if recording.summary().complete else "cut"
    except LogError as error:
        return str(error)


def check(event: SensorEvent) -> None:
    if isinstance(event, ImuSample):
        assert np.isfinite(event.gyro_imu).all()
        assert np.isfinite(event.accel_imu).all()
    elif isinstance(event, LidarScan):
        assert np.isfinite(event.points_lidar).all()
        assert (np.diff(event.offsets_ns) >= 0).all()
        assert ((event.offsets_ns >= 0) & (event.offsets_ns < 100_000_000)).all()


def is_one_sentence(text: str, path: Path) -> bool:
    """Return whether a file was read, or refused with one line that names it."""
    return text in ("whole", "cut") or (text.startswith(f"{path}: ") and "\n" not in text)


def test_a_whole_file_is_read_whole(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "recording"
    path.write_bytes(content)
    assert outcome(path) == "whole"


def test_a_file_cut_anywhere_ends_in_order(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "recording"
    places = np.random.default_rng(1).integers(0, len(content), 8).tolist()
    for length in [0, 1, 8, 20, 40, 100, *places]:
        path.write_bytes(content[:length])
        assert is_one_sentence(outcome(path), path)


@pytest.mark.parametrize("seed", range(3))
def test_flipped_bytes_end_in_order(tmp_path: Path, content: bytes, seed: int) -> None:
    path = tmp_path / "recording"
    rng = np.random.default_rng(seed)
    for number in range(10):
        damaged = bytearray(content)
        # Heads and indices hold the lengths and counts that hurt most.
        region = (len(content), 400, 3000)[number % 3]
        for place in rng.integers(0, min(region, len(content)), 1 + number % 5).tolist():
            at = place if number % 2 else len(content) - 1 - place
            damaged[at] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        assert is_one_sentence(outcome(path), path)
