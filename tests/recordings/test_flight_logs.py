import json
from pathlib import Path

import numpy as np
import pytest

from companion.errors import LogError
from companion.geometry.pose import Pose
from companion.geometry.rotation import IDENTITY
from companion.logs import channels
from companion.logs.metadata import FlightMetadata
from companion.logs.records import StampedPose
from companion.logs.tum import read_tum
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import Datagram, Odometry, RegisteredScan, SensorEvent
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.perception.odometry.settings import OdometrySettings
from companion.recordings.source import open_recording
from sitl import cli
from sitl.livox_emulator import LivoxEmulator, LivoxEmulatorSettings
from sitl.recording_writers.captures import write_pcap
from sitl.recording_writers.conversion import Format, convert
from sitl.slots import InertialSlot, PointSlots
from tests.recordings.emulated import BOOT_NS, LIDAR_IP, SETTINGS, datagrams, identical, received

LATENCY_NS = 200_000


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """The log of a flight during which everything arrived 0.2 ms after it was sent."""
    path = tmp_path / "flight.mcap"
    log = FlightLog(path, LogSettings(), FlightMetadata("test", "leader", "lockstep"), threaded=False)
    for sent in datagrams():
        t_ns = sent.t_ns + LATENCY_NS
        if sent.source[1] != 56200:
            log.record(Datagram(t_ns, sent.source, sent.destination, sent.payload), t_ns)
    for index in range(3):
        p = np.array([float(index), 2.0, 3.0])
        pose = StampedPose(BOOT_NS + index * 20_000_000, "map", p, IDENTITY)
        log.write(channels.TRUTH, pose, pose.t_ns)
    log.close()
    return path


def test_a_flight_log_gives_the_events_that_flew(flight: Path) -> None:
    recording = open_recording(flight, SETTINGS)
    sent = tuple(
        Datagram(sent.t_ns + LATENCY_NS, sent.source, sent.destination, sent.payload) for sent in datagrams()
    )
    assert identical(list(recording.events()), received(sent))
    summary = recording.summary()
    assert (summary.kind, summary.complete, summary.notes) == ("flight log", True, ())


def test_an_unfinished_flight_log_is_read_as_far_as_it_goes(flight: Path) -> None:
    flight.write_bytes(flight.read_bytes()[:-500_000])
    summary = open_recording(flight, SETTINGS).summary()
    assert 0 < summary.imu_samples < 200
    assert "the log is incomplete" in summary.notes[-1]


@pytest.mark.parametrize("to", ["pcap", "pcapng", "lvx2", "rosbag1", "rosbag2", "rosbag2-mcap"])
def test_a_flight_is_converted_with_its_truth(flight: Path, tmp_path: Path, to: Format) -> None:
    out, truth = tmp_path / "out", tmp_path / "truth.tum"
    result = convert(flight, out, to, truth=truth)
    assert result == {"sensor": LIDAR_IP, "packets": 2283, "malformed": 0}
    assert open_recording(out, SETTINGS).summary().points > 80_000
    # Sensor time counts from power-on; only the least latency cannot be told from the clocks' offset.
    assert read_tum(truth).t_ns.tolist() == [index * 20_000_000 - LATENCY_NS for index in range(3)]


def test_a_capture_converts_like_the_flight_it_came_from(flight: Path, tmp_path: Path) -> None:
    convert(flight, tmp_path / "one.pcap", "pcap")
    convert(tmp_path / "one.pcap", tmp_path / "two.pcapng", "pcapng")
    there, back = (open_recording(path, SETTINGS) for path in (flight, tmp_path / "two.pcapng"))
    assert identical(list(back.events()), list(there.events()))


def test_truth_stays_on_the_host_s_clock_with_host_stamps(flight: Path, tmp_path: Path) -> None:
    convert(flight, tmp_path / "out.bag", "rosbag1", stamps="host", truth=tmp_path / "truth.tum")
    assert read_tum(tmp_path / "truth.tum").t_ns[0] == BOOT_NS


def test_nothing_is_overwritten_and_nothing_invented(flight: Path, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="exists already"):
        convert(flight, flight, "pcap")
    capture = tmp_path / "one.pcap"
    convert(flight, capture, "pcap")
    with pytest.raises(LogError, match="holds no true motion"):
        convert(capture, tmp_path / "two.pcap", "pcap", truth=tmp_path / "truth.tum")
    bag = tmp_path / "one.bag"
    convert(flight, bag, "rosbag1")
    with pytest.raises(LogError, match="a ROS 1 bag does not hold the sensor's packets"):
        convert(bag, tmp_path / "three.pcap", "pcap")


def test_the_verb_says_what_it_wrote(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.pcapng"
    assert cli.main(["convert", str(flight), str(out), "--to", "pcapng", "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found == {"sensor": LIDAR_IP, "packets": 2283, "malformed": 0, "exit": 0}
    assert cli.main(["convert", str(flight), str(out), "--to", "pcapng"]) == 65
    assert "exists already" in capsys.readouterr().err
    assert cli.main(["convert", str(tmp_path / "nothing"), str(out), "--to", "pcap"]) == 66


def test_odometry_from_a_capture_equals_odometry_in_flight_bit_for_bit(tmp_path: Path) -> None:
    emulator = LivoxEmulator(
        LivoxEmulatorSettings(
            lidar_ip=LIDAR_IP, persisted_host_ip="192.168.1.50", persisted_target="sampling"
        ),
        BOOT_NS,
    )
    sent: list[Datagram] = []
    for batch in range(300):
        sent += emulator.points(box_slots(2000 * batch, 2000))
        for t_ns in (10_000_000 * batch + 5_000_000, 10_000_000 * (batch + 1)):
            sent += emulator.inertial(InertialSlot(t_ns, np.full(3, 0.001), np.array([0.0, 0.0, 9.8])))
    sent.sort(key=lambda datagram: datagram.t_ns)
    capture = tmp_path / "still.pcap"
    write_pcap(capture, sent)
    flown = odometry(received(tuple(sent)))
    assert sum(isinstance(output, RegisteredScan) for output in flown) > 5
    replayed = odometry(list(open_recording(capture, SETTINGS).events()))
    assert [bits(output) for output in replayed] == [bits(output) for output in flown]


def box_slots(first_slot: int, count: int) -> PointSlots:
    """Return slots on the inside of a box of 10 m x 8 m x 3 m around the sensor."""
    directions = np.random.default_rng(first_slot).normal(size=(count, 3))
    points = directions / np.max(np.abs(directions) / [5.0, 4.0, 1.5], axis=1, keepdims=True)
    return PointSlots(first_slot, points, np.full(count, 50, np.uint8), np.zeros(count, np.uint8))


def odometry(events: list[SensorEvent]) -> list[Odometry | RegisteredScan]:
    settings = OdometrySettings(fine_blocks=32_768, coarse_blocks=8_192)
    lio = LidarInertialOdometry(
        settings, Pose.of([0.0, 0.0, 0.0], IDENTITY), Pose.of([0.011, 0.02329, -0.04412], IDENTITY)
    )
    return [output for event in events for output in lio.handle(event)]


def bits(output: Odometry | RegisteredScan) -> tuple[object, ...]:
    if isinstance(output, RegisteredScan):
        return output.t_ns, output.points_map.tobytes(), *bits(output.odometry)
    arrays = (output.p_map, output.q_map_body, output.v_map, output.omega_body, output.covariance_pose)
    return output.t_ns, output.t_sensor_ns, output.quality, *(array.tobytes() for array in arrays)
