"""`companion check` against an emulated LiDAR and a PX4 that is played, on real sockets."""

import asyncio
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from companion.cli import main
from companion.clock import SystemClock
from companion.exit_codes import ExitCode
from companion.preflight import autopilot, lidar, table
from sitl.autopilot_parameters import GNSS_DENIED
from sitl.livox_emulator import LivoxEmulator, LivoxEmulatorSettings
from sitl.livox_sockets import LivoxSockets
from sitl.mavlink_sockets import MavlinkSocketSettings
from sitl.px4_standin import Px4StandIn
from tests.sitl.livox_feed import RealTimeFeed

# Addresses and ports of this file alone, so that no other test or program is in the way.
LIDAR_IP, HOST_IP = "127.0.8.2", "127.0.8.1"
# What a computer for tests and a vehicle on a table may lack.
EXPLAINED = {"disk", "receive buffer", "core files", "radio control", "battery", "kernels"}

Output = pytest.CaptureFixture[str]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def profile(tmp_path: Path, port: int, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "uav1.yaml"
    path.write_text(
        f"""\
vehicle: {{name: uav1}}
role: leader
leader: {{mission: {{waypoints_m: [[5.0, 0.0, 1.5]]}}}}
lidar: {{lidar_ip: {LIDAR_IP}, host_ip: {HOST_IP}, broadcast_search: false}}
autopilot: {{url: "udpin://127.0.0.1:{port}"}}
"""
    )
    return path


@contextmanager
def a_lidar() -> Iterator[None]:
    clock = SystemClock()
    emulator = LivoxEmulator(LivoxEmulatorSettings(lidar_ip=LIDAR_IP), clock.now_ns())
    with RealTimeFeed(LivoxSockets(emulator, clock, hears_broadcast=False), emulator, clock):
        yield


@contextmanager
def a_px4(port: int, parameters: Mapping[str, int | float]) -> Iterator[Px4StandIn]:
    """Run an autopilot in a thread of its own."""
    addresses = MavlinkSocketSettings(
        companion_port=port, companion_local_port=0, ground_port=free_port(), ground_local_port=0
    )
    px4 = Px4StandIn(parameters, addresses, ("127.0.0.1", free_port()), SystemClock(), seed=1)
    running = threading.Event()
    stop: list[Any] = []

    async def run() -> None:
        task = asyncio.create_task(px4.run())
        stop.extend((asyncio.get_running_loop(), task))
        running.set()
        with suppress(asyncio.CancelledError):
            await task

    thread = threading.Thread(target=asyncio.run, args=(run(),), daemon=True)
    thread.start()
    assert running.wait(10.0)
    try:
        yield px4
    finally:
        loop, task = stop
        loop.call_soon_threadsafe(task.cancel)
        thread.join(10.0)


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave kernels and logging of the test process as they are; do not wait long for who is absent."""
    monkeypatch.setattr(table, "load_kernels", lambda: 1)
    monkeypatch.setattr("companion.service.write_logs_to_stderr", lambda: None)
    monkeypatch.setattr(lidar, "STREAM_TIMEOUT_S", 1.0)
    monkeypatch.setattr(autopilot, "START_TIMEOUT_S", 1.0)


def checked(text: str) -> dict[str, dict[str, str]]:
    """Return the checks of a JSON answer by name."""
    answer = json.loads(text.rstrip("\n").rpartition("\n")[2])
    found = {check["name"]: check for check in answer["checks"]}
    assert answer["go"] == all(check["verdict"] != "fail" for check in found.values())
    return found


def named(checks: Mapping[str, Mapping[str, str]], verdict: str) -> set[str]:
    return {name for name, check in checks.items() if check["verdict"] == verdict}


def test_a_vehicle_that_is_ready_is_a_go_and_nothing_on_it_is_changed(profile: Path, port: int) -> None:
    with a_lidar(), a_px4(port, GNSS_DENIED) as px4:
        before = {name: px4.autopilot.parameters[name] for name in GNSS_DENIED}
        result = subprocess.run(
            [sys.executable, "-m", "companion", "check", str(profile), "--json"],
            env={**os.environ},
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
        assert {name: px4.autopilot.parameters[name] for name in GNSS_DENIED} == before
        assert not px4.autopilot.armed
    assert result.returncode == ExitCode.OK, result.stdout + result.stderr
    checks = checked(result.stdout)
    assert named(checks, "fail") == named(checks, "skipped") == set()
    # Those that GNSS_DENIED leaves at PX4's default, and one that the emulated PX4 does not have.
    parameters = {"parameter NAV_RCL_ACT", "parameter GF_ACTION", "parameter SDLOG_PROFILE"}
    assert named(checks, "warn") - EXPLAINED == parameters
    assert checks["LiDAR network"]["reason"] == f"{HOST_IP} reaches {LIDAR_IP}"
    assert checks["LiDAR"]["verdict"] == "ok"
    assert checks["LiDAR"]["reason"].endswith("streams")
    assert checks["autopilot"] == {
        "name": "autopilot",
        "verdict": "ok",
        "reason": "system id 1, mode hold, disarmed",
    }
    assert checks["battery"]["reason"] == "100 %"


@pytest.mark.usefixtures("in_this_process")
def test_without_a_lidar_and_with_a_px4_set_up_for_gnss_every_reason_of_the_no_go_is_named(
    profile: Path, port: int, capsys: Output
) -> None:
    with a_px4(port, {}):
        assert main(["check", str(profile), "--json"]) == ExitCode.NO_GO
    checks = checked(capsys.readouterr().out)
    assert named(checks, "fail") == {"LiDAR", *(f"parameter {name}" for name in GNSS_DENIED)}
    assert f"no answer to discovery from {LIDAR_IP}" in checks["LiDAR"]["reason"]
    assert "EKF2_EV_CTRL is 0, wanted 11 or 15" in checks["parameter EKF2_EV_CTRL"]["reason"]
    assert checks["autopilot"]["verdict"] == "ok"


@pytest.mark.usefixtures("in_this_process")
def test_without_an_autopilot_it_is_a_no_go_that_names_the_link(
    profile: Path, port: int, capsys: Output
) -> None:
    with a_lidar():
        assert main(["check", str(profile), "--json"]) == ExitCode.NO_GO
    checks = checked(capsys.readouterr().out)
    assert named(checks, "fail") == {"autopilot"}
    assert checks["autopilot"]["reason"] == f"autopilot: system id 1 is silent on udpin://127.0.0.1:{port}"
    assert checks["LiDAR"]["verdict"] == "ok"
