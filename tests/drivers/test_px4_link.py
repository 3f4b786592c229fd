"""MAVSDK as the carrier, on loopback against a small autopilot of pymavlink's frames."""

import asyncio
import socket
import threading
from collections.abc import Callable, Coroutine, Iterator
from typing import Any, TypeVar

import pytest

from companion.clock import SystemClock
from companion.drivers.mavlink_codec import MavlinkEncoder, MavlinkParser
from companion.drivers.px4 import Px4Link
from companion.drivers.px4_session import Px4Session
from companion.drivers.px4_settings import Px4Settings
from companion.errors import StartError
from companion.messages import FlightState, MavlinkMessage
from tests.drivers.px4_peer import MS, SECOND, STATION, SYSTEM, a_setpoint, an_odometry, heartbeat, settings
from tests.drivers.px4_peer import command as authorise
from tests.drivers.px4_peer import message as from_autopilot

FOREIGN = 42
_SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"
CLOCK = SystemClock()
_Result = TypeVar("_Result")


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Peer:
    """Sends heartbeats at 10 Hz for some systems, answers clock questions, keeps what arrives."""

    def __init__(self, port: int, systems: tuple[int, ...]) -> None:
        self._target = ("127.0.0.1", port)
        self.systems = list(systems)
        self.received: list[tuple[int, MavlinkMessage]] = []
        self._encoder, self._parser = MavlinkEncoder(), MavlinkParser()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.02)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="peer", daemon=True)
        self._thread.start()

    def send(self, message: MavlinkMessage) -> None:
        self._socket.sendto(self._encoder.encode(message), self._target)

    def close(self) -> None:
        self._stop.set()
        self._thread.join(5.0)
        self._socket.close()

    def names(self) -> list[str]:
        return [message.name for _, message in self.received]

    def find(self, name: str) -> list[MavlinkMessage]:
        return [message for _, message in self.received if message.name == name]

    def _run(self) -> None:
        due_ns = 0
        while not self._stop.is_set():
            now_ns = CLOCK.now_ns()
            if now_ns >= due_ns:
                due_ns = now_ns + 100 * MS
                for system_id in list(self.systems):
                    self.send(heartbeat(system_id=system_id))
            try:
                data, _ = self._socket.recvfrom(4096)
            except TimeoutError:
                continue
            for message in self._parser.feed(data):
                self.received.append((CLOCK.now_ns(), message))
                if message.name == "TIMESYNC" and message.fields["tc1"] == 0 and SYSTEM in self.systems:
                    answer = from_autopilot(
                        "TIMESYNC", tc1=CLOCK.now_ns() + SECOND, ts1=message.fields["ts1"]
                    )
                    self.send(answer)


class Bench:
    """A session, its link and a peer."""

    def __init__(self, *systems: int, **changes: object) -> None:
        port = free_port()
        self.settings: Px4Settings = settings(**{"url": f"udpin://127.0.0.1:{port}", **changes})
        self.session = Px4Session(self.settings)
        self.arrived: list[MavlinkMessage] = []
        self.replies: list[MavlinkMessage] = []
        self.link = Px4Link(self.settings, self.session, CLOCK, self._take)
        self.peer = Peer(port, systems)

    def _take(self, message: MavlinkMessage, t_ns: int) -> None:
        self.arrived.append(message)
        self.replies += self.session.receive(message, t_ns)

    async def live(self, seconds: float, *, setpoints: bool = False) -> None:
        """Poll and reply at 50 Hz."""
        end_ns = CLOCK.now_ns() + round(seconds * SECOND)
        while (now_ns := CLOCK.now_ns()) < end_ns:
            messages = self.session.poll(now_ns, FlightState.ACTIVE) + self.replies
            self.replies = []
            if setpoints:
                setpoint = self.session.setpoint(a_setpoint(now_ns), now_ns)
                assert setpoint is not None
                messages.append(setpoint)
            await self.link.send(messages)
            await CLOCK.sleep(20 * MS)


@pytest.fixture
def benches() -> Iterator[list[Bench]]:
    made: list[Bench] = []
    yield made
    for bench in made:
        bench.peer.close()


def run(bench: Bench, body: Coroutine[Any, Any, _Result]) -> _Result:
    async def bounded() -> _Result:
        try:
            return await asyncio.wait_for(body, 30.0)
        finally:
            await bench.link.stop()

    return asyncio.run(bounded())


async def until(condition: Callable[[], bool], bench: Bench, *, setpoints: bool = False) -> None:
    """Keep the link alive until `condition` holds."""
    end_ns = CLOCK.now_ns() + 20 * SECOND
    while not condition():
        assert CLOCK.now_ns() < end_ns, "it did not happen"
        await bench.live(0.04, setpoints=setpoints)


def test_the_configured_autopilot_is_chosen_although_a_foreign_one_speaks_first(
    benches: list[Bench],
) -> None:
    bench = Bench(FOREIGN)
    benches.append(bench)

    async def body() -> None:
        starting = asyncio.create_task(bench.link.start(15.0))
        while not any(m.system_id == FOREIGN for m in bench.arrived):
            await CLOCK.sleep(10 * MS)
        assert not starting.done()
        bench.peer.systems.append(SYSTEM)
        await starting
        await until(lambda: bench.session.statistics(CLOCK.now_ns()).clock_offset_ns is not None, bench)

    run(bench, body())
    state = bench.session.vehicle_state(CLOCK.now_ns())
    assert state.connected
    assert bench.session.foreign_autopilots() == [FOREIGN]
    offset = bench.session.statistics(CLOCK.now_ns()).clock_offset_ns
    assert offset is not None
    assert abs(offset - SECOND) < 100 * MS


def test_a_link_where_only_a_foreign_autopilot_speaks_is_refused_by_both_names(
    benches: list[Bench],
) -> None:
    bench = Bench(FOREIGN)
    benches.append(bench)
    with pytest.raises(StartError, match=rf"system id {SYSTEM} is silent .* only system id {FOREIGN}"):
        run(bench, bench.link.start(1.5))


def test_a_silent_link_is_refused(benches: list[Bench]) -> None:
    bench = Bench()
    benches.append(bench)
    with pytest.raises(StartError, match=rf"system id {SYSTEM} is silent on udpin"):
        run(bench, bench.link.start(0.3))


def test_a_link_that_cannot_be_opened_is_refused(benches: list[Bench]) -> None:
    bench = Bench(url="serial:///dev/no_such_port:921600")
    benches.append(bench)
    with pytest.raises(StartError, match="cannot open serial:///dev/no_such_port:921600"):
        run(bench, bench.link.start(1.0))


def test_a_stalled_event_loop_ends_the_setpoint_stream(benches: list[Bench]) -> None:
    bench = Bench(SYSTEM)
    benches.append(bench)
    stall: list[int] = []

    async def body() -> None:
        await bench.link.start(15.0)
        await until(lambda: bench.peer.names().count(_SETPOINT) >= 5, bench, setpoints=True)
        stall.append(CLOCK.now_ns())
        CLOCK.pause(round(1.5 * SECOND))
        stall.append(CLOCK.now_ns())
        before = bench.peer.names().count(_SETPOINT)
        await until(lambda: bench.peer.names().count(_SETPOINT) >= before + 5, bench, setpoints=True)

    run(bench, body())
    times = [t for t, m in bench.peer.received if m.name == _SETPOINT]
    # What left before the stall may still arrive in it; nothing is sent during it.
    assert [t for t in times if stall[0] + 500 * MS < t < stall[1]] == []


def test_only_true_heartbeats_reach_the_wire_and_all_of_them_from_our_component(
    benches: list[Bench],
) -> None:
    bench = Bench(SYSTEM)
    benches.append(bench)

    async def body() -> None:
        await bench.link.start(15.0)
        await bench.live(2.2)
        await until(lambda: bench.peer.names().count("HEARTBEAT") >= 3, bench)

    run(bench, body())
    beats = bench.peer.find("HEARTBEAT")
    assert {(m.system_id, m.component_id, m.fields["type"]) for m in beats} == {(SYSTEM, 191, 18)}
    assert {m.fields["system_status"] for m in beats} <= {2, 4}
    assert {(m.system_id, m.component_id) for _, m in bench.peer.received} == {(SYSTEM, 191)}


def test_odometry_commands_and_authorisations_pass_unchanged(benches: list[Bench]) -> None:
    bench = Bench(SYSTEM)
    benches.append(bench)

    async def body() -> None:
        await bench.link.start(15.0)
        await until(lambda: bench.session.statistics(CLOCK.now_ns()).clock_offset_ns is not None, bench)
        now_ns = CLOCK.now_ns()
        odometry = bench.session.odometry(an_odometry(now_ns), now_ns)
        assert odometry is not None
        asked = MavlinkMessage(
            "COMMAND_LONG",
            SYSTEM,
            191,
            {
                "target_system": SYSTEM,
                "target_component": 1,
                "command": 21,
                "confirmation": 0,
                **{f"param{index}": float("nan") for index in range(1, 8)},
            },
        )
        await bench.link.send([odometry, asked, MavlinkMessage("NO_SUCH", 1, 1, {})])
        bench.peer.send(authorise())
        await until(lambda: "COMMAND_ACK" in bench.peer.names() and "ODOMETRY" in bench.peer.names(), bench)
        (sent,) = bench.peer.find("ODOMETRY")
        for name in ("time_usec", "frame_id", "child_frame_id", "reset_counter", "estimator_type", "quality"):
            assert sent.fields[name] == odometry.fields[name]
        assert sent.fields["pose_covariance"] == pytest.approx(odometry.fields["pose_covariance"])
        assert sent.fields["q"] == odometry.fields["q"]

    run(bench, body())
    landing = [m for m in bench.peer.find("COMMAND_LONG") if m.fields["command"] == 21]
    assert len(landing) == 1
    assert all(landing[0].fields[f"param{i}"] != landing[0].fields[f"param{i}"] for i in range(1, 8))
    # MAVSDK itself does not answer for us: one command, one answer.
    (ack,) = bench.peer.find("COMMAND_ACK")
    assert (ack.fields["command"], ack.fields["result"]) == (31010, 0)
    assert (ack.fields["target_system"], ack.fields["target_component"]) == STATION
    (granted,) = bench.session.authorisations()
    assert granted.granted
    assert bench.link.unsent == 1


def test_a_link_can_be_stopped_twice_and_started_again(benches: list[Bench]) -> None:
    bench = Bench(SYSTEM)
    benches.append(bench)

    async def body() -> None:
        await bench.link.stop()
        await bench.link.start(15.0)
        await bench.link.stop()
        await bench.link.stop()
        await bench.link.send([MavlinkMessage("HEARTBEAT", SYSTEM, 191, {})])
        await bench.link.start(15.0)

    run(bench, body())
    assert bench.link.unsent == 1


def test_a_flood_during_a_stall_is_kept_within_bounds(benches: list[Bench]) -> None:
    bench = Bench(SYSTEM)
    benches.append(bench)

    async def body() -> None:
        await bench.link.start(15.0)
        arrived = len(bench.arrived)
        for index in range(2000):
            bench.peer.send(from_autopilot("EXTENDED_SYS_STATE", vtol_state=0, landed_state=index % 5))
            if index % 100 == 99:
                CLOCK.pause(10 * MS)
        end_ns = CLOCK.now_ns() + 20 * SECOND
        while bench.link.dropped == 0:
            assert CLOCK.now_ns() < end_ns, "the inbox never filled"
            CLOCK.pause(20 * MS)
        assert len(bench.arrived) == arrived
        await until(lambda: len(bench.arrived) > arrived, bench)

    run(bench, body())
