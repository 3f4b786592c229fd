import struct
from itertools import pairwise

import numpy as np
import pytest

from companion.drivers import livox_protocol as protocol
from companion.drivers.livox_packets import (
    HEADER_SIZE,
    POINT_DTYPES,
    DataType,
    decode_points,
    parse_header,
    parse_inertial,
)
from companion.drivers.livox_protocol import (
    BROADCAST_IP,
    Command,
    CommandFrame,
    Key,
    ReturnCode,
    StreamAddress,
    WorkState,
)
from companion.messages import Datagram
from sitl.livox_emulator import LivoxEmulator, LivoxEmulatorSettings
from sitl.livox_stream import encode_points
from sitl.slots import InertialSlot, PointSlots
from tests.drivers.livox_vectors import COMMANDS
from tests.sitl.livox_feed import ring_slots, still_sample

LIDAR, HOST = "127.0.0.2", "127.0.0.1"
BOOT_NS = 40_000_000_000
S = 1_000_000_000
REAL_PUSH_ORDER = (
    "0000 0001 0004 0005 0006 0007 0012 0015 0016 0017 0018 0019 001A 001C 0021 8000 8001 8002 8003 8004 "
    "8005 8006 8007 8008 8009 800A 800B 800C 800E 8010 8011"
)


def request(
    emulator: LivoxEmulator, command: int, body: bytes = b"", t_ns: int = BOOT_NS, port: int = 56_100
) -> bytes | None:
    """Send one request and return the body of its answer."""
    payload = protocol.build_frame(CommandFrame(77, command, False, False, body))
    answers = emulator.receive(Datagram(t_ns, (HOST, 56_101), (LIDAR, port), payload))
    if not answers:
        return None
    (answer,) = answers
    assert (answer.source, answer.destination, answer.t_ns) == ((LIDAR, port), (HOST, 56_101), t_ns)
    frame = protocol.parse_frame(answer.payload)
    assert (frame.sequence, frame.command, frame.acknowledges, frame.from_lidar) == (77, command, True, True)
    return frame.data


def write(emulator: LivoxEmulator, *parameters: tuple[int, bytes], t_ns: int = BOOT_NS) -> tuple[int, int]:
    body = request(emulator, Command.SET_PARAMETERS, protocol.build_parameters(parameters), t_ns)
    assert body is not None
    return protocol.parse_set_answer(body)


def read(emulator: LivoxEmulator, *keys: int, t_ns: int = BOOT_NS) -> tuple[int, dict[int, bytes]]:
    body = request(emulator, Command.GET_PARAMETERS, protocol.build_query(keys), t_ns)
    assert body is not None
    return protocol.parse_query_answer(body)


def streaming(**changes: object) -> LivoxEmulator:
    emulator = LivoxEmulator(LivoxEmulatorSettings.model_validate(changes), BOOT_NS)
    addresses = [(Key.POINT_HOST, 56_301), (Key.IMU_HOST, 56_401), (Key.STATE_HOST, 56_201)]
    packed = [(int(key), StreamAddress(HOST, port).pack()) for key, port in addresses]
    assert write(emulator, *packed, (Key.WORK_TARGET, b"\x01")) == (0, 0)
    return emulator


def test_a_search_is_answered_from_the_discovery_port_whether_unicast_or_broadcast() -> None:
    emulator = LivoxEmulator(LivoxEmulatorSettings())
    payload = bytes.fromhex(COMMANDS["search"])
    for ip in (LIDAR, BROADCAST_IP):
        (answer,) = emulator.receive(Datagram(5, (HOST, 56_000), (ip, 56_000), payload))
        assert (answer.source, answer.destination) == ((LIDAR, 56_000), (HOST, 56_000))
        found = protocol.parse_search_answer(protocol.parse_frame(answer.payload).data)
        assert (found.return_code, found.device_type, found.serial) == (0, 9, "AREMULATED0001")
        assert (found.lidar_ip, found.command_port) == (LIDAR, 56_100)
    assert emulator.receive(Datagram(5, (HOST, 56_000), ("127.0.0.9", 56_000), payload)) == []


def test_only_searches_are_answered_on_the_discovery_port() -> None:
    emulator = LivoxEmulator(LivoxEmulatorSettings())
    assert request(emulator, Command.GET_PARAMETERS, protocol.build_query([0x8010]), port=56_000) is None
    assert request(emulator, Command.SEARCH, port=56_100) == bytes([ReturnCode.NOT_SUPPORTED])
    assert request(emulator, Command.SEARCH, port=56_300) is None


@pytest.mark.parametrize(
    ("key", "value", "code"),
    [
        (Key.PCL_DATA_TYPE, b"\x03", ReturnCode.OK),
        (Key.PCL_DATA_TYPE, b"\x11", ReturnCode.OUT_OF_RANGE),
        (Key.PCL_DATA_TYPE, b"\x01\x00", ReturnCode.WRONG_LENGTH),
        (Key.DUAL_EMIT, b"\x01", ReturnCode.NOT_SUPPORTED),
        (Key.BLIND_SPOT, bytes(4), ReturnCode.NOT_SUPPORTED),
        (Key.IMU_RANGE, bytes(3), ReturnCode.NOT_SUPPORTED),
        (0x0BAD, b"\x00", ReturnCode.NOT_SUPPORTED),
        (Key.SERIAL, bytes(16), ReturnCode.READ_ONLY),
        (Key.WORK_TARGET, b"\x05", ReturnCode.OUT_OF_RANGE),
        (Key.LIDAR_ADDRESS, bytes(12), ReturnCode.NEEDS_REBOOT),
        (Key.FOV_0, struct.pack("<4iI", 0, 90, -7, 52, 0), ReturnCode.OK),
        (Key.FOV_0, struct.pack("<4iI", 0, 90, -70, 52, 0), ReturnCode.OUT_OF_RANGE),
    ],
)
def test_a_write_is_answered_with_the_protocols_return_code(key: int, value: bytes, code: int) -> None:
    emulator = LivoxEmulator(LivoxEmulatorSettings(), BOOT_NS)
    answer = write(emulator, (key, value))
    assert answer == (code, 0 if code == ReturnCode.OK else key)


def test_a_partly_bad_write_changes_nothing_and_names_the_first_bad_key() -> None:
    emulator = LivoxEmulator(LivoxEmulatorSettings(), BOOT_NS)
    bad = write(emulator, (Key.PCL_DATA_TYPE, b"\x02"), (Key.DUAL_EMIT, b"\x01"), (0x7777, b""))
    assert bad == (ReturnCode.NOT_SUPPORTED, Key.DUAL_EMIT)
    assert read(emulator, Key.PCL_DATA_TYPE) == (0, {Key.PCL_DATA_TYPE: b"\x01"})


def test_a_body_that_announces_another_number_of_keys_is_answered_so() -> None:
    emulator = LivoxEmulator(LivoxEmulatorSettings(), BOOT_NS)
    body = request(emulator, Command.SET_PARAMETERS, struct.pack("<HH", 2, 0) + b"\x1a\0\x01\0\x01")
    assert body == protocol.build_set_answer(ReturnCode.KEY_COUNT_MISMATCH)


def test_queries_answer_what_exists_and_refuse_what_does_not() -> None:
    emulator = LivoxEmulator(LivoxEmulatorSettings(), BOOT_NS)
    assert read(emulator, Key.FIRMWARE_TYPE) == (0, {Key.FIRMWARE_TYPE: b"\x01"})
    code, values = read(emulator, Key.SERIAL, 0x0BAD, Key.LOCAL_TIME, t_ns=BOOT_NS + 123)
    assert (code, values[Key.LOCAL_TIME]) == (0, struct.pack("<Q", 123))
    assert set(values) == {Key.SERIAL, Key.LOCAL_TIME}
    assert read(emulator, 0x0BAD) == (ReturnCode.NOT_SUPPORTED, {})
    assert read(emulator, *[Key.PRODUCT_INFO] * 30) == (ReturnCode.WRONG_LENGTH, {})


def test_other_commands_are_acknowledged_as_documented() -> None:
    emulator = LivoxEmulator(LivoxEmulatorSettings(), BOOT_NS)
    ok, refused = bytes([ReturnCode.OK]), bytes([ReturnCode.NOT_PERMITTED])
    assert request(emulator, Command.SET_RMC_TIME, bytes(9)) == ok
    assert request(emulator, Command.LOG_ENABLE, b"\0\1", port=56_500) == ok
    assert request(emulator, Command.LOG_TIME_SYNC, bytes(4), port=56_500) == ok
    assert request(emulator, Command.DEBUG_RAW_DATA, bytes(9), port=56_500) == ok
    assert request(emulator, Command.UPGRADE_START) == refused
    assert request(emulator, Command.FACTORY_RESET, bytes(16)) == bytes([ReturnCode.FAILURE])


def test_garbage_acknowledgements_and_foreign_frames_are_not_answered() -> None:
    emulator = LivoxEmulator(LivoxEmulatorSettings(), BOOT_NS)
    rng = np.random.default_rng(1)
    good = bytes.fromhex(COMMANDS["set sampling"])
    for index in range(3_000):
        payload = bytearray(good)
        payload[index % len(good)] ^= int(rng.integers(1, 256))
        assert emulator.receive(Datagram(BOOT_NS, (HOST, 1), (LIDAR, 56_100), bytes(payload))) == []
    assert emulator.malformed == 3_000
    for name in ("set answer", "push"):
        frame = bytes.fromhex(COMMANDS[name])
        assert emulator.receive(Datagram(BOOT_NS, (HOST, 1), (LIDAR, 56_100), frame)) == []


def test_the_state_is_pushed_once_a_second_in_a_real_units_order() -> None:
    emulator = LivoxEmulator(LivoxEmulatorSettings(), BOOT_NS)
    pushes = [d for t_ns in range(BOOT_NS, BOOT_NS + 5 * S, 10_000_000) for d in emulator.poll(t_ns)]
    assert [d.t_ns - BOOT_NS for d in pushes] == [0, S, 2 * S, 3 * S, 4 * S]
    assert {(d.source, d.destination) for d in pushes} == {((LIDAR, 56_200), (BROADCAST_IP, 56_201))}
    frame = protocol.parse_frame(pushes[1].payload)
    assert (frame.command, frame.acknowledges, frame.from_lidar) == (Command.PUSH, False, True)
    parameters = protocol.parse_parameters(frame.data)
    assert [key for key, _ in parameters] == [int(key, 16) for key in REAL_PUSH_ORDER.split()]
    assert len(pushes[1].payload) == 430
    assert dict(parameters)[Key.WORK_STATE] == bytes([WorkState.IDLE])


def test_working_states_follow_power_on_and_targets() -> None:
    settings = LivoxEmulatorSettings(self_check_s=3.0, motor_start_s=8.0)
    emulator = LivoxEmulator(settings, BOOT_NS)
    assert emulator.work_state(BOOT_NS + S) is WorkState.SELF_CHECK
    assert emulator.work_state(BOOT_NS + 4 * S) is WorkState.IDLE
    write(emulator, (Key.WORK_TARGET, b"\x09"), t_ns=BOOT_NS + 10 * S)
    assert emulator.work_state(BOOT_NS + 17 * S) is WorkState.MOTOR_STARTUP
    assert emulator.work_state(BOOT_NS + 18 * S) is WorkState.READY
    write(emulator, (Key.WORK_TARGET, b"\x01"), t_ns=BOOT_NS + 19 * S)
    assert emulator.work_state(BOOT_NS + 19 * S) is WorkState.SAMPLING
    emulator.set_fault(0x0218_0004)
    assert emulator.work_state(BOOT_NS + 20 * S) is WorkState.ERROR
    refused = write(emulator, (Key.WORK_TARGET, b"\x02"), t_ns=BOOT_NS + 20 * S)
    assert refused == (ReturnCode.NOT_PERMITTED, Key.WORK_TARGET)
    _, values = read(emulator, Key.HMS_CODES, t_ns=BOOT_NS + 20 * S)
    assert values[Key.HMS_CODES][:4] == struct.pack("<I", 0x0218_0004)
    emulator.set_fault(0)
    write(emulator, (Key.WORK_TARGET, b"\x02"), t_ns=BOOT_NS + 21 * S)
    assert emulator.work_state(BOOT_NS + 21 * S) is WorkState.IDLE


@pytest.mark.parametrize("kind", [DataType.CARTESIAN_32, DataType.CARTESIAN_16, DataType.SPHERICAL])
def test_slots_leave_in_packets_of_96_whatever_the_batches(kind: DataType) -> None:
    emulator = streaming()
    write(emulator, (Key.PCL_DATA_TYPE, bytes([kind])))
    sizes = [10, 86, 1, 200, 95, 0, 3, 1_000]
    datagrams, first = [], 0
    for size in sizes:
        datagrams += emulator.points(ring_slots(first, size))
        first += size
    assert len(datagrams) == sum(sizes) // 96
    headers = [parse_header(datagram.payload) for datagram in datagrams]
    for index, (header, datagram) in enumerate(zip(headers, datagrams, strict=True)):
        assert (header.counter, header.t_sensor_ns, header.span_ns) == (index, index * 480_000, 475_000)
        assert (header.data_type, header.slots) == (kind, 96)
        assert datagram.payload[9] == 0
        assert datagram.t_ns == BOOT_NS + header.t_sensor_ns + header.span_ns
        assert (datagram.source, datagram.destination) == ((LIDAR, 56_300), (HOST, 56_301))
    joined = np.frombuffer(b"".join(d.payload for d in datagrams), np.uint8).reshape(len(datagrams), -1)
    decoded = decode_points(joined)
    expected = ring_slots(0, 96 * len(datagrams))
    np.testing.assert_allclose(decoded.points_lidar, expected.points_lidar, atol=0.006)
    assert np.array_equal(decoded.reflectivity, expected.reflectivity)
    empty = ~expected.points_lidar.any(axis=1)
    assert not decoded.points_lidar[empty].any()


def test_lengths_are_rounded_to_millimetres_and_bounded_by_the_fields() -> None:
    points = np.random.default_rng(2).normal(0.0, 20.0, (96, 3))
    points[:3] = [[0.0005, -0.0005, 0.0015], [1e9, -1e9, 0.0], [2147483.647, -2147483.648, -0.0]]
    slots = PointSlots(96, points, np.arange(96, dtype=np.uint8), np.arange(96, dtype=np.uint8)[::-1].copy())
    (payload,) = encode_points(slots, DataType.CARTESIAN_32, 0, 0)
    written = np.frombuffer(payload, POINT_DTYPES[DataType.CARTESIAN_32], offset=HEADER_SIZE)
    assert np.array_equal(written["xyz"], np.clip(np.rint(points / 0.001), -(2.0**31), 2.0**31 - 1.0))
    assert np.array_equal(written["reflectivity"], slots.reflectivity)
    assert np.array_equal(written["tag"], slots.tags)


def test_the_packet_counter_runs_freely_through_its_16_bits() -> None:
    emulator = streaming()
    counters = []
    for first in range(0, 96 * 70_000, 96 * 10_000):
        batch = ring_slots(first, 96 * 10_000)
        counters += [int.from_bytes(d.payload[7:9], "little") for d in emulator.points(batch)]
    assert all((b - a) % 65_536 == 1 for a, b in pairwise(counters))


def test_inertial_samples_leave_in_units_of_g_at_their_own_time() -> None:
    emulator = streaming()
    (datagram,) = emulator.inertial(InertialSlot(7_000_000, np.ones(3), np.array([0.0, 0.0, 9.80665])))
    assert struct.unpack_from("<3f", datagram.payload, 48) == (0.0, 0.0, 1.0)
    assert parse_inertial(datagram.payload)[5] == pytest.approx(9.80665)
    assert datagram.t_ns == BOOT_NS + 7_000_000
    assert (datagram.source, datagram.destination) == ((LIDAR, 56_400), (HOST, 56_401))


def test_nothing_is_sent_without_destination_or_against_the_hosts_will() -> None:
    silent = LivoxEmulator(LivoxEmulatorSettings(persisted_target="sampling"), BOOT_NS)
    assert silent.points(ring_slots(0, 960)) == silent.inertial(still_sample(0)) == []
    emulator = streaming()
    write(emulator, (Key.IMU_DATA_ENABLE, b"\x00"), (Key.POINT_SEND, b"\x01"))
    assert emulator.points(ring_slots(0, 960)) == emulator.inertial(still_sample(0)) == []
    write(emulator, (Key.IMU_DATA_ENABLE, b"\x01"), (Key.POINT_SEND, b"\x00"), (Key.WORK_TARGET, b"\x09"))
    assert emulator.points(ring_slots(0, 960)) == emulator.inertial(still_sample(0)) == []


def test_slots_from_before_a_pause_never_join_those_after_it() -> None:
    emulator = streaming()
    assert emulator.points(ring_slots(0, 50)) == []
    (datagram,) = emulator.points(ring_slots(1_000, 96))
    assert parse_header(datagram.payload).t_sensor_ns == 5_000_000


def test_a_power_cycle_loses_the_destination_and_restarts_counters_and_time() -> None:
    emulator = streaming()
    assert emulator.points(ring_slots(0, 960))
    emulator.power_cycle(BOOT_NS + 60 * S)
    search = Datagram(BOOT_NS + 50 * S, (HOST, 1), (LIDAR, 56_000), bytes.fromhex(COMMANDS["search"]))
    assert emulator.receive(search) == emulator.poll(BOOT_NS + 50 * S) == []
    assert emulator.receive(search._replace(t_ns=BOOT_NS + 60 * S))
    assert emulator.points(ring_slots(0, 960)) == []
    address = StreamAddress(HOST, 56_301).pack()
    write(emulator, (Key.POINT_HOST, address), (Key.WORK_TARGET, b"\x01"), t_ns=BOOT_NS + 60 * S)
    first = emulator.points(ring_slots(0, 96))[0]
    header = parse_header(first.payload)
    assert (header.counter, header.t_sensor_ns) == (0, 0)
    assert first.t_ns == BOOT_NS + 60 * S + 475_000


def test_a_reboot_command_power_cycles_after_its_delay() -> None:
    emulator = streaming()
    assert request(emulator, Command.REBOOT, (100).to_bytes(2, "little")) == b"\x00"
    assert emulator.work_state(BOOT_NS + 99_000_000) is WorkState.SAMPLING
    assert emulator.work_state(BOOT_NS + 100_000_000) is WorkState.IDLE
    assert emulator.boot_host_ns == BOOT_NS + 100_000_000


def test_a_persisted_destination_makes_it_stream_unasked() -> None:
    settings = LivoxEmulatorSettings(persisted_host_ip=HOST, persisted_target="sampling", self_check_s=1.0)
    emulator = LivoxEmulator(settings, BOOT_NS)
    assert emulator.points(ring_slots(0, 9_600)) == []
    assert emulator.points(ring_slots(200_000, 9_600))[0].destination == (HOST, 56_301)
    assert emulator.poll(BOOT_NS)[0].destination == (HOST, 56_201)


def test_a_stepped_clock_moves_stamps_and_nothing_else() -> None:
    emulator = streaming()
    emulator.step_clock(2 * S)
    slots = PointSlots(0, np.zeros((96, 3)), np.zeros(96, np.uint8), np.zeros(96, np.uint8))
    (datagram,) = emulator.points(slots)
    assert parse_header(datagram.payload).t_sensor_ns == 2 * S
    assert datagram.t_ns == BOOT_NS + 475_000
