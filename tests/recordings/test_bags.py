import sqlite3
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from rosbags.highlevel import AnyReader

from companion.drivers.livox_packets import decode_points
from companion.drivers.livox_settings import LivoxSettings
from companion.errors import LogError
from companion.messages import SensorEvent
from companion.recordings.bag_settings import BagSettings
from companion.recordings.recording import RecordingSummary
from companion.recordings.source import open_recording
from sitl.recording_writers.ros_bags import BagFormat, write_bag
from tests.recordings.emulated import LIDAR_IP, SETTINGS, datagrams, received, samples, scans
from tests.recordings.ros_samples import CUSTOM_DIGEST, START_NS, Messages

MS = 1_000_000
BOTH = pytest.mark.parametrize("ros1", [True, False], ids=["ROS 1", "ROS 2"])
ALL_POINTS = LivoxSettings(min_range_m=0.0, tag_policy="all")
FIRST = (0, 1.0, 2.0, 3.0, 10, 16, 0)
SECOND = (50 * MS, -1.5, 2.5, 0.25, 200, 0, 1)
NEXT = (0, 9.0, 9.0, 9.0, 1, 0, 0)
REST = (0.01, -0.02, 0.03), (0.0, 0.0, 1.0)


def read(
    path: Path, settings: LivoxSettings = ALL_POINTS, bag: BagSettings | None = None
) -> tuple[list[SensorEvent], RecordingSummary]:
    recording = open_recording(path, settings, bag)
    return list(recording.events()), recording.summary()


def two_frames(messages: Messages) -> list[tuple[str, int, object]]:
    """One frame that fills a period of sensor time, and the first point of the next."""
    return [
        ("/livox/lidar", START_NS + 100 * MS, messages.custom(START_NS, [FIRST, SECOND])),
        ("/livox/lidar", START_NS + 200 * MS, messages.custom(START_NS + 100 * MS, [NEXT])),
    ]


@pytest.mark.parametrize("bag_format", ["rosbag1", "rosbag2", "rosbag2-mcap"])
def test_what_the_emulator_wrote_comes_back(tmp_path: Path, bag_format: BagFormat) -> None:
    path = tmp_path / "bag"
    write_bag(path, datagrams(), LIDAR_IP, bag_format)
    events, summary = read(path, SETTINGS)
    expected = received(datagrams())
    assert (summary.kind[:5], summary.complete, summary.skipped) == (f"ROS {bag_format[6]}", True, {})
    assert summary.sensor == "/livox/lidar and /livox/imu"
    # The driver leaves the last frame open; its stamps are up to 5 us early, so points change scans.
    sent, back = scans(expected), scans(events)
    assert len(back) in (len(sent), len(sent) - 1)
    n = sum(len(scan.offsets_ns) for scan in back)
    sent_points = np.concatenate([scan.points_lidar for scan in sent])[:n]
    np.testing.assert_array_equal(np.concatenate([scan.points_lidar for scan in back]), sent_points)
    sent_ns = np.concatenate([scan.t_sensor_start_ns + scan.offsets_ns for scan in sent])[:n]
    back_ns = np.concatenate([scan.t_sensor_start_ns + scan.offsets_ns for scan in back])
    assert np.abs(back_ns - sent_ns).max() <= 5_100
    assert all(np.array_equal(np.sort(scan.offsets_ns), scan.offsets_ns) for scan in back)
    for name in ("reflectivity", "tags"):
        whole = np.concatenate([getattr(scan, name) for scan in sent])[:n]
        np.testing.assert_array_equal(np.concatenate([getattr(scan, name) for scan in back]), whole)
    stamp_error_ns = 300 if bag_format == "rosbag1" else 0
    for sample, original in zip(samples(events), samples(expected), strict=True):
        assert abs(sample.t_sensor_ns - original.t_sensor_ns) <= stamp_error_ns
        assert sample.t_ns == original.t_ns
        np.testing.assert_array_equal(sample.gyro_imu, original.gyro_imu)
        np.testing.assert_allclose(sample.accel_imu, original.accel_imu, rtol=1e-14)


def test_host_stamps_are_those_of_reception(tmp_path: Path) -> None:
    path = tmp_path / "host.bag"
    write_bag(path, datagrams(0.3), LIDAR_IP, "rosbag1", stamps="host")
    events, _ = read(path, SETTINGS)
    assert all(abs(sample.t_sensor_ns - sample.t_ns) < 300 for sample in samples(events))
    assert all(scan.t_sensor_start_ns >= datagrams(0.3)[0].t_ns - 100 * MS for scan in scans(events))


def test_our_definition_of_the_message_is_the_vendor_s() -> None:
    messages = Messages(ros1=True)
    assert messages.store.generate_msgdef(messages.custom_type)[1] == CUSTOM_DIGEST


@BOTH
@pytest.mark.parametrize("package", ["livox_ros_driver2", "livox_ros_driver"])
def test_messages_serialised_by_the_library_are_read(tmp_path: Path, ros1: bool, package: str) -> None:
    messages = Messages(ros1=ros1, package=package)
    path = messages.write(
        tmp_path / "bag",
        ("/livox/imu", START_NS + 1 * MS, messages.inertial(START_NS + 0 * MS, *REST)),
        ("/livox/imu", START_NS + 6 * MS, messages.inertial(START_NS + 5 * MS, *REST)),
        *two_frames(messages),
    )
    events, summary = read(path)
    first, second, scan = events
    (sample,) = samples([second])
    assert (sample.t_ns, sample.t_sensor_ns) == (START_NS + 6 * MS, START_NS + 5 * MS)
    assert sample.gyro_imu.tolist() == [0.01, -0.02, 0.03]
    assert sample.accel_imu.tolist() == [0.0, 0.0, 9.80665]
    (scan,) = scans([scan])
    assert scan.points_lidar.tolist() == [[1.0, 2.0, 3.0], [-1.5, 2.5, 0.25]]
    assert scan.offsets_ns.tolist() == [0, 50 * MS]
    assert (scan.reflectivity.tolist(), scan.tags.tolist()) == ([10, 200], [16, 0])
    assert (scan.t_ns, scan.t_sensor_start_ns) == (START_NS + 100 * MS, START_NS)
    assert scan.clock_offset_ns == first.t_ns - START_NS == MS
    assert summary.notes == ("accelerations are in g (median 1.000 at the start), converted to m/s^2",)


LIVOX_CLOUD = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("intensity", "<f4"),
        ("tag", "u1"),
        ("line", "u1"),
        ("t", "<f8"),
    ]
)
LIVOX_FIELDS = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7), ("tag", 16, 2), ("line", 17, 2)]


@BOTH
@pytest.mark.parametrize("unit_ns", [1.0, 1e9], ids=["nanoseconds", "seconds"])
def test_point_clouds_with_a_time_for_each_point_are_read(tmp_path: Path, ros1: bool, unit_ns: float) -> None:
    messages = Messages(ros1=ros1)
    stamps = [(START_NS + ms * MS) / unit_ns for ms in (0, 50, 99, 101)]
    rows = [(1.0 + i, 2.0, 3.0, 10.0 * i, 16, i, stamp) for i, stamp in enumerate(stamps)]
    cloud = messages.cloud(START_NS, np.array(rows, LIVOX_CLOUD), [*LIVOX_FIELDS, ("timestamp", 18, 8)])
    path = messages.write(tmp_path / "bag", ("/livox/lidar", START_NS + 102 * MS, cloud))
    (event,), summary = read(path)
    (scan,) = scans([event])
    assert scan.points_lidar.tolist() == [[1.0, 2.0, 3.0], [2.0, 2.0, 3.0], [3.0, 2.0, 3.0]]
    # Stamps of today in doubles resolve 256 ns.
    assert np.abs(scan.offsets_ns - [0, 50 * MS, 99 * MS]).max() <= 256
    assert (scan.reflectivity.tolist(), scan.tags.tolist()) == ([0, 10, 20], [16, 16, 16])
    assert summary.notes == ("the recording has no inertial samples: scans only",)


def test_a_point_cloud_without_times_is_refused(tmp_path: Path) -> None:
    messages = Messages(ros1=False)
    cloud = messages.cloud(START_NS, np.zeros(3, LIVOX_CLOUD), LIVOX_FIELDS)
    path = messages.write(tmp_path / "bag", ("/points", START_NS, cloud))
    with pytest.raises(LogError, match="/points cannot be used: a point cloud without a time for each point"):
        open_recording(path)


@pytest.mark.parametrize(
    ("accel_z", "unit", "expected"),
    [(1.0, "auto", 9.80665), (9.7, "auto", 9.7), (4.0, "g", 4.0 * 9.80665), (1.0, "m/s^2", 1.0)],
)
def test_accelerations_become_si_once(tmp_path: Path, accel_z: float, unit: str, expected: float) -> None:
    messages = Messages(ros1=False)
    inertial = messages.inertial(START_NS, (0.0, 0.0, 0.0), (0.0, 0.0, accel_z))
    path = messages.write(tmp_path / "bag", ("/livox/imu", START_NS, inertial), *two_frames(messages))
    events, _ = read(path, bag=BagSettings.model_validate({"acceleration_unit": unit}))
    assert samples(events)[0].accel_imu[2] == pytest.approx(expected, rel=1e-15)


def test_accelerations_of_no_known_unit_are_refused(tmp_path: Path) -> None:
    messages = Messages(ros1=False)
    inertial = messages.inertial(START_NS, (0.0, 0.0, 0.0), (0.0, 0.0, 981.0))
    path = messages.write(tmp_path / "bag", ("/imu", START_NS, inertial), *two_frames(messages))
    with pytest.raises(LogError, match=r"accelerations of 981 on /imu are neither 1 g nor 9\.81 m/s\^2"):
        open_recording(path)


def test_the_imu_beside_the_points_is_preferred_and_said(tmp_path: Path) -> None:
    messages = Messages(ros1=True)
    path = messages.write(
        tmp_path / "bag",
        ("/mavros/imu/data", START_NS, messages.inertial(START_NS, (9.0, 9.0, 9.0), (0.0, 0.0, 9.8))),
        ("/livox/imu", START_NS, messages.inertial(START_NS, *REST)),
        *two_frames(messages),
    )
    events, summary = read(path)
    assert [sample.gyro_imu[0] for sample in samples(events)] == [0.01]
    assert summary.notes[0] == "inertial samples are taken from /livox/imu, not from /mavros/imu/data"
    events, _ = read(path, bag=BagSettings(imu_topic="/mavros/imu/data"))
    assert [sample.gyro_imu[0] for sample in samples(events)] == [9.0]


def test_topics_among_which_nobody_can_choose_are_listed(tmp_path: Path) -> None:
    messages = Messages(ros1=False)
    frame = messages.custom(START_NS, [FIRST])
    path = messages.write(tmp_path / "bag", ("/front", 1, frame), ("/rear", 2, frame))
    with pytest.raises(
        LogError, match="several topics with points: /front, /rear; choose one with points_topic"
    ):
        open_recording(path)
    assert open_recording(path, bag=BagSettings(points_topic="/rear")).summary().sensor == "/rear"
    with pytest.raises(LogError, match="no topic /side with points; there is /front, /rear"):
        open_recording(path, bag=BagSettings(points_topic="/side"))


def test_a_bag_without_points_says_what_it_holds(tmp_path: Path) -> None:
    messages = Messages(ros1=True)
    path = messages.write(tmp_path / "bag", ("/imu", 1, messages.inertial(START_NS, *REST)))
    with pytest.raises(
        LogError, match="no topic with CustomMsg or PointCloud2; the bag holds sensor_msgs/msg/Imu"
    ):
        open_recording(path)


def test_a_database_without_definitions_is_read_as_older_recorders_wrote_it(tmp_path: Path) -> None:
    messages = Messages(ros1=False)
    path = tmp_path / "old.db3"
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
    database.execute("CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    database.execute("INSERT INTO topics VALUES(1, '/livox/lidar', ?, 'cdr')", (messages.custom_type,))
    for number, (_, t_ns, message) in enumerate(two_frames(messages)):
        row = number, t_ns, messages.serialised(message)
        database.execute("INSERT INTO messages VALUES(?, 1, ?, ?)", row)
    database.commit()
    database.close()
    events, _ = read(path)
    assert [len(scan.offsets_ns) for scan in scans(events)] == [2]


def test_points_follow_the_header_s_clock_where_the_time_base_is_another(tmp_path: Path) -> None:
    messages = Messages(ros1=True)
    path = messages.write(
        tmp_path / "bag",
        ("/livox/lidar", 1, messages.custom(START_NS, [FIRST, SECOND], base_ns=START_NS - 2 * 10**9)),
        ("/livox/lidar", 2, messages.custom(START_NS + 100 * MS, [NEXT], base_ns=START_NS - 19 * 10**8)),
    )
    events, summary = read(path)
    assert scans(events)[0].t_sensor_start_ns == START_NS
    assert "time base and header stamp are -2.000 s apart: the header's clock was used" in summary.notes


def test_frames_of_any_length_are_cut_into_the_same_scans(tmp_path: Path) -> None:
    messages = Messages(ros1=True)
    points = [(float(i), 1.0, 1.0) for i in range(1, 41)]

    def bag(name: str, per_message: int) -> Path:
        records = []
        for first in range(0, 40, per_message):
            part = points[first : first + per_message]
            made = [(i * 10 * MS, *point, 0, 0, 0) for i, point in enumerate(part)]
            t_ns = START_NS + first * 10 * MS
            records.append(("/livox/lidar", t_ns + 100 * MS, messages.custom(t_ns, made)))
        return messages.write(tmp_path / name, *records)

    runs = [scans(read(bag(str(n), n))[0]) for n in (1, 4, 7, 25)]
    assert [scan.points_lidar[:, 0].tolist() for scan in runs[0]] == [
        list(range(1 + 10 * n, 11 + 10 * n)) for n in range(3)
    ]
    for run in runs[1:]:
        assert [scan.points_lidar.tolist() for scan in run] == [
            scan.points_lidar.tolist() for scan in runs[0]
        ]


def test_late_and_undecodable_messages_are_counted(tmp_path: Path) -> None:
    messages = Messages(ros1=False)
    first, following = two_frames(messages)
    far = messages.custom(START_NS + 100 * MS, [(2 * 10**9, 1.0, 1.0, 1.0, 0, 0, 0)])
    late = (first[0], START_NS + 201 * MS, first[2])
    path = messages.write(
        tmp_path / "bag", first, following, late, ("/livox/lidar", START_NS + 202 * MS, far)
    )
    _, summary = read(path)
    assert summary.skipped == {
        "late points": 2,
        "messages: a point more than a second from its frame's begin": 1,
    }


def test_a_clock_that_starts_again_does_not_swallow_the_rest(tmp_path: Path) -> None:
    messages = Messages(ros1=False)
    early = [
        (topic, t_ns + 10**9, messages.custom(t_ns - 60 * 10**9, [FIRST, SECOND]))
        for topic, t_ns, _ in two_frames(messages)
    ]
    path = messages.write(tmp_path / "bag", *two_frames(messages), *early)
    events, summary = read(path)
    starts = [scan.t_sensor_start_ns for scan in scans(events)]
    assert starts[0] == START_NS
    assert starts[1] < START_NS - 59 * 10**9
    assert summary.skipped == {"steps of the clock backwards": 1}


def test_without_the_library_one_sentence_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "some.bag"
    path.write_bytes(b"#ROSBAG V2.0\n")
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(LogError, match=r"needs the package rosbags: pip install 'companion\[recordings\]'"):
        open_recording(path)


@pytest.mark.parametrize("content", [b"#ROSBAG V2.0\n", b"SQLite format 3\0", b"\x89MCAP0\r\n"])
def test_a_bag_that_ends_after_its_first_bytes_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "short"
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"cannot be read as a ROS [12] bag"):
        open_recording(path)


def test_a_folder_that_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"a folder without metadata\.yaml is no ROS 2 bag"):
        open_recording(tmp_path)


@pytest.mark.parametrize("bag_format", ["rosbag1", "rosbag2", "rosbag2-mcap"])
def test_the_library_itself_understands_what_the_emulator_wrote(
    tmp_path: Path, bag_format: BagFormat
) -> None:
    path = tmp_path / ("out.bag" if bag_format == "rosbag1" else "out")
    write_bag(path, datagrams(0.3), LIDAR_IP, bag_format)
    found: dict[str, list[Any]] = {"/livox/lidar": [], "/livox/imu": []}
    with AnyReader([path]) as reader:
        if bag_format == "rosbag1":
            digests = {item.topic: item.digest for item in reader.connections}
            assert digests == {
                "/livox/lidar": CUSTOM_DIGEST,
                "/livox/imu": "6a62c6daae103f4ff57a132d6f95cec2",
            }
        for connection, _, data in reader.messages():
            found[connection.topic].append(reader.deserialize(data, connection.msgtype))
    first = next(sent for sent in datagrams(0.3) if sent.source[1] == 56300)
    decoded = decode_points(np.frombuffer(first.payload, np.uint8)[None, :])
    frame = found["/livox/lidar"][0]
    assert (frame.timebase, frame.point_num) == (0, len(frame.points))
    assert (frame.header.frame_id, frame.header.stamp.sec, frame.lidar_id) == ("livox_frame", 0, 192)
    for index, point in enumerate(frame.points[:96]):
        assert [point.x, point.y, point.z] == decoded.points_lidar[index].tolist()
        assert (point.reflectivity, point.tag) == (decoded.reflectivity[index], decoded.tags[index])
        assert (point.line, point.offset_time) == (index % 4, index * 4947)
    inertial, sample = found["/livox/imu"][1], samples(received(datagrams(0.3)))[1]
    assert inertial.header.stamp.nanosec == 10_000_000
    gyro, accel = inertial.angular_velocity, inertial.linear_acceleration
    assert [gyro.x, gyro.y, gyro.z] == sample.gyro_imu.tolist()
    assert [accel.x, accel.y, accel.z] == pytest.approx(list(sample.accel_imu / 9.80665))
