"""Somebody else's odometry as a process: it estimates from copied packets, and the companion flies on it."""

import asyncio
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from companion.clock import SystemClock, seconds_to_ns
from companion.exit_codes import ExitCode
from companion.kernel_cache import load_kernels
from companion.logs import channels
from companion.logs.reader import FlightRecording
from companion.messages import VehicleMode
from sitl.cli import main
from sitl.outcome import evaluate
from sitl.scenario import load_scenario, set_stage
from sitl.wire import WireFlight, fly_wire
from tests.sitl.external_scenario import write_external_scenario

_STEP_LIMIT_S = 60.0


@pytest.fixture(autouse=True)
def kernels() -> None:
    load_kernels()


def test_a_whole_flight_over_real_sockets_on_another_process_odometry(tmp_path: Path) -> None:
    path = write_external_scenario(tmp_path)
    log = tmp_path / "flight.mcap"
    outcome = evaluate(fly_wire(set_stage(load_scenario(path), tmp_path, None), log), log)
    assert outcome.success, outcome.reason
    assert outcome.odometry.ape_rmse_m is not None
    assert outcome.odometry.ape_rmse_m < 0.1
    heard = list(FlightRecording(log).messages(channels.EXTERNAL_ODOMETRY))
    assert len(heard) > 500
    assert "stopped" in (tmp_path / "odometry-peer.log").read_text(encoding="utf-8")


def test_when_the_other_process_is_killed_in_flight_the_autopilot_lands(tmp_path: Path) -> None:
    async def fly() -> None:
        path = write_external_scenario(tmp_path)
        flight = WireFlight(set_stage(load_scenario(path), tmp_path, None), tmp_path, SystemClock())
        autopilot = flight.vehicle.autopilot
        try:
            await flight.open()
            assert flight.peer is not None

            async def until(mode: VehicleMode) -> None:
                limit_ns = flight.vehicle.t_ns + seconds_to_ns(_STEP_LIMIT_S)
                while autopilot.mode is not mode:
                    assert flight.vehicle.t_ns < limit_ns, flight.companion.last_words()
                    await flight.advance()

            await until(VehicleMode.OFFBOARD)
            assert flight.peer.pid is not None
            os.kill(flight.peer.pid, signal.SIGKILL)
            await until(VehicleMode.LAND)
        finally:
            await flight.close()

    asyncio.run(fly())


def test_the_command_ends_in_order_when_told_to(tmp_path: Path) -> None:
    write_external_scenario(tmp_path)
    command = [sys.executable, "-m", "sitl", "odometry-peer", str(tmp_path / "profile.yaml"), "--json"]
    ports = ["--points-port", "57311", "--imu-port", "57411", "--to", "127.0.0.1:57000"]
    process = subprocess.Popen([*command, *ports], stdout=subprocess.PIPE, text=True)
    try:
        clock = SystemClock()
        end_ns = clock.now_ns() + seconds_to_ns(60.0)
        while not _is_bound(57311):
            assert clock.now_ns() < end_ns
            assert process.poll() is None
            clock.pause(20_000_000)
        process.send_signal(signal.SIGTERM)
        out, _ = process.communicate(timeout=20)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0
    assert json.loads(out.splitlines()[-1]) == {"sent": 0, "exit": 0}


def _is_bound(port: int) -> bool:
    return f":{port:04X} " in Path("/proc/net/udp").read_text(encoding="ascii")


@pytest.mark.parametrize("to", ["14580", "127.0.0.1:", "127.0.0.1:99999"])
def test_a_wrong_address_is_a_wrong_command_line(to: str, tmp_path: Path) -> None:
    write_external_scenario(tmp_path)
    assert main(["odometry-peer", str(tmp_path / "profile.yaml"), "--to", to]) == ExitCode.USAGE
