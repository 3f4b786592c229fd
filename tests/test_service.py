"""Readiness, proof of life and an orderly end, against real sockets and signals."""

import asyncio
import json
import os
import signal
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import structlog

from companion.clock import SystemClock
from companion.directories import BusyError, Directories
from companion.service import (
    Liveness,
    Notifier,
    Service,
    StopSignal,
    open_service,
    watchdog_interval_ns,
    write_logs_to_stderr,
)

MILLISECOND_NS = 1_000_000


class Manager:
    """The service manager's end of the notification socket."""

    def __init__(self, address: str | bytes) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(address)
        self._socket.setblocking(False)

    def received(self) -> list[str]:
        messages = []
        with suppress(BlockingIOError):
            while True:
                messages.append(self._socket.recv(4096).decode())
        return messages

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    listener = Manager(str(tmp_path / "notify"))
    yield listener
    listener.close()


@pytest.fixture
def directories(tmp_path: Path) -> Directories:
    return Directories(tmp_path / "run", tmp_path / "logs", tmp_path / "state")


def test_every_notification_reaches_a_real_socket(manager: Manager, tmp_path: Path) -> None:
    notifier = Notifier(str(tmp_path / "notify"))
    assert notifier.ready()
    assert notifier.status("ready:\nwaiting " + "x" * 500)
    assert notifier.watchdog()
    assert notifier.stopping()
    ready, status, watchdog, stopping = manager.received()
    assert (ready, watchdog, stopping) == ("READY=1", "WATCHDOG=1", "STOPPING=1")
    assert status.startswith("STATUS=ready: waiting x")
    assert len(status) == len("STATUS=") + 200


def test_an_abstract_address_is_reached() -> None:
    name = f"companion-test-{os.getpid()}"
    listener = Manager(b"\0" + name.encode())
    try:
        assert Notifier("@" + name).ready()
        assert listener.received() == ["READY=1"]
    finally:
        listener.close()


def test_without_a_listener_nothing_is_raised(tmp_path: Path) -> None:
    gone = Notifier(str(tmp_path / "gone"))
    assert not gone.watchdog()
    assert not gone.watchdog()
    assert gone.failures == 2
    silent = Notifier(None)
    assert not silent.ready()
    assert silent.failures == 0


@pytest.mark.parametrize(
    ("environ", "interval_ns"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "2000000"}, 2_000 * MILLISECOND_NS),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())}, 2_000 * MILLISECOND_NS),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
    ],
)
def test_the_watchdog_interval_is_read_only_for_this_process(
    environ: dict[str, str], interval_ns: int | None
) -> None:
    assert watchdog_interval_ns(environ) == interval_ns


def test_life_needs_every_part_to_move_again_each_round() -> None:
    life = Liveness(("lidar", "odometry"))
    life.require("link")
    assert not life.advance()
    life.move("lidar")
    life.move("odometry")
    assert life.idle() == ("link",)
    assert not life.advance()
    life.move("link")
    assert life.advance()
    assert life.idle() == ("lidar", "odometry", "link")
    life.move("lidar")
    life.move("lidar")
    life.move("link")
    assert not life.advance()
    life.release("odometry")
    assert life.advance()


def test_nothing_is_proved_without_parts_and_unknown_parts_are_a_broken_contract() -> None:
    assert not Liveness().advance()
    with pytest.raises(KeyError):
        Liveness().move("lidar")


def test_the_watchdog_is_fed_only_on_progress(
    manager: Manager, tmp_path: Path, directories: Directories
) -> None:
    service = Service(directories, Notifier(str(tmp_path / "notify")), 8 * MILLISECOND_NS, ("a", "b"))

    async def scene() -> tuple[list[str], list[str]]:
        clock = SystemClock()
        feeding = asyncio.create_task(service.keep_watchdog(clock))
        service.liveness.move("a")
        await clock.sleep(40 * MILLISECOND_NS)
        half_alive = manager.received()
        service.liveness.move("b")
        messages: list[str] = []
        for _ in range(1000):
            await clock.sleep(MILLISECOND_NS)
            messages += manager.received()
            if messages:
                break
        await clock.sleep(40 * MILLISECOND_NS)
        feeding.cancel()
        return half_alive, messages + manager.received()

    half_alive, alive = asyncio.run(scene())
    assert half_alive == []
    assert alive == ["WATCHDOG=1"]


def test_without_a_watchdog_the_feeder_ends_at_once(directories: Directories) -> None:
    service = Service(directories, Notifier(None), None, ("a",))
    asyncio.run(asyncio.wait_for(service.keep_watchdog(SystemClock()), 5.0))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_becomes_a_stop_request_with_its_name(
    number: signal.Signals, directories: Directories
) -> None:
    service = Service(directories, Notifier(None), None)

    async def scene() -> str:
        with service.signals():
            os.kill(os.getpid(), number)
            return await asyncio.wait_for(service.stop.wait(), 10.0)

    assert asyncio.run(scene()) == number.name
    assert service.stop.requested


def test_the_first_reason_to_stop_counts() -> None:
    stop = StopSignal()
    assert (stop.requested, stop.reason) == (False, "")
    stop.request("mission finished")
    stop.request("SIGTERM")
    assert stop.reason == "mission finished"


def test_an_open_service_is_alone_and_says_when_it_ends(manager: Manager, tmp_path: Path) -> None:
    environ = {
        "XDG_RUNTIME_DIR": str(tmp_path),
        "XDG_STATE_HOME": str(tmp_path / "state"),
        "NOTIFY_SOCKET": str(tmp_path / "notify"),
    }
    with open_service(environ, "uav1") as service:
        service.ready()
        service.status("standby")
        assert service.directories.runtime == tmp_path / "companion" / "uav1"
        with pytest.raises(BusyError), open_service(environ, "uav1"):
            pass
        with open_service({**environ, "NOTIFY_SOCKET": ""}, "uav2"):
            pass
    assert manager.received() == ["READY=1", "STATUS=standby", "STOPPING=1"]


def test_log_lines_for_the_journal_are_json_on_the_error_output(capsys: pytest.CaptureFixture[str]) -> None:
    write_logs_to_stderr()
    try:
        structlog.get_logger().warning("link lost", age_ms=300)
    finally:
        structlog.reset_defaults()
    out, err = capsys.readouterr()
    assert out == ""
    line = json.loads(err)
    assert (line["event"], line["level"], line["age_ms"]) == ("link lost", "warning", 300)
