import hashlib
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from companion.clock import StepClock, SystemClock
from companion.logs import channels
from companion.logs.channels import Channel
from companion.logs.codec import codec_of
from companion.logs.log_file import LogFile, LogState, unfinished_path
from companion.logs.log_queue import LogEntry, LogQueue
from companion.logs.reader import FlightRecording
from companion.logs.records import CloudView, ScanMark
from companion.logs.views import Recordable
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import Datagram, MavlinkMessage, Tick
from tests.logs.same import same
from tests.logs.samples import METADATA, datagram, odometry, one_of_each, registered_scan, vehicle_state

SETTINGS = LogSettings(disk_reserve_mib=0)


def direct(path: Path, settings: LogSettings = SETTINGS) -> FlightLog:
    return FlightLog(path, settings, METADATA, threaded=False)


def fly(log: FlightLog, seconds: float = 3.0, raw: int = 50) -> None:
    """Record a short flight: ticks, odometry, raw packets, scans."""
    rng = np.random.default_rng(5)
    for index in range(round(seconds * 50)):
        t_ns = index * 20_000_000
        for packet in range(raw):
            now_ns = t_ns + packet * 400_000
            log.record(Datagram(now_ns, ("127.0.0.2", 56300), ("127.0.0.1", 56301), rng.bytes(200)), now_ns)
        log.record(odometry(t_ns, rng), t_ns)
        log.record(Tick(t_ns), t_ns)
        if index % 5 == 0:
            log.record(registered_scan(t_ns, rng), t_ns)
        log.write(channels.MAVLINK_TX, MavlinkMessage("HEARTBEAT", 1, 191, {"i": index}), t_ns)


@pytest.mark.parametrize("threaded", [False, True])
def test_what_is_written_is_read_back_in_order(threaded: bool, tmp_path: Path) -> None:
    log = FlightLog(tmp_path / "a.mcap", LogSettings(imu=True), METADATA, threaded=threaded)
    samples = [(channel, message) for channel, message in one_of_each().items()]
    for index, (channel, message) in enumerate(samples):
        log.write(channel, message, 1000 * index)
    log.close()
    assert log.status().state is LogState.CLOSED
    recording = FlightRecording(tmp_path / "a.mcap")
    entries = list(recording.messages())
    assert [entry.channel.topic for entry in entries] == [channel.topic for channel, _ in samples]
    assert [entry.t_ns for entry in entries] == [1000 * index for index in range(len(samples))]
    assert all(same(entry.message, message) for entry, (_, message) in zip(entries, samples, strict=True))
    assert recording.integrity().complete
    assert recording.flight == {
        "vehicle": "uav_1",
        "role": "leader",
        "mode": "lockstep",
        "seed": "7",
        "git_commit": "0123abc",
    }
    assert recording.versions == dict(METADATA.versions)
    assert recording.configuration == METADATA.configuration


def test_the_same_flight_gives_the_same_bytes_wherever_it_is_written(tmp_path: Path) -> None:
    digests = set()
    for name in ("a/first.mcap", "b/c/second.mcap"):
        log = direct(tmp_path / name)
        fly(log)
        log.close()
        digests.add(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
    assert len(digests) == 1


def test_a_log_has_its_final_name_only_when_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    log = direct(path)
    log.record(Tick(0), 0)
    assert not path.exists()
    assert unfinished_path(path).exists()
    log.close()
    log.close()
    assert path.exists()
    assert not unfinished_path(path).exists()
    log.record(Tick(1), 1)
    assert log.status().refused == 1


@pytest.mark.parametrize("existing", ["a.mcap", "a.mcap.open"])
def test_an_existing_log_is_never_overwritten(existing: str, tmp_path: Path) -> None:
    (tmp_path / existing).write_bytes(b"precious")
    log = direct(tmp_path / "a.mcap")
    log.record(Tick(0), 0)
    log.close()
    assert (tmp_path / existing).read_bytes() == b"precious"
    assert log.status().state is LogState.FAILED
    assert "exists" in log.status().reason
    assert log.status().refused == 1


def test_journal_order_survives_with_raw_packets_before_the_events_they_precede(tmp_path: Path) -> None:
    log = direct(tmp_path / "a.mcap")
    rng = np.random.default_rng(3)
    log.record(datagram(1), 1)
    log.record(datagram(2), 2)
    scan = registered_scan(3, rng)
    handled: list[Recordable] = [odometry(3, rng), scan, vehicle_state(4), Tick(5), Tick(6)]
    for event in handled:
        log.record(event, 10)
    log.record(datagram(7), 11)
    log.close()
    recording = FlightRecording(tmp_path / "a.mcap")
    events = [entry.message for entry in recording.control_events()]
    assert [type(event) for event in events] == [type(handled[0]), ScanMark, type(handled[2]), Tick, Tick]
    assert same(events[0], handled[0])
    raw = [
        entry for entry in recording.messages() if entry.channel in (channels.LIDAR_PACKETS, channels.TICK)
    ]
    assert [entry.channel.topic for entry in raw] == ["/lidar/packets", "/tick", "/tick", "/lidar/packets"]
    assert [d.t_ns for d in raw[0].message] == [1, 2]  # type: ignore[attr-defined]


def test_datagrams_are_batched_by_time_and_none_is_lost(tmp_path: Path) -> None:
    log = direct(tmp_path / "a.mcap")
    sent = [datagram(index * 480_000, fill=index % 256) for index in range(1000)]
    for one in sent:
        log.record(one, one.t_ns)
    log.close()
    batches = [entry.message for entry in FlightRecording(tmp_path / "a.mcap").messages()]
    received = [one for batch in batches for one in batch]  # type: ignore[attr-defined]
    assert received == sent
    assert len(batches) == pytest.approx(480e-6 * 1000 / 0.020, abs=2)


def test_clouds_are_thinned_in_space_and_time_and_marks_are_not(tmp_path: Path) -> None:
    log = direct(tmp_path / "a.mcap", LogSettings(cloud_points=700, cloud_rate_hz=2.0))
    rng = np.random.default_rng(3)
    for index in range(20):
        log.record(registered_scan(index * 100_000_000, rng), index * 100_000_000)
    log.close()
    recording = FlightRecording(tmp_path / "a.mcap")
    clouds = [entry.message for entry in recording.messages(channels.CLOUD)]
    assert [cloud.t_ns for cloud in clouds] == [0, 500_000_000, 1_000_000_000, 1_500_000_000]  # type: ignore[attr-defined]
    assert all(isinstance(cloud, CloudView) and 600 < len(cloud.points_map) <= 700 for cloud in clouds)
    assert sum(1 for _ in recording.messages(channels.SCAN)) == 20


def test_channels_that_are_off_are_not_recorded(tmp_path: Path) -> None:
    log = direct(tmp_path / "a.mcap", LogSettings(raw_lidar=False, clouds=False))
    fly(log, 0.2)
    log.write(channels.IMU, one_of_each()[channels.IMU], 0)
    log.close()
    topics = set(FlightRecording(tmp_path / "a.mcap").integrity().messages)
    assert topics == {"/odometry", "/pose", "/tick", "/scan", "/mavlink/tx"}


def test_a_message_on_the_wrong_channel_is_refused(tmp_path: Path) -> None:
    log = direct(tmp_path / "a.mcap")
    with pytest.raises(AttributeError):
        log.write(channels.SETPOINT, Tick(0), 0)
    with pytest.raises(TypeError, match="no channel for a MavlinkMessage"):
        log.record(MavlinkMessage("X", 1, 1, {}), 0)  # type: ignore[arg-type]
    log.close()


def test_a_threaded_log_counts_a_misfit_and_goes_on(tmp_path: Path) -> None:
    log = FlightLog(tmp_path / "a.mcap", SETTINGS, METADATA, threaded=True)
    log.write(channels.SETPOINT, Tick(0), 0)
    log.record(Tick(1), 1)
    log.close()
    assert log.status().unencodable == 1
    recording = FlightRecording(tmp_path / "a.mcap")
    assert [entry.message for entry in recording.messages()] == [Tick(1)]


def test_a_full_queue_refuses_bulk_first() -> None:
    queue = LogQueue(10_000)
    bulk = LogEntry(channels.LIDAR_PACKETS, 0, 0, ())
    small = LogEntry(channels.TICK, 0, 0, Tick(0))
    assert sum(queue.offer(bulk, 1000) for _ in range(20)) == 5
    assert sum(queue.offer(small, 500) for _ in range(20)) == 10
    assert (queue.dropped_bulk, queue.dropped) == (15, 10)
    assert queue.waiting_bytes == 10_000
    while queue.take() is not None:
        pass
    assert queue.waiting_bytes == 0
    assert queue.offer(bulk, 1000)


def test_two_threads_may_record_at_once_and_nothing_is_lost(tmp_path: Path) -> None:
    log = FlightLog(tmp_path / "a.mcap", SETTINGS, METADATA, threaded=True)
    packets = [datagram(index * 100_000, size=20) for index in range(5000)]

    def receive() -> None:
        for packet in packets:
            log.record(packet, packet.t_ns)

    receiver = threading.Thread(target=receive)
    receiver.start()
    for index in range(2000):
        log.record(Tick(index), index)
    receiver.join()
    log.close()
    recording = FlightRecording(tmp_path / "a.mcap")
    batches = [entry.message for entry in recording.messages(channels.LIDAR_PACKETS)]
    assert [one for batch in batches for one in batch] == packets  # type: ignore[attr-defined]
    assert [entry.message for entry in recording.messages(channels.TICK)] == [Tick(i) for i in range(2000)]
    assert recording.integrity().missing == {}


def test_while_the_disk_hangs_control_goes_on_and_only_bulk_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()
    original = LogFile.append

    def hang(self: LogFile, entry: LogEntry) -> None:
        released.wait(20.0)
        original(self, entry)

    monkeypatch.setattr(LogFile, "append", hang)
    log = FlightLog(
        tmp_path / "a.mcap", LogSettings(queue_mib=1, disk_reserve_mib=0), METADATA, threaded=True
    )
    for index in range(300):
        log.write(channels.LIDAR_PACKETS, tuple(datagram(index) for _ in range(5)), index)
        log.record(Tick(index), index)
    waiting = log.status()
    assert waiting.written == 0
    assert waiting.waiting_bytes <= 1024 * 1024
    assert waiting.dropped_bulk > 100
    assert waiting.dropped == 0
    released.set()
    log.close()
    recording = FlightRecording(tmp_path / "a.mcap")
    assert [entry.message for entry in recording.messages(channels.TICK)] == [Tick(i) for i in range(300)]
    # What was dropped after the last message that was written leaves no gap to see.
    assert 0 < recording.integrity().missing.get("/lidar/packets", 0) + 1 <= waiting.dropped_bulk + 1


def test_below_the_disk_reserve_bulk_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LogFile, "free_bytes", 1024)
    clock = StepClock()
    log = FlightLog(tmp_path / "a.mcap", LogSettings(), METADATA, threaded=True, clock=clock)
    log.write(channels.LIDAR_PACKETS, (datagram(0),), 0)
    clock.advance_to(1_500_000_000)
    deadline = 500
    while not log.status().reason and deadline:
        SystemClock().pause(10_000_000)
        deadline -= 1
    assert log.status().reason == "disk nearly full: raw data and clouds are left out"
    log.write(channels.LIDAR_PACKETS, (datagram(1),), 1)
    log.record(Tick(2), 2)
    log.close()
    assert log.status().dropped_bulk == 1
    messages = FlightRecording(tmp_path / "a.mcap").integrity().messages
    assert messages == {"/lidar/packets": 1, "/tick": 1}


WRITE_UNTIL_STOPPED = """
import resource, sys
from pathlib import Path
from tests.logs.samples import METADATA, vehicle_state
from companion.clock import SystemClock
from companion.logs import channels
from companion.logs.views import Recordable
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import Tick
path, limit, period_ns, count, threaded = Path(sys.argv[1]), *map(int, sys.argv[2:])
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
clock = SystemClock()
log = FlightLog(path, LogSettings(disk_reserve_mib=0), METADATA, threaded=bool(threaded))
for index in range(count):
    log.record(Tick(clock.now_ns()), clock.now_ns())
    log.record(vehicle_state(index * 7919), clock.now_ns())
    if period_ns:
        print(index, flush=True)
        clock.pause(period_ns)
log.close()
status = log.status()
print(status.state.value, status.refused, status.written, status.reason)
"""


def python(*arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", WRITE_UNTIL_STOPPED, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2])


def test_a_killed_process_loses_at_most_its_last_second(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    period_ns = 5_000_000
    with python(path, 0, period_ns, 10**6, 1) as process:
        assert process.stdout is not None
        written = 0
        while written < 500:
            written = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        written = max([written, *map(int, process.stdout.read().split())])
    recording = FlightRecording(unfinished_path(path))
    ticks = [entry.t_ns for entry in recording.messages(channels.TICK)]
    assert not recording.integrity().complete
    assert recording.integrity().bytes_lost == 0
    # The last second, a writer's wake-up, and a sync on a busy disk.
    assert written - len(ticks) <= 1.5e9 / period_ns
    assert len(ticks) > 100


@pytest.mark.parametrize("threaded", [0, 1])
def test_a_disk_that_is_full_ends_the_recording_and_leaves_a_readable_file(
    threaded: int, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    with python(path, 50_000, 0, 20_000, threaded) as process:
        output = process.communicate(timeout=60)[0]
    state, refused, written, *reason = output.splitlines()[-1].split()
    assert process.returncode == 0
    assert state == "failed"
    assert "large" in " ".join(reason), "the system's limit on the file size stands for the full disk"
    assert int(refused) + int(written) == 40_000
    recording = FlightRecording(unfinished_path(path))
    readable = sum(recording.integrity().messages.values())
    assert 0 < readable <= int(written)
    assert recording.integrity().bytes_lost == 0


def test_a_directory_that_cannot_be_made_ends_the_recording_not_the_flight(tmp_path: Path) -> None:
    (tmp_path / "occupied").write_text("a file")
    for threaded in (False, True):
        log = FlightLog(tmp_path / "occupied" / "a.mcap", SETTINGS, METADATA, threaded=threaded)
        log.record(Tick(0), 0)
        log.close()
        status = log.status()
        assert status.state is LogState.FAILED
        assert status.refused == 1
        assert "Not a directory" in status.reason or "File exists" in status.reason


def test_the_disk_is_flushed_every_second_of_message_time(tmp_path: Path) -> None:
    log = direct(tmp_path / "a.mcap")
    sizes = []
    for index in range(60):
        log.record(Tick(index * 100_000_000), index * 100_000_000)
        sizes.append(os.stat(unfinished_path(tmp_path / "a.mcap")).st_size)
    grown = [index for index in range(1, 60) if sizes[index] > sizes[index - 1]]
    assert grown == [10, 20, 30, 40, 50]
    log.close()


def test_the_status_is_itself_a_message(tmp_path: Path) -> None:
    log = direct(tmp_path / "a.mcap")
    log.record(Tick(0), 0)
    statistics = log.status().statistics(5)
    channel: Channel = channels.STATISTICS
    assert statistics.values["written"] == 1
    assert same(codec_of(channel).decode(codec_of(channel).encode(statistics)), statistics)
    log.close()
