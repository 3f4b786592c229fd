from dataclasses import dataclass, field

import numpy as np
import pytest

from companion.drivers import livox_protocol as protocol
from companion.drivers.livox_handshake import LivoxHandshake
from companion.drivers.livox_protocol import BROADCAST_IP, Command, CommandFrame, Key, WorkState
from companion.drivers.livox_settings import LivoxSettings
from companion.drivers.livox_stage import Stage
from companion.messages import Datagram
from sitl.livox_emulator import LivoxEmulator, LivoxEmulatorSettings
from tests.drivers.livox_vectors import COMMANDS

LIDAR, HOST = "127.0.0.2", "127.0.0.1"
SETTINGS = LivoxSettings(lidar_ip=LIDAR, host_ip=HOST)
MS = 1_000_000
S = 1_000_000_000


@dataclass
class Conversation:
    """Host and emulated sensor on a cable that can be told to drop commands."""

    emulator: LivoxEmulator = field(default_factory=lambda: LivoxEmulator(LivoxEmulatorSettings()))
    settings: LivoxSettings = SETTINGS
    blocked: set[int] = field(default_factory=set)
    points_flow: bool | None = None
    imu_flows: bool | None = None
    loss: float = 0.0
    t_ns: int = 0

    def __post_init__(self) -> None:
        self.host = LivoxHandshake(self.settings, HOST)
        self.sent: list[CommandFrame] = []
        self.rng = np.random.default_rng(5)
        self._t_points_ns: int | None = None
        self._t_imu_ns: int | None = None

    def run(self, duration_ns: int) -> "Conversation":
        """Let both sides talk for a while, in steps of 10 ms."""
        for t_ns in range(self.t_ns, self.t_ns + duration_ns, 10 * MS):
            sampling = self.emulator.work_state(t_ns) is WorkState.SAMPLING
            if sampling if self.points_flow is None else self.points_flow:
                self._t_points_ns = t_ns
            if sampling if self.imu_flows is None else self.imu_flows:
                self._t_imu_ns = t_ns
            self.host.observe_data(self._t_points_ns, self._t_imu_ns)
            self._exchange(self.host.poll(t_ns))
            for push in self.emulator.poll(t_ns):
                assert self.host.receive(push) == []
        self.t_ns += duration_ns
        return self

    def _exchange(self, datagrams: list[Datagram]) -> None:
        while datagrams:
            replies: list[Datagram] = []
            for datagram in datagrams:
                frame = protocol.parse_frame(datagram.payload)
                self.sent.append(frame)
                if frame.command in self.blocked or self.rng.random() < self.loss:
                    continue
                for answer in self.emulator.receive(datagram):
                    if self.rng.random() >= self.loss:
                        replies += self.host.receive(answer)
            datagrams = replies


def test_the_conversation_ends_streaming_and_asks_for_the_right_things_in_order() -> None:
    talk = Conversation().run(1 * S)
    assert talk.host.stage is Stage.STREAMING
    assert talk.host.diagnosis() == f"the LiDAR at {LIDAR} streams points and IMU"
    writes = [frame for frame in talk.sent if frame.command == Command.SET_PARAMETERS]
    keys = [[key for key, _ in protocol.parse_parameters(frame.data)] for frame in writes]
    assert keys == [
        [Key.STATE_HOST, Key.POINT_HOST, Key.IMU_HOST],
        [Key.PCL_DATA_TYPE],
        [Key.WORK_TARGET],
        [Key.IMU_DATA_ENABLE],
    ]
    assert (talk.host.info.serial, talk.host.info.firmware_type) == ("AREMULATED0001", 1)
    assert talk.host.info.work_state == WorkState.SAMPLING
    assert talk.host.reruns == talk.host.malformed == 0
    assert all(1 <= frame.sequence <= 65_535 for frame in talk.sent)


def test_searches_go_to_the_configured_address_and_by_broadcast_if_wanted() -> None:
    first = LivoxHandshake(SETTINGS, HOST).poll(0)
    assert [(d.source[1], d.destination) for d in first] == [
        (56_000, (LIDAR, 56_000)),
        (56_000, (BROADCAST_IP, 56_000)),
        (56_101, (LIDAR, 56_100)),
    ]
    quiet = LivoxSettings(lidar_ip=LIDAR, host_ip=HOST, broadcast_search=False)
    assert len(LivoxHandshake(quiet, HOST).poll(0)) == 2


@pytest.mark.parametrize("seed", range(5))
def test_half_of_all_datagrams_lost_only_delay_the_start(seed: int) -> None:
    talk = Conversation(loss=0.5)
    talk.rng = np.random.default_rng(seed)
    assert talk.run(40 * S).host.stage is Stage.STREAMING


def test_requests_are_repeated_no_faster_than_the_timeout() -> None:
    talk = Conversation(blocked={Command.SEARCH, Command.GET_PARAMETERS}).run(5 * S)
    assert talk.host.stage is Stage.SEARCHING
    assert len(talk.sent) == 30


def test_a_lost_search_does_not_matter_when_commands_are_answered() -> None:
    assert Conversation(blocked={Command.SEARCH}).run(1 * S).host.stage is Stage.STREAMING


@pytest.mark.parametrize(
    ("blocked", "flows", "sentence"),
    [
        (
            {Command.SEARCH, Command.GET_PARAMETERS},
            (None, None),
            f"no answer to discovery from {LIDAR}: check power, cable",
        ),
        (
            {Command.GET_PARAMETERS, Command.SET_PARAMETERS},
            (None, None),
            f"the LiDAR at {LIDAR} was found, but does not answer commands on port 56100",
        ),
        (
            set[int](),
            (False, False),
            f"commands are answered, but no point data arrives from {LIDAR} on port 56301: a firewall",
        ),
        (set[int](), (True, False), f"points arrive, but no IMU data arrives from {LIDAR} on port 56401"),
        (
            set[int](),
            (False, True),
            f"IMU data arrives, but no point data arrives from {LIDAR} on port 56301",
        ),
    ],
)
def test_one_sentence_names_the_failed_stage(
    blocked: set[int], flows: tuple[bool | None, bool | None], sentence: str
) -> None:
    talk = Conversation(blocked=blocked, points_flow=flows[0], imu_flows=flows[1])
    for _ in range(8):
        talk.run(700 * MS)
        if talk.t_ns > 3 * S:
            assert talk.host.diagnosis().startswith(sentence)
    assert talk.host.stage is not Stage.STREAMING


def test_a_sensor_in_error_is_diagnosed_with_its_health_code() -> None:
    talk = Conversation().run(1 * S)
    talk.emulator.set_fault(0x0218_0004)
    talk.run(5 * S)
    assert talk.host.stage is not Stage.STREAMING
    assert "working state is error: scan module fails (fatal, 0x02180004)" in talk.host.diagnosis() or (
        "refused parameter 0x001a (not permitted" in talk.host.diagnosis()
    )
    talk.emulator.set_fault(0)
    assert talk.run(3 * S).host.stage is Stage.STREAMING


def test_a_slow_motor_is_waited_for_without_starting_again() -> None:
    emulator = LivoxEmulator(LivoxEmulatorSettings(self_check_s=3.0, motor_start_s=8.0))
    talk = Conversation(emulator).run(10 * S)
    assert talk.host.stage is Stage.AWAITING_DATA
    assert "working state is motor startup" in talk.host.diagnosis()
    assert talk.run(3 * S).host.stage is Stage.STREAMING
    assert talk.host.reruns == 0


def test_a_loader_is_named_and_never_passed_over() -> None:
    emulator = LivoxEmulator(LivoxEmulatorSettings(firmware_type="loader"))
    talk = Conversation(emulator).run(20 * S)
    assert talk.host.stage is Stage.IDENTIFYING
    assert "runs its loader only" in talk.host.diagnosis()


def test_after_a_power_cycle_the_conversation_runs_again() -> None:
    talk = Conversation()
    assert talk.run(2 * S).host.stage is Stage.STREAMING
    talk.emulator.power_cycle(5 * S)
    talk.points_flow = talk.imu_flows = False
    assert talk.run(3 * S).host.stage is Stage.SEARCHING
    talk.points_flow = talk.imu_flows = None
    assert talk.run(1 * S).host.stage is Stage.STREAMING
    assert talk.host.reruns == 1


@pytest.mark.parametrize("silent", ["points", "imu"])
def test_silence_of_either_stream_starts_the_conversation_again(silent: str) -> None:
    talk = Conversation().run(2 * S)
    talk.points_flow, talk.imu_flows = silent != "points", silent != "imu"
    talk.run(600 * MS)
    assert talk.host.reruns == 1


def test_silence_of_the_state_push_alone_starts_it_again_only_once() -> None:
    talk = Conversation().run(2 * S)
    pushes_blocked = LivoxEmulator(LivoxEmulatorSettings(persisted_host_ip=HOST, persisted_target="sampling"))
    talk.emulator = pushes_blocked
    talk.emulator.power_cycle(talk.t_ns)
    talk.emulator.poll = lambda t_ns: []  # type: ignore[method-assign]
    talk.run(10 * S)
    assert talk.host.stage is Stage.STREAMING
    assert talk.host.reruns == 1


def test_a_sensor_that_streams_without_answering_is_used_all_the_same() -> None:
    every = {Command.SEARCH, Command.GET_PARAMETERS, Command.SET_PARAMETERS}
    talk = Conversation(blocked={int(command) for command in every}, points_flow=True, imu_flows=True).run(
        5 * S
    )
    assert talk.host.stage is Stage.STREAMING
    assert "left the stage 'searching' unanswered" in talk.host.diagnosis()


def test_another_program_that_redirects_the_sensor_is_found_by_reading_back() -> None:
    talk = Conversation()
    honest = talk.emulator.receive

    def redirecting(datagram: Datagram) -> list[Datagram]:
        answers = honest(datagram)
        thief = protocol.StreamAddress("127.0.0.66", 56_301).pack()
        body = protocol.build_parameters([(Key.POINT_HOST, thief)])
        frame = protocol.build_frame(CommandFrame(9, Command.SET_PARAMETERS, False, False, body))
        honest(Datagram(datagram.t_ns, ("127.0.0.66", 1), (LIDAR, 56_100), frame))
        return answers

    talk.emulator.receive = redirecting  # type: ignore[method-assign]
    talk.points_flow = talk.imu_flows = False
    talk.run(3 * S)
    assert "keeps sending to 127.0.0.66:56301" in talk.host.diagnosis()
    talk.emulator.receive = honest  # type: ignore[method-assign]
    talk.points_flow = talk.imu_flows = None
    talk.run(2 * S)
    assert talk.host.stage is Stage.STREAMING


def test_a_refused_parameter_is_named_with_its_return_code() -> None:
    talk = Conversation()
    honest = talk.emulator.receive

    def refusing(datagram: Datagram) -> list[Datagram]:
        frame = protocol.parse_frame(datagram.payload)
        if frame.command != Command.SET_PARAMETERS:
            return honest(datagram)
        body = protocol.build_set_answer(0x03, 0x0005)
        payload = protocol.build_frame(CommandFrame(frame.sequence, frame.command, True, True, body))
        return [Datagram(datagram.t_ns, datagram.destination, datagram.source, payload)]

    talk.emulator.receive = refusing  # type: ignore[method-assign]
    talk.run(3 * S)
    assert talk.host.diagnosis() == (
        f"the LiDAR at {LIDAR} refused parameter 0x0005 (out of range, return code 0x03) while addressing"
    )


def test_a_sensor_at_another_address_is_named() -> None:
    host = LivoxHandshake(SETTINGS, HOST)
    host.poll(0)
    answer = bytes.fromhex(COMMANDS["search answer"])
    host.receive(Datagram(1, ("192.168.1.101", 56_000), (HOST, 56_000), answer))
    assert host.stage is Stage.SEARCHING
    assert "a LiDAR was heard at 192.168.1.101 (serial 47MDL3Q0020001)" in host.diagnosis()
    for i in range(300):
        host.receive(Datagram(1, (f"10.0.0.{i % 256}", 56_000), (HOST, 56_000), answer))
    assert host.diagnosis().count("serial") == 16


def test_garbage_and_unasked_answers_change_nothing() -> None:
    rng = np.random.default_rng(3)
    host = LivoxHandshake(SETTINGS, HOST)
    host.poll(0)
    frames = [bytes.fromhex(text) for text in COMMANDS.values()]
    for index in range(4_000):
        payload = bytearray(frames[index % len(frames)])
        payload[int(rng.integers(len(payload)))] ^= int(rng.integers(1, 256))
        frame = CommandFrame(
            int(rng.integers(4, 70_000)), int(rng.choice([0, 0x100, 0x101, 0x102])), True, True
        )
        for data in (bytes(payload), protocol.build_frame(frame), rng.bytes(int(rng.integers(80)))):
            host.receive(Datagram(index, (LIDAR, 56_100), (HOST, 56_101), data))
    assert host.stage is Stage.SEARCHING
    assert host.malformed > 5_000
