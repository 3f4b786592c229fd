import struct
import tracemalloc
import zlib

import numpy as np
import pytest

from companion.drivers.livox_framing import LivoxReceiver
from companion.drivers.livox_packets import DataType
from companion.drivers.livox_settings import LivoxSettings, PointFormat
from companion.messages import Datagram, ImuSample, LidarScan, SensorEvent
from sitl.livox_stream import encode_inertial, encode_points
from sitl.slots import InertialSlot, PointSlots

LIDAR, HOST = "127.0.0.2", "127.0.0.1"
SETTINGS = LivoxSettings(lidar_ip=LIDAR, host_ip=HOST)
OFFSET_NS = 5_000_000_000
FRAME_NS = 100_000_000
SLOTS_PER_FRAME = 20_000


def slots(first_slot: int, packets: int) -> PointSlots:
    """Slots whose points carry their own number: x in centimetres, y the remainder, z 1 m."""
    index = np.arange(first_slot, first_slot + 96 * packets)
    points = np.stack([(index // 100 % 2_000) * 0.01, (index % 100) * 0.01, 1.0 + 0.0 * index], axis=-1)
    points[index % 5 == 0] = 0.0
    return PointSlots(first_slot, points, (index % 150).astype(np.uint8), np.zeros(index.size, np.uint8))


def packet_stream(
    packets: int,
    first_packet: int = 0,
    kind: DataType = DataType.CARTESIAN_32,
    counter: int = 65_000,
    shift_ns: int = 0,
) -> list[Datagram]:
    first_slot = 96 * first_packet
    payloads = encode_points(slots(first_slot, packets), kind, counter + first_packet, 0, shift_ns)
    source, destination = (LIDAR, 56_300), (HOST, 56_301)
    return [
        Datagram(OFFSET_NS + (first_packet + i) * 480_000 + 475_000, source, destination, payload)
        for i, payload in enumerate(payloads)
    ]


def imu(index: int, shift_ns: int = 0) -> Datagram:
    t_ns = index * 5_000_000
    sample = InertialSlot(t_ns, np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 9.80665]))
    payload = encode_inertial(sample, index, 0, shift_ns)
    return Datagram(OFFSET_NS + t_ns, (LIDAR, 56_400), (HOST, 56_401), payload)


def received(receiver: LivoxReceiver, datagrams: list[Datagram]) -> list[SensorEvent]:
    return [event for datagram in datagrams for event in receiver.receive(datagram)]


def scans(receiver: LivoxReceiver, datagrams: list[Datagram]) -> list[LidarScan]:
    return [event for event in received(receiver, datagrams) if isinstance(event, LidarScan)]


def test_frames_hold_every_returned_slot_of_their_time_exactly_once() -> None:
    found = scans(LivoxReceiver(SETTINGS), packet_stream(2_500))
    assert len(found) == 12
    for number, scan in enumerate(found):
        assert (scan.sequence, scan.t_sensor_start_ns) == (number, number * FRAME_NS)
        assert scan.t_sensor_end_ns == (number + 1) * FRAME_NS
        index = np.arange(number * SLOTS_PER_FRAME, (number + 1) * SLOTS_PER_FRAME)
        index = index[index % 5 != 0]
        assert np.array_equal(scan.offsets_ns, index * 5_000 - scan.t_sensor_start_ns)
        assert np.array_equal(scan.reflectivity, index % 150)
        np.testing.assert_allclose(scan.points_lidar[:, 0], (index // 100 % 2_000) * 0.01, atol=1e-5)
        assert scan.packets == scan.packets_expected
        assert scan.points_lidar.dtype == np.float32
        assert abs(scan.clock_offset_ns - OFFSET_NS) < 1_000


def test_a_frame_is_handed_out_with_the_packet_that_ends_it() -> None:
    receiver = LivoxReceiver(SETTINGS)
    stream = packet_stream(2_500)
    emitted_at = [i for i, datagram in enumerate(stream) if receiver.receive(datagram)]
    # Packet i carries slots 96 i to 96 i + 95; the frame's last slot is 20,000 k - 1.
    assert emitted_at == [(SLOTS_PER_FRAME * k - 1) // 96 for k in range(1, 13)]


def test_a_frame_whose_last_packet_is_lost_comes_with_the_next_frames_first_packet() -> None:
    receiver = LivoxReceiver(SETTINGS)
    stream = packet_stream(420)
    last = (SLOTS_PER_FRAME - 1) // 96
    found = scans(receiver, stream[:last] + stream[last + 1 :])
    assert [scan.packets_expected - scan.packets for scan in found] == [1, 1]
    assert found[0].t_ns == stream[last - 1].t_ns
    assert receiver.statistics().lost == 1


def test_a_long_gap_ends_the_open_frame_and_makes_no_empty_ones() -> None:
    receiver = LivoxReceiver(SETTINGS)
    found = scans(receiver, packet_stream(100) + packet_stream(2_100, first_packet=6_250))
    assert [scan.t_sensor_start_ns // FRAME_NS for scan in found] == [0, *range(30, 40)]
    assert receiver.statistics().lost == 6_150
    assert receiver.statistics().outages == 1


@pytest.mark.parametrize("seed", range(4))
def test_loss_duplicates_and_reordering_are_all_counted_and_points_stay_in_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stream = packet_stream(2_100)
    kept = [i for i in range(2_100) if rng.random() > 0.05 or i in (0, 2_099)]
    order = sorted(kept, key=lambda i: i + rng.uniform(0.0, 3.0) * (0 < i < 2_090))
    duplicated = [i for i in order for _ in range(1 + (rng.random() < 0.03))]
    receiver = LivoxReceiver(SETTINGS)
    found = scans(receiver, [stream[i] for i in duplicated])
    statistics = receiver.statistics()
    assert statistics.packets == len(kept)
    assert statistics.lost == 2_100 - len(kept)
    assert statistics.duplicates == len(duplicated) - len(order)
    assert statistics.reordered > 100
    assert statistics.clock_restarts == statistics.jumps == 0
    assert len(found) == 10
    assert all(np.all(np.diff(scan.offsets_ns) > 0) for scan in found)


def test_inertial_samples_are_in_si_units_and_never_go_back_in_time() -> None:
    receiver = LivoxReceiver(SETTINGS)
    stream = [imu(i) for i in (0, 1, 3, 2, 3, 4)]
    samples = received(receiver, stream)
    assert all(isinstance(sample, ImuSample) for sample in samples)
    assert [getattr(sample, "t_sensor_ns", None) for sample in samples] == [
        0,
        5_000_000,
        15_000_000,
        20_000_000,
    ]
    first = samples[0]
    assert isinstance(first, ImuSample)
    np.testing.assert_allclose(first.accel_imu, [0.0, 0.0, 9.80665])
    np.testing.assert_allclose(first.gyro_imu, [0.1, 0.2, 0.3], rtol=1e-6)
    assert first.t_ns == stream[0].t_ns
    statistics = receiver.statistics()
    assert (statistics.imu_samples, statistics.duplicates, statistics.late) == (5, 1, 1)


def test_a_change_of_the_point_format_within_a_frame_is_decoded() -> None:
    receiver = LivoxReceiver(SETTINGS)
    formats = [DataType.CARTESIAN_32, DataType.SPHERICAL, DataType.CARTESIAN_16]
    stream = [d for i, kind in enumerate(formats) for d in packet_stream(100, 100 * i, kind)]
    (scan,) = scans(receiver, stream)
    index = np.arange(SLOTS_PER_FRAME)
    index = index[index % 5 != 0]
    assert np.array_equal(scan.offsets_ns, index * 5_000)
    np.testing.assert_allclose(scan.points_lidar[:, 0], (index // 100 % 2_000) * 0.01, atol=0.02)
    np.testing.assert_allclose(scan.points_lidar[:, 2], 1.0, atol=0.02)


@pytest.mark.parametrize("point_format", ["cartesian_32", "cartesian_16", "spherical"])
def test_all_formats_give_the_same_scan_within_their_resolution(point_format: PointFormat) -> None:
    kind = {"cartesian_32": DataType.CARTESIAN_32, "cartesian_16": DataType.CARTESIAN_16}.get(
        point_format, DataType.SPHERICAL
    )
    (scan,) = scans(LivoxReceiver(SETTINGS), packet_stream(210, kind=kind))
    (reference,) = scans(LivoxReceiver(SETTINGS), packet_stream(210))
    np.testing.assert_allclose(scan.points_lidar, reference.points_lidar, atol=0.006)


@pytest.mark.parametrize("shift_ns", [-1_000_000_000, -60_000_000, 1_000_000_000])
def test_a_clock_jump_restarts_frames_and_offset_and_is_counted_once_per_stream(shift_ns: int) -> None:
    receiver = LivoxReceiver(SETTINGS)
    before = packet_stream(4_200) + [imu(i) for i in range(403)]
    after = packet_stream(2_100, first_packet=4_200, shift_ns=shift_ns)
    after += [imu(i, shift_ns) for i in range(403, 600)]
    events = received(receiver, sorted(before, key=lambda d: d.t_ns))
    more = received(receiver, sorted(after, key=lambda d: d.t_ns))
    statistics = receiver.statistics()
    assert (statistics.clock_restarts, statistics.jumps) == (1, 2)
    assert (statistics.lost, statistics.imu_lost, statistics.late) == (0, 0, 0)
    assert abs(statistics.clock_offset_ns - OFFSET_NS + shift_ns) < 10_000
    assert sum(isinstance(event, LidarScan) for event in events) == 20
    complete = [e for e in more if isinstance(e, LidarScan) and e.packets == e.packets_expected]
    assert len(complete) >= 9


def test_a_restart_from_zero_is_followed_at_once() -> None:
    receiver = LivoxReceiver(SETTINGS)
    received(receiver, packet_stream(2_100, first_packet=10_000))
    outage_ns = 30_000_000_000
    restarted = [d._replace(t_ns=d.t_ns + outage_ns) for d in packet_stream(420, counter=0)]
    found = scans(receiver, restarted)
    assert [scan.t_sensor_start_ns for scan in found[-2:]] == [0, FRAME_NS]
    assert all(scan.packets == scan.packets_expected for scan in found[-2:])
    assert abs(found[-1].clock_offset_ns - OFFSET_NS - outage_ns) < 10_000
    assert receiver.statistics().clock_restarts == 1


def test_a_restart_whose_stamps_lie_ahead_of_the_old_ones_is_noticed() -> None:
    receiver = LivoxReceiver(SETTINGS)
    received(receiver, packet_stream(1_100, counter=0))
    power_off_ns = 1_000_000_000
    restarted = packet_stream(420, first_packet=1_100, counter=-1_100)
    found = scans(receiver, [d._replace(t_ns=d.t_ns + power_off_ns) for d in restarted])
    assert abs(found[-1].clock_offset_ns - OFFSET_NS - power_off_ns) < 10_000
    assert receiver.statistics().clock_restarts == 1


def test_datagrams_from_elsewhere_are_counted_and_ignored() -> None:
    receiver = LivoxReceiver(SETTINGS)
    good = packet_stream(1)[0]
    for source in [("127.0.0.3", 56_300), (LIDAR, 56_301), (HOST, 56_300)]:
        assert receiver.receive(good._replace(source=source)) == []
    assert receiver.statistics().wrong_source == 3
    # Points on the inertial port and the reverse are from the right source, and still wrong.
    receiver.receive(good._replace(source=(LIDAR, 56_400)))
    receiver.receive(imu(0)._replace(source=(LIDAR, 56_300)))
    assert receiver.statistics().malformed == 2
    assert receiver.statistics().packets == receiver.statistics().imu_samples == 0


def test_a_flood_within_one_frame_overflows_and_is_bounded() -> None:
    receiver = LivoxReceiver(SETTINGS)
    body = struct.pack("<Q", 0) + struct.pack("<iiiBB", 1_000, 0, 0, 1, 0)
    for index in range(2_000):
        stamped = struct.pack("<Q", index * 10_000) + body[8:]
        head = struct.pack("<BHHHHBBB12s", 0, 50, 0, 1, index, 0, 1, 0, bytes(12))
        payload = head + struct.pack("<I", zlib.crc32(stamped)) + stamped
        receiver.receive(Datagram(index * 10_000, (LIDAR, 56_300), (HOST, 56_301), payload))
    statistics = receiver.statistics()
    assert statistics.overflowed == 2_000 - 2 * 208 - 16


def test_mutated_and_random_datagrams_raise_nothing_and_take_no_memory() -> None:
    rng = np.random.default_rng(11)
    receiver = LivoxReceiver(LivoxSettings(lidar_ip=LIDAR, host_ip=HOST, frame_period_ms=10))
    originals = [d.payload for d in packet_stream(40)] + [imu(i).payload for i in range(10)]
    originals += [d.payload for d in packet_stream(20, 60, DataType.SPHERICAL)]
    noise = rng.integers(0, 256, 1 << 16, dtype=np.uint8).tobytes()
    count = 110_000
    choices = rng.integers(0, len(originals), count).tolist()
    places = rng.random(count).tolist()
    kinds = rng.integers(0, 5, count).tolist()
    ports = rng.choice([56_300, 56_400], count).tolist()
    for i in range(count):
        if i == count - 10_000:
            tracemalloc.start()
        payload = originals[choices[i]]
        at = int(places[i] * len(payload))
        if kinds[i] == 0:
            payload = payload[:at]
        elif kinds[i] == 1:
            payload = payload[:at] + bytes([payload[at] ^ (1 + i % 255)]) + payload[at + 1 :]
        elif kinds[i] == 2:
            payload = noise[at : at + 36 + i % 1_500]
        elif kinds[i] == 3:
            mutated = payload[:at] + noise[i % 60_000 : i % 60_000 + 4] + payload[at + 4 :]
            payload = mutated[:24] + struct.pack("<I", zlib.crc32(mutated[28:])) + mutated[28:]
        else:
            payload = payload + noise[: 1 + i % 40]
        receiver.receive_payload(OFFSET_NS + i * 10_000, (LIDAR, ports[i]), payload)
    growth = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert growth < 200_000
    statistics = receiver.statistics()
    assert statistics.malformed > 50_000
    assert statistics.crc_errors > 5_000
    assert statistics.packets > 1_000


def test_the_receiver_is_deterministic() -> None:
    def run() -> list[bytes]:
        found = scans(LivoxReceiver(SETTINGS), packet_stream(420))
        return [scan.points_lidar.tobytes() + scan.offsets_ns.tobytes() for scan in found]

    assert run() == run()
