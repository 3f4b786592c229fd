import re
import struct
from collections.abc import Callable, Iterable
from itertools import count
from pathlib import Path

import pytest

from companion.drivers.livox_settings import LivoxSettings
from companion.errors import LogError
from companion.messages import Datagram
from companion.recordings.capture_frames import Frame
from companion.recordings.link_layers import Skip, datagram_of
from companion.recordings.source import open_recording, read_events
from sitl.recording_writers.captures import ethernet_frame, write_pcap, write_pcapng
from tests.recordings.emulated import SETTINGS, datagrams, identical, received

Writer = Callable[[Path, Iterable[Datagram]], None]
PAYLOAD = b"payload"
DATAGRAM = Datagram(5, ("192.168.1.150", 56300), ("192.168.1.50", 56301), PAYLOAD)


@pytest.mark.parametrize(("write", "kind"), [(write_pcap, "pcap"), (write_pcapng, "pcapng")])
def test_a_capture_gives_the_very_events_that_flew(tmp_path: Path, write: Writer, kind: str) -> None:
    path = tmp_path / "recording"
    write(path, datagrams())
    recording = open_recording(path, SETTINGS)
    assert identical(list(recording.events()), received(datagrams()))
    summary = recording.summary()
    assert (summary.kind, summary.complete, summary.lost) == (kind, True, 0)
    assert (summary.scans, summary.imu_samples) == (9, 200)
    assert summary.skipped == {"other packets": 2}


def pcap(order: str, magic: int, units_per_s: int, link_type: int, frames: list[bytes]) -> bytes:
    ticks = count(1_500_000_000 * units_per_s + 7)
    records = [
        struct.pack(f"{order}IIII", *divmod(tick, units_per_s), len(frame), len(frame)) + frame
        for tick, frame in zip(ticks, frames, strict=False)
    ]
    return struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65535, link_type) + b"".join(records)


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize(("magic", "units_per_s"), [(0xA1B2C3D4, 1_000_000), (0xA1B23C4D, 1_000_000_000)])
def test_both_byte_orders_and_resolutions_are_read(
    tmp_path: Path, order: str, magic: int, units_per_s: int
) -> None:
    inertial = [datagram for datagram in datagrams() if datagram.source[1] == 56400][:3]
    path = tmp_path / "capture"
    path.write_bytes(pcap(order, magic, units_per_s, 1, [ethernet_frame(sent) for sent in inertial]))
    times = [event.t_ns for event in read_events(path, SETTINGS)]
    assert times == [1_500_000_000 * 10**9 + (7 + n) * (10**9 // units_per_s) for n in range(3)]


IP_PACKET = ethernet_frame(DATAGRAM)[14:]
MACS = bytes(12)
LINKS = {
    "Ethernet": (1, MACS + b"\x08\x00"),
    "one VLAN tag": (1, MACS + bytes.fromhex("8100 0005 0800")),
    "two VLAN tags": (1, MACS + bytes.fromhex("88a8 0005 8100 0006 0800")),
    "Linux cooked": (113, bytes.fromhex("0000 0001 0006 020000000001 0000 0800")),
    "Linux cooked, version 2": (276, bytes.fromhex("0800 0000 00000002 0001 00 06 0200000000010000")),
    "raw IP": (101, b""),
    "raw IPv4": (228, b""),
    "BSD loopback, little-endian": (0, b"\x02\x00\x00\x00"),
    "BSD loopback, big-endian": (0, b"\x00\x00\x00\x02"),
    "OpenBSD loopback": (108, b"\x00\x00\x00\x02"),
}


@pytest.mark.parametrize(("link_type", "head"), LINKS.values(), ids=LINKS)
def test_every_usual_link_layer_is_unpacked(link_type: int, head: bytes) -> None:
    assert datagram_of(Frame(5, link_type, head + IP_PACKET, True)) == DATAGRAM


def test_options_of_ipv4_and_padding_of_ethernet_are_passed_over() -> None:
    options = b"\x46" + IP_PACKET[1:2] + struct.pack(">H", len(IP_PACKET) + 4) + IP_PACKET[4:20] + bytes(4)
    frame = LINKS["Ethernet"][1] + options + IP_PACKET[20:] + bytes(11)
    assert datagram_of(Frame(5, 1, frame, True)) == DATAGRAM


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (Frame(5, 147, IP_PACKET, True), Skip.LINK),
        (Frame(5, 101, b"\x60" + IP_PACKET[1:], True), Skip.OTHER),
        (Frame(5, 101, IP_PACKET[:9] + b"\x06" + IP_PACKET[10:], True), Skip.OTHER),
        (Frame(5, 101, IP_PACKET[:6] + b"\x20\x00" + IP_PACKET[8:], True), Skip.FRAGMENT),
        (Frame(5, 101, IP_PACKET[:6] + b"\x00\x10" + IP_PACKET[8:], True), Skip.FRAGMENT),
        (Frame(None, 101, IP_PACKET, True), Skip.NO_TIME),
        (Frame(5, 101, IP_PACKET[:-1], False), Skip.CUT),
        (Frame(5, 101, IP_PACKET[:24], False), Skip.CUT),
        (Frame(5, 101, IP_PACKET[:12], False), Skip.CUT),
        (Frame(5, 101, IP_PACKET[:-1], True), Skip.MALFORMED),
        (Frame(5, 101, IP_PACKET[:24] + b"\x00\x07" + IP_PACKET[26:], True), Skip.MALFORMED),
        (Frame(5, 101, IP_PACKET[:24] + b"\xff\xff" + IP_PACKET[26:], True), Skip.MALFORMED),
        (Frame(5, 101, b"\x41" + IP_PACKET[1:], True), Skip.MALFORMED),
    ],
)
def test_what_is_no_datagram_is_skipped_with_its_reason(frame: Frame, reason: Skip) -> None:
    assert datagram_of(frame) is reason


def test_a_cut_capture_is_read_up_to_the_cut(tmp_path: Path) -> None:
    path = tmp_path / "capture.pcap"
    write_pcap(path, datagrams())
    path.write_bytes(path.read_bytes()[:1_000_000])
    recording = open_recording(path, SETTINGS)
    events = list(recording.events())
    assert len(events) > 50
    assert identical(events, received(datagrams())[: len(events)])
    summary = recording.summary()
    assert not summary.complete
    assert re.search(r": byte 99\d{4}: the file ends within a packet$", summary.notes[-1])


def test_a_capture_cut_by_its_snapshot_length_says_so(tmp_path: Path) -> None:
    whole, path = ethernet_frame(datagrams()[0]), tmp_path / "capture.pcap"
    inertial = next(datagram for datagram in datagrams() if datagram.source[1] == 56400)
    content = pcap("<", 0xA1B2C3D4, 1_000_000, 1, [ethernet_frame(inertial)])
    path.write_bytes(content + struct.pack("<IIII", 1_500_000_001, 0, 96, len(whole)) + whole[:96])
    assert open_recording(path, SETTINGS).summary().skipped == {Skip.CUT.value: 1}


def test_the_configured_sensor_is_read_among_several(tmp_path: Path) -> None:
    path = tmp_path / "two.pcap"
    both = datagrams(0.3) + datagrams(0.3, "192.168.1.151")
    write_pcap(path, sorted(both, key=lambda datagram: datagram.t_ns))
    recording = open_recording(path, SETTINGS)
    assert identical(list(recording.events()), received(datagrams(0.3)))
    assert recording.summary().skipped["packets of the sensor 192.168.1.151"] > 600


def test_the_only_sensor_is_read_whatever_its_address(tmp_path: Path) -> None:
    path = tmp_path / "one.pcap"
    write_pcap(path, datagrams(0.3))
    recording = open_recording(path, LivoxSettings(lidar_ip="192.168.1.3"))
    assert recording.summary().sensor == SETTINGS.lidar_ip
    assert identical(list(recording.events()), received(datagrams(0.3)))


def test_several_sensors_of_which_none_is_configured_are_listed(tmp_path: Path) -> None:
    path = tmp_path / "two.pcap"
    write_pcap(path, datagrams(0.1) + datagrams(0.1, "192.168.1.151"))
    with pytest.raises(LogError, match=r"holds the sensors 192\.168\.1\.150, 192\.168\.1\.151, but not"):
        open_recording(path, LivoxSettings(lidar_ip="192.168.1.3"))


def test_a_capture_without_a_sensor_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "none.pcap"
    write_pcap(path, [Datagram(5, ("10.0.0.1", 53), ("10.0.0.2", 53), b"")])
    with pytest.raises(LogError, match="1 packets, none of them from port 56300 or 56400"):
        open_recording(path)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "byte 0: the file is empty"),
        (b"hello world", "byte 0: the file begins with 68 65 6c 6c"),
        (b"\x1f\x8b\x08\x00", "compressed with gzip: unpack it first"),
        (b"\xd4\xc3\xb2\xa1\x02\x00", "byte 0: no complete PCAP header"),
        (pcap("<", 0xA1B2C3D4, 10, 1, []) + b"\xff" * 16, "byte 24: a packet of 4294967295 bytes"),
        (b"\x0a\x0d\x0d\x0a" + b"\xff" * 20, "byte 0: no PCAPNG block"),
    ],
)
def test_garbage_gets_one_sentence_with_its_place(tmp_path: Path, content: bytes, sentence: str) -> None:
    path = tmp_path / "garbage"
    path.write_bytes(content)
    with pytest.raises(LogError, match=sentence):
        open_recording(path)


def test_a_missing_file_is_missing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        open_recording(tmp_path / "nowhere.pcap")


def test_times_of_pcapng_follow_the_interface_s_resolution_and_offset(tmp_path: Path) -> None:
    def block(kind: int, body: bytes) -> bytes:
        size = struct.pack(">I", 12 + len(body))
        return struct.pack(">I", kind) + size + body + size

    frame = ethernet_frame(next(sent for sent in datagrams() if sent.source[1] == 56400))
    frame += bytes(-len(frame) % 4)
    resolution = struct.pack(">HHB3xHHq", 9, 1, 0x80 | 10, 14, 8, 1_600_000_000)
    section = struct.pack(">IHHq", 0x1A2B3C4D, 1, 0, -1)
    ticks = struct.pack(">IQII", 1, 3 * 1024 + 512, len(frame), len(frame))
    content = (
        block(0x0A0D0D0A, section)
        + block(1, struct.pack(">HHI", 1, 0, 0))
        + block(5, bytes(12))
        + block(1, struct.pack(">HHI", 1, 0, 0) + resolution)
        + block(6, ticks + frame)
        + block(3, struct.pack(">I", len(frame)) + frame)
    )
    path = tmp_path / "odd.pcapng"
    path.write_bytes(content)
    recording = open_recording(path)
    assert [event.t_ns for event in recording.events()] == [1_600_000_003_500_000_000]
    assert recording.summary().skipped == {Skip.NO_TIME.value: 1}
