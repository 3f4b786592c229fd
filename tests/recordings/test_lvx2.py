import re
import struct
from pathlib import Path

import numpy as np
import pytest

from companion.drivers.livox_packets import HEADER_SIZE, parse_header
from companion.drivers.livox_settings import LivoxSettings
from companion.errors import LogError
from companion.messages import Datagram
from companion.recordings.lvx2 import Lvx2Source
from companion.recordings.source import open_recording
from sitl.recording_writers.lvx2 import write_lvx2
from tests.drivers.livox_vectors import CARTESIAN_16_PACKET, CARTESIAN_32_PACKET, IMU_PACKET, SPHERICAL_PACKET
from tests.drivers.test_livox_packets import full_packet
from tests.recordings.emulated import LIDAR_IP, SETTINGS, datagrams, received, scans

# The layout as the vendor's specification tells it, field by field, independent of our writer.
PUBLIC_HEADER = b"livox_tech" + bytes(6) + bytes([2, 0, 0, 0]) + bytes.fromhex("67a70eac")
PRIVATE_HEADER = bytes.fromhex("32000000 01")
DEVICE = (
    b"47MDL3Q0020001\0\0"
    + bytes(16)
    + bytes([192, 168, 1, 101])
    + bytes([0, 9, 1])
    + struct.pack("<6f", 0.0, 0.0, 90.0, 0.1, 0.0, 0.2)
)
POINT = bytes.fromhex("e8030000 30f8ffff 2c010000 96 10")
STAMP = 1_700_000_000_123_456_789


def package(
    points: bytes, data_type: int = 1, counter: int = 0x0201, stamp: int = STAMP, time_type: int = 1
) -> bytes:
    return (
        b"\x00"
        + bytes([192, 168, 1, 101])
        + bytes([0, time_type])
        + stamp.to_bytes(8, "little")
        + counter.to_bytes(2, "little")
        + bytes([data_type])
        + len(points).to_bytes(4, "little")
        + bytes(5)
        + points
    )


def file_of(*packages: bytes, head: bytes = PUBLIC_HEADER + PRIVATE_HEADER + DEVICE) -> bytes:
    body = b"".join(packages)
    start = len(head)
    return head + struct.pack("<qqq", start, start + 24 + len(body), 0) + body


def test_blocks_have_the_sizes_of_the_specification() -> None:
    assert (len(PUBLIC_HEADER), len(PRIVATE_HEADER), len(DEVICE)) == (24, 5, 63)
    assert len(package(b"")) == 27


def test_a_package_becomes_the_packet_that_the_sensor_sent(tmp_path: Path) -> None:
    path = tmp_path / "hand.lvx2"
    path.write_bytes(file_of(package(POINT + bytes(14))))
    source = Lvx2Source(path, SETTINGS.lidar_ports)
    (datagram,) = source.datagrams()
    header = parse_header(datagram.payload)
    assert datagram.source == ("192.168.1.101", 56300)
    assert (header.t_sensor_ns, header.slots, header.span_ns) == (STAMP, 2, 5_000)
    assert (header.counter, header.data_type, header.time_type) == (0x0201, 1, 1)
    assert datagram.payload[HEADER_SIZE:] == POINT + bytes(14)
    assert datagram.t_ns == STAMP + 5_000
    assert source.notes == [
        "the file's extrinsic of 192.168.1.101 (serial 47MDL3Q0020001) is not applied: "
        "points stay in the sensor's frame"
    ]


@pytest.mark.parametrize(
    "packet",
    [
        bytes.fromhex(IMU_PACKET),
        bytes.fromhex(CARTESIAN_32_PACKET),
        bytes.fromhex(CARTESIAN_16_PACKET),
        full_packet(),
    ],
    ids=["imu", "cartesian 32", "cartesian 16", "full"],
)
def test_published_packets_survive_the_format_bit_for_bit(tmp_path: Path, packet: bytes) -> None:
    header = parse_header(packet)
    path = tmp_path / "published.lvx2"
    held = package(
        packet[HEADER_SIZE:], header.data_type, header.counter, header.t_sensor_ns, header.time_type
    )
    path.write_bytes(file_of(held))
    (datagram,) = Lvx2Source(path, SETTINGS.lidar_ports).datagrams()
    assert datagram.payload == packet


def test_what_the_emulator_wrote_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "emulated.lvx2"
    write_lvx2(path, datagrams(), LIDAR_IP)
    recording = open_recording(path, SETTINGS)
    events = list(recording.events())
    expected = scans(received(datagrams()))
    assert len(scans(events)) == len(events) == len(expected)
    for scan, sent in zip(scans(events), expected, strict=True):
        assert np.array_equal(scan.points_lidar, sent.points_lidar)
        assert np.array_equal(scan.offsets_ns, sent.offsets_ns)
        assert np.array_equal(scan.reflectivity, sent.reflectivity)
        assert np.array_equal(scan.tags, sent.tags)
        assert scan.t_sensor_start_ns == sent.t_sensor_start_ns
        assert (scan.packets, scan.packets_expected) == (sent.packets, sent.packets_expected)
    summary = recording.summary()
    assert (summary.lost, summary.complete, summary.sensor) == (0, True, LIDAR_IP)
    assert summary.notes == ("the recording has no inertial samples: scans only",)


def test_a_file_cut_within_a_package_is_read_up_to_the_cut(tmp_path: Path) -> None:
    path = tmp_path / "cut.lvx2"
    write_lvx2(path, datagrams(), LIDAR_IP)
    path.write_bytes(path.read_bytes()[:2_000_000])
    recording = open_recording(path, SETTINGS)
    assert len(list(recording.events())) == 6
    summary = recording.summary()
    assert not summary.complete
    assert re.search(r": byte 199\d{4}: the file ends within a package$", summary.notes[-1])


def test_one_of_several_devices_is_chosen_by_its_address(tmp_path: Path) -> None:
    other = package(POINT).replace(bytes([192, 168, 1, 101]), bytes([192, 168, 1, 102]))
    head = PUBLIC_HEADER + bytes.fromhex("32000000 02") + DEVICE + DEVICE
    path = tmp_path / "two.lvx2"
    path.write_bytes(file_of(package(POINT), other, head=head))
    with pytest.raises(LogError, match=r"holds the sensors 192\.168\.1\.101, 192\.168\.1\.102, but not"):
        open_recording(path)
    recording = open_recording(path, LivoxSettings(lidar_ip="192.168.1.102"))
    assert recording.summary().skipped == {"packets of the sensor 192.168.1.101": 1}


def test_packages_that_are_no_packets_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "odd.lvx2"
    path.write_bytes(
        file_of(package(POINT[:-1]), package(POINT, data_type=7), package(bytes(1358)), package(POINT))
    )
    source = Lvx2Source(path, SETTINGS.lidar_ports)
    assert len(list(source.datagrams())) == 1
    assert source.skipped == {"malformed packages": 3}


def test_a_hap_is_read_with_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "hap.lvx2"
    hap = bytearray(DEVICE)
    hap[37:39] = 10, 0
    path.write_bytes(file_of(package(POINT), head=PUBLIC_HEADER + PRIVATE_HEADER + bytes(hap)))
    assert "a device of type 10, read as if it were a Mid-360" in open_recording(path).summary().notes[0]


WHOLE = file_of(package(POINT))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (WHOLE[:20], "byte 0: no complete LVX2 header"),
        (WHOLE[:20] + bytes(4) + WHOLE[24:], "byte 0: no LVX2 header"),
        (WHOLE[:16] + b"\x01\x01" + WHOLE[18:], "byte 16: an LVX file of version 1.1; version 2 is known"),
        (WHOLE[:90], "byte 29: the file ends within the list of devices"),
        (WHOLE[:92] + bytes(24), "byte 92: a frame that claims to reach from 0 to 0"),
        (WHOLE[:110], "byte 92: the file ends within a frame's header"),
        (WHOLE[:116], "byte 116: the file ends within a frame"),
        (WHOLE[:140], "byte 116: the file ends within a frame"),
        (WHOLE[:150], "byte 116: the file ends within a package"),
        (WHOLE[:137] + b"\xff" + WHOLE[138:], "byte 116: a package of .* bytes reaches beyond its frame"),
        (WHOLE[:92], "no data of a Mid-360"),
    ],
)
def test_garbage_gets_one_sentence_with_its_place(tmp_path: Path, content: bytes, sentence: str) -> None:
    path = tmp_path / "garbage.lvx2"
    path.write_bytes(content)
    with pytest.raises(LogError, match=sentence):
        open_recording(path)


def test_spherical_points_have_no_place_in_the_format(tmp_path: Path) -> None:
    packet = Datagram(1, (LIDAR_IP, 56300), ("192.168.1.50", 56301), bytes.fromhex(SPHERICAL_PACKET))
    with pytest.raises(LogError, match="cartesian points only, not data type 3"):
        write_lvx2(tmp_path / "spherical.lvx2", [packet], LIDAR_IP)
