"""The companion as a process of its own: started, watched, ended, and its log taken over."""

import asyncio
import os
import signal
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from companion.clock import SystemClock
from companion.control_socket import ask
from companion.errors import StartError
from companion.logs import channels
from companion.logs.log_queue import LogEntry
from companion.logs.reader import FlightRecording
from companion.logs.records import StampedPose
from sitl.companion_process import CompanionProcess, run_until_terminated
from sitl.ground_link import GROUND_ADDRESS
from sitl.scenario import load_scenario, set_stage
from sitl.wire import fly_wire
from tests.sitl.short_flight import write_scenario

MS = 1_000_000
TRUTH = LogEntry(channels.TRUTH, 5, 0, StampedPose(5, "world", np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
# Addresses and ports of this file alone: the process waits for an autopilot that never comes.
PROFILE = """\
vehicle:
  name: uav1
role: follower
lidar:
  lidar_ip: 127.0.6.2
  host_ip: 127.0.6.1
  broadcast_search: false
autopilot:
  url: udpin://127.0.0.1:47650
"""


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    path = tmp_path / "uav1.yaml"
    path.write_text(PROFILE)
    return path


async def until(condition: Callable[[], bool], process: CompanionProcess) -> None:
    for _ in range(3000):
        if condition():
            return
        await SystemClock().sleep(10 * MS)
    raise AssertionError(f"waited in vain; {process.last_words()}")


def test_it_runs_in_private_folders_answers_and_leaves_a_closed_log(tmp_path: Path, profile: Path) -> None:
    async def scene() -> CompanionProcess:
        process = CompanionProcess(profile, tmp_path)
        assert (process.running, process.pid) == (False, None)
        try:
            await process.start()
            assert process.running
            await until(process.control_socket.exists, process)
            answer = await asyncio.to_thread(ask, process.control_socket, {"verb": "status"})
            assert answer == {"ok": True, "state": "starting"}
            assert process.pid is not None
            assert os.getsid(process.pid) == process.pid
        finally:
            await process.stop()
        return process

    process = asyncio.run(scene())
    assert not process.running
    assert not process.control_socket.parent.exists()
    assert process.last_words().startswith("starting: SIGTERM; log ")
    log = process.log()
    assert log is not None
    assert log.suffix == ".mcap"

    taken = tmp_path / "flight.mcap"
    process.hand_over_log([TRUTH], taken)
    recording = FlightRecording(taken)
    assert recording.flight["vehicle"] == "uav1"
    assert [entry.t_ns for entry in recording.messages(channels.TRUTH)] == [TRUTH.t_ns]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["companion.log", "flight.mcap", "uav1.yaml"]


def test_a_killed_process_is_noticed_and_its_open_log_is_found(tmp_path: Path, profile: Path) -> None:
    async def scene() -> CompanionProcess:
        process = CompanionProcess(profile, tmp_path)
        try:
            await process.start()
            await until(process.control_socket.exists, process)
            assert process.pid is not None
            os.kill(process.pid, signal.SIGKILL)
            await until(lambda: not process.running, process)
        finally:
            await process.stop()
        return process

    process = asyncio.run(scene())
    log = process.log()
    assert log is not None
    assert log.name.endswith(".mcap.open")
    process.hand_over_log([TRUTH], tmp_path / "flight.mcap")
    assert FlightRecording(tmp_path / "flight.mcap").integrity().complete


def test_a_process_that_cannot_begin_has_no_log_but_last_words(tmp_path: Path, profile: Path) -> None:
    async def scene() -> CompanionProcess:
        process = CompanionProcess(profile, tmp_path)
        try:
            await process.start()
            await until(lambda: not process.running, process)
        finally:
            await process.stop()
        return process

    profile.write_text(PROFILE + "safty: {}\n")
    process = asyncio.run(scene())
    with pytest.raises(StartError, match=r"wrote no log: .*:10:1: safty: unknown key"):
        process.hand_over_log([], tmp_path / "flight.mcap")


def test_a_process_that_does_not_obey_is_killed(
    tmp_path: Path, profile: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sitl.companion_process._STOP_TIMEOUT_S", 0.2)
    deaf = tmp_path / "deaf"
    deaf.write_text("#!/bin/sh\ntrap '' TERM\necho deaf\nwhile :; do sleep 0.1; done\n")
    deaf.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(deaf))

    async def scene() -> None:
        process = CompanionProcess(profile, tmp_path)
        await process.start()
        await until(lambda: process.last_words() == "deaf", process)
        await process.stop()
        assert not process.running
        await process.stop()

    asyncio.run(scene())


def test_what_never_started_leaves_nothing_behind(tmp_path: Path, profile: Path) -> None:
    process = CompanionProcess(profile, tmp_path)
    asyncio.run(process.stop())
    process.hand_over_log([TRUTH], tmp_path / "flight.mcap")
    assert not process.control_socket.parent.exists()
    assert [path.name for path in tmp_path.iterdir()] == ["uav1.yaml"]


def test_a_flight_whose_ground_station_finds_its_address_taken_says_so(tmp_path: Path) -> None:
    path = write_scenario(tmp_path, world={"primitives": [{"shape": "ground"}]})
    stage = set_stage(load_scenario(path), tmp_path, None)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(GROUND_ADDRESS)
        with pytest.raises(StartError, match=r"^ground station: cannot listen on 127\.0\.0\.1:14550: "):
            fly_wire(stage, tmp_path / "flight.mcap")
    assert not list(tmp_path.glob("logs-*"))


class TestRunUntilTerminated:
    def test_the_result_is_the_flights(self) -> None:
        async def flight() -> int:
            await SystemClock().sleep(0)
            return 7

        assert run_until_terminated(flight()) == 7

    def test_sigterm_lets_the_flight_end_in_order(self) -> None:
        ended: list[str] = []

        async def flight() -> None:
            os.kill(os.getpid(), signal.SIGTERM)
            try:
                await asyncio.Event().wait()
            finally:
                ended.append("in order")

        with pytest.raises(KeyboardInterrupt):
            run_until_terminated(flight())
        assert ended == ["in order"]
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
