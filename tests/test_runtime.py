"""One run of the companion with drivers that are played: starting, stopping, answering, not sending late."""

import asyncio
import os
import signal
import socket
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from companion.config import Profile
from companion.control_socket import ask
from companion.errors import StartError
from companion.logs import channels
from companion.logs.reader import FlightRecording
from companion.logs.records import CallName, RuntimeCall, Statistics, UnsentMessages
from companion.logs.views import Recordable
from companion.messages import (
    Datagram,
    FlightState,
    FloatArray,
    ImuSample,
    LidarScan,
    MavlinkMessage,
    Odometry,
    RegisteredScan,
)
from companion.runtime import FlightOutcome, fly
from companion.yaml_source import loads
from tests.drivers.px4_peer import MS, STATION, command
from tests.flight_bench import Bench, FineSteppedClock, InControl, SteppedClock
from tests.profiles import GOOD

SECOND_NS = 1_000_000_000
SYSTEM = 1


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    played = Bench(tmp_path, monkeypatch)
    yield played
    played.log.close()


def names(messages: Sequence[MavlinkMessage]) -> list[str]:
    return [message.name for message in messages]


def question(number: int) -> MavlinkMessage:
    """Return a command that is answered at once, with its own number."""
    return command(number, sender=STATION, target=(SYSTEM, 191))


def answers(messages: Sequence[MavlinkMessage]) -> list[object]:
    return [message.fields["command"] for message in messages if message.name == "COMMAND_ACK"]


def a_scan(t_ns: int) -> LidarScan:
    """Return a scan without a return."""
    none = np.zeros(0, np.uint8)
    return LidarScan(
        t_ns=t_ns,
        sequence=0,
        t_sensor_start_ns=t_ns - 100 * MS,
        t_sensor_end_ns=t_ns,
        clock_offset_ns=0,
        points_lidar=np.zeros((0, 3), np.float32),
        offsets_ns=np.zeros(0, np.int32),
        reflectivity=none,
        tags=none,
        packets=0,
        packets_expected=0,
    )


class TestStarting:
    def test_drivers_start_one_after_the_other_and_stop_in_the_reverse_order(self, bench: Bench) -> None:
        outcome = asyncio.run(bench.run())
        assert outcome == FlightOutcome(FlightState.STARTING, "enough", bench.log.path)
        driving = [entry for entry in bench.story if not entry.startswith("status starting:")]
        assert driving[:5] == ["link starts", "link runs", "LiDAR starts", "LiDAR runs", "ready"]
        assert driving[-2:] == ["LiDAR stops", "link stops"]
        assert bench.story.index("status starting: autopilot") < bench.story.index("link starts")
        assert bench.story.index("status starting: LiDAR") < bench.story.index("LiDAR starts")
        assert not bench.control_socket.exists()
        assert not [thread for thread in threading.enumerate() if thread.name == "perception"]

    @pytest.mark.parametrize("stage", ["on_link_start", "on_lidar_start"])
    def test_a_stop_while_starting_is_followed_at_once(self, bench: Bench, stage: str) -> None:
        async def hang() -> None:
            bench.service.stop.request("SIGTERM")
            await asyncio.Event().wait()

        setattr(bench, stage, hang)
        outcome = asyncio.run(bench.run())
        assert outcome.reason == "SIGTERM"
        assert "ready" not in bench.story
        assert bench.story[-1] == "link stops"
        assert (
            ("LiDAR stops" in bench.story) == ("LiDAR starts" in bench.story) == (stage == "on_lidar_start")
        )
        assert bench.sent == []
        assert not bench.control_socket.exists()

    @pytest.mark.parametrize("stage", ["on_link_start", "on_lidar_start"])
    def test_a_driver_that_cannot_start_ends_the_run_and_what_ran_before(
        self, bench: Bench, stage: str
    ) -> None:
        async def fail() -> None:
            raise StartError("nobody there")

        setattr(bench, stage, fail)
        with pytest.raises(StartError, match="nobody there"):
            asyncio.run(bench.run())
        assert bench.story[-1] == "link stops"
        assert not bench.control_socket.exists()

    def test_a_stop_signal_of_the_system_is_the_reason(self, bench: Bench) -> None:
        async def kill() -> None:
            os.kill(os.getpid(), signal.SIGTERM)
            await asyncio.Event().wait()

        bench.on_lidar_start = kill
        profile = loads(GOOD, Profile)
        outcome = asyncio.run(fly(profile, clock=bench.clock, service=bench.service, log=bench.log))
        assert outcome.reason == "SIGTERM"


class TestFlying:
    def test_decisions_come_at_the_setpoint_rate_and_what_is_sent_is_kept(self, bench: Bench) -> None:
        async def wait() -> None:
            await bench.until(lambda: len(bench.sent) >= 3)

        asyncio.run(bench.run(wait()))
        assert set(names(bench.sent)) == {"HEARTBEAT"}
        ticks = [getattr(tick, "t_ns", 0) for tick in bench.recorded(channels.TICK)]
        assert set(np.diff(ticks)) == {20 * MS}
        assert bench.recorded(channels.MAVLINK_TX) == bench.sent

    def test_calls_that_change_how_control_goes_on_are_kept_in_order(self, bench: Bench) -> None:
        async def greet() -> None:
            assert names(bench.poll(bench.clock.now_ns())) == ["HEARTBEAT"]

        bench.on_link_start = greet
        asyncio.run(bench.run())
        calls = [entry for entry in bench.recorded(channels.CALL) if isinstance(entry, RuntimeCall)]
        assert [call.name for call in calls] == [CallName.STARTING, CallName.STOP]

    def test_every_registered_scan_is_decided_on_at_once(self, bench: Bench) -> None:
        bench.clock = FineSteppedClock()
        scans = 8
        registered: list[int] = []
        record = bench.log.record

        def watch(message: Recordable | Datagram, t_ns: int) -> None:
            record(message, t_ns)
            if isinstance(message, RegisteredScan):
                registered.append(t_ns)

        bench.monkeypatch.setattr(bench.log, "record", watch)

        async def see() -> None:
            await bench.until(lambda: len(bench.sent) >= 1)
            for number in range(scans):
                bench.sense(a_scan(bench.clock.now_ns()))
                await bench.until_more(registered, number)
                await bench.pass_time(12)

        asyncio.run(bench.run(see()))
        bench.log.close()
        wanted = (channels.SCAN, channels.VEHICLE, channels.TICK)
        journal = list(FlightRecording(bench.log.path).messages(*wanted))
        seen = [index for index, entry in enumerate(journal) if entry.channel is channels.SCAN]
        assert len(seen) == scans
        for index in seen:
            answer = journal[index + 1 : index + 3]
            assert [entry.channel for entry in answer] == [channels.VEHICLE, channels.TICK]
            assert answer[1].t_ns == journal[index].t_ns

    @pytest.mark.parametrize("stage", ["on_link_start", "on_lidar_start"])
    def test_a_scan_seen_before_the_service_is_ready_is_not_decided_on(
        self, bench: Bench, stage: str
    ) -> None:
        async def see() -> None:
            bench.sense(a_scan(bench.clock.now_ns()))
            await bench.until(lambda: bench.estimator.thread != "")
            bench.service.stop.request("enough")
            await asyncio.Event().wait()

        setattr(bench, stage, see)
        asyncio.run(bench.run())
        assert bench.recorded(channels.TICK) == []

    def test_once_a_second_the_counters_are_kept_and_the_state_is_told(self, bench: Bench) -> None:
        async def wait() -> None:
            await bench.until(lambda: len(bench.sent) >= 3)

        asyncio.run(bench.run(wait()))
        kept = [entry for entry in bench.recorded(channels.STATISTICS) if isinstance(entry, Statistics)]
        assert {entry.source for entry in kept} == {"lidar", "mavlink", "runtime", "log"}
        times = [entry.t_ns for entry in kept if entry.source == "lidar"]
        assert set(np.diff(times)) == {SECOND_NS}
        assert kept[0].values["packets"] == 17
        assert bench.story.count("status starting") == len(times)

    def test_samples_are_worked_on_in_a_thread_of_their_own_and_decided_on_by_the_loop(
        self, bench: Bench
    ) -> None:
        async def sense() -> None:
            t_ns = bench.clock.now_ns()
            bench.sense(ImuSample(t_ns, t_ns, np.zeros(3), np.zeros(3)))
            await bench.until(lambda: bench.estimator.thread != "")
            await bench.until(lambda: bench.log.status().written > 0)
            await bench.clock.sleep(0)

        asyncio.run(bench.run(sense()))
        assert bench.estimator.thread == "perception"
        (kept,) = bench.recorded(channels.ODOMETRY)
        assert isinstance(kept, Odometry)

    def test_a_part_that_breaks_ends_the_run_and_is_seen(self, bench: Bench) -> None:
        async def break_down(messages: Sequence[MavlinkMessage]) -> None:
            raise ZeroDivisionError("broken")

        bench.on_send = break_down
        with pytest.raises(ZeroDivisionError, match="broken"):
            asyncio.run(bench.run())
        assert bench.story[-2:] == ["LiDAR stops", "link stops"]

    def test_a_thread_that_breaks_ends_the_run_and_is_seen(self, bench: Bench) -> None:
        async def sense() -> None:
            bench.estimator.error = ZeroDivisionError("broken")
            t_ns = bench.clock.now_ns()
            bench.sense(ImuSample(t_ns, t_ns, np.zeros(3), np.zeros(3)))
            await asyncio.Event().wait()

        with pytest.raises(ZeroDivisionError, match="broken"):
            asyncio.run(bench.run(sense()))
        assert bench.service.stop.reason == "internal error"
        assert bench.story[-2:] == ["LiDAR stops", "link stops"]

    def test_a_callback_that_breaks_ends_the_run_and_is_seen(self, bench: Bench) -> None:
        async def break_down() -> None:
            asyncio.get_running_loop().call_soon(lambda: 1 // 0)
            await asyncio.Event().wait()

        with pytest.raises(ZeroDivisionError):
            asyncio.run(bench.run(break_down()))
        assert bench.service.stop.reason == "internal error"


class TestStoppingInTheAir:
    def ticks_after_the_stop(self, bench: Bench, braking_s: float) -> FloatArray:
        """Return when decisions came after the stop, in seconds."""

        class Braking(InControl):
            braking_ns = braking_s * SECOND_NS

        stops: list[int] = []

        async def note() -> None:
            stops.append(bench.clock.now_ns())

        bench.pipeline_type = Braking
        asyncio.run(bench.run(note()))
        ticks = np.array([getattr(tick, "t_ns", 0) for tick in bench.recorded(channels.TICK)])
        return (ticks[ticks >= stops[0]] - stops[0]) / SECOND_NS

    def test_decisions_go_on_until_the_vehicle_is_braked(self, bench: Bench) -> None:
        ticks_s = self.ticks_after_the_stop(bench, braking_s=1.0)
        assert 1.0 <= ticks_s.max() < 1.1
        assert len(ticks_s) > 20

    def test_a_vehicle_that_is_never_braked_is_given_up_after_three_seconds(self, bench: Bench) -> None:
        assert 2.9 < self.ticks_after_the_stop(bench, braking_s=1e6).max() <= 3.1


class TestRequests:
    def ask(self, bench: Bench, verb: str) -> dict[str, object]:
        answer: dict[str, object] = {}

        async def act() -> None:
            answer.update(await asyncio.to_thread(ask, bench.control_socket, {"verb": verb}))

        asyncio.run(bench.run(act()))
        return answer

    def test_the_state_is_told(self, bench: Bench) -> None:
        assert self.ask(bench, "status") == {"ok": True, "state": "starting"}

    def test_an_engagement_that_cannot_be_is_refused_with_its_reason(self, bench: Bench) -> None:
        answer = self.ask(bench, "engage")
        assert answer["ok"] is False
        assert answer["error"]
        (kept,) = bench.recorded(channels.AUTHORISATION)
        assert (getattr(kept, "granted", None), getattr(kept, "source", None)) == (True, "command")
        texts = [message.fields["text"] for message in bench.sent if message.name == "STATUSTEXT"]
        assert texts == [f"CMP: engage refused: {answer['error']}"[:50]]

    def test_a_release_is_always_followed(self, bench: Bench) -> None:
        assert self.ask(bench, "release") == {"ok": True, "state": "starting"}
        (kept,) = bench.recorded(channels.AUTHORISATION)
        assert getattr(kept, "granted", None) is False

    @pytest.mark.parametrize("payload", [b"", b"nonsense", b"{}\n", b"x" * 10_000, b'{"verb": "status"}\n'])
    def test_a_client_that_leaves_without_listening_does_not_disturb_the_flight(
        self, bench: Bench, payload: bytes
    ) -> None:
        def leave() -> None:
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
                client.connect(str(bench.control_socket))
                client.sendall(payload)

        async def act() -> None:
            for _ in range(5):
                await asyncio.to_thread(leave)
            answer = await asyncio.to_thread(ask, bench.control_socket, {"verb": "status"})
            assert answer["ok"] is True

        assert asyncio.run(bench.run(act())).reason == "enough"


class TestOutbox:
    def test_what_waited_too_long_is_dropped_and_counted(self, bench: Bench) -> None:
        clock = bench.clock
        assert isinstance(clock, SteppedClock)
        late: list[int] = []

        async def stall_once(messages: Sequence[MavlinkMessage]) -> None:
            if not late:
                late.append(1)
                bench.hear(question(101), clock.now_ns())
                clock.t_ns += 201 * MS
                bench.hear(question(102), clock.now_ns())

        async def wait() -> None:
            await bench.until(lambda: 102 in answers(bench.sent))
            await bench.until(lambda: len(bench.sent) > 3)

        bench.on_send = stall_once
        asyncio.run(bench.run(wait()))
        assert answers(bench.sent) == [102]
        assert bench.backlog()["messages_dropped"] == 1
        # The very first message was the heartbeat of the first tick.
        (unsent,) = bench.recorded(channels.MAVLINK_UNSENT)
        assert isinstance(unsent, UnsentMessages)
        assert (unsent.first, unsent.count) == (1, 1)

    def test_when_it_is_full_the_oldest_goes_first(self, bench: Bench) -> None:
        asked = range(1000, 1300)
        begun: list[int] = []

        async def block_once(messages: Sequence[MavlinkMessage]) -> None:
            if not begun:
                begun.append(1)
                for number in asked:
                    bench.hear(question(number), bench.clock.now_ns())

        async def wait() -> None:
            await bench.until(lambda: asked[-1] in answers(bench.sent))
            await bench.until(lambda: len(bench.sent) > 300)

        bench.on_send = block_once
        asyncio.run(bench.run(wait()))
        assert answers(bench.sent) == list(asked)[-256:]
        assert bench.backlog()["messages_dropped"] == len(asked) - 256
        unsent = bench.recorded(channels.MAVLINK_UNSENT)
        assert [getattr(mark, "first", None) for mark in unsent] == list(range(1, 1 + len(asked) - 256))
