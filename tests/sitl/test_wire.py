"""Real sockets, real time, the companion as its own process: killed, stopped, and taken over in flight."""

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from companion.clock import SystemClock, seconds_to_ns
from companion.control_socket import ask
from companion.kernel_cache import load_kernels
from companion.messages import VehicleMode
from sitl.outcome import evaluate
from sitl.scenario import load_scenario, set_stage
from sitl.wire import WireFlight, fly_wire
from tests.sitl.short_flight import write_scenario

_STEP_LIMIT_S = 60.0


@asynccontextmanager
async def flight_in_the_air(folder: Path) -> AsyncIterator[WireFlight]:
    """Fly until the companion commands a moving vehicle; whatever happens, end everything."""
    path = write_scenario(folder)
    flight = WireFlight(set_stage(load_scenario(path), folder, None), folder, SystemClock())
    try:
        await flight.open()
        await advance_until(
            flight,
            lambda: (
                flight.vehicle.autopilot.mode is VehicleMode.OFFBOARD
                and float(abs(flight.vehicle.airframe.kinematics.v_world[:2]).max()) > 0.3
            ),
        )
        yield flight
    finally:
        await flight.close()


async def advance_until(flight: WireFlight, condition: Callable[[], bool]) -> None:
    limit_ns = flight.vehicle.t_ns + seconds_to_ns(_STEP_LIMIT_S)
    while not condition():
        assert flight.vehicle.t_ns < limit_ns, f"waited in vain; {flight.companion.last_words()}"
        await flight.advance()


async def advance_for(flight: WireFlight, seconds: float) -> int:
    """Let time pass; return how many setpoints the autopilot took meanwhile."""
    before = flight.vehicle.mavlink.counters.setpoints
    end_ns = flight.vehicle.t_ns + seconds_to_ns(seconds)
    while flight.vehicle.t_ns < end_ns:
        await flight.advance()
    return flight.vehicle.mavlink.counters.setpoints - before


def replayed(log: Path) -> dict[str, Any]:
    """Replay a flight's log in a process like the one that flew; return what it says."""
    command = [sys.executable, "-m", "companion", "replay", str(log), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    assert done.returncode == 0, answer
    return answer


@pytest.fixture(autouse=True)
def kernels() -> None:
    load_kernels()


def test_a_whole_flight_over_real_sockets_reaches_its_goal_and_is_replayed_to_the_byte(
    tmp_path: Path,
) -> None:
    path = write_scenario(tmp_path)
    log = tmp_path / "flight.mcap"
    outcome = evaluate(fly_wire(set_stage(load_scenario(path), tmp_path, None), log), log)
    assert outcome.success, outcome.reason
    assert outcome.livox.packets > 10_000
    assert outcome.odometry.ape_rmse_m is not None
    assert outcome.odometry.ape_rmse_m < 0.1
    again = replayed(log)
    assert again["equal"] is True, again["channels"]
    assert (again["complete"], again["missing"]) == (True, {})
    counts = {channel["topic"]: channel["equal"] for channel in again["channels"]}
    assert counts["/scan"] > 100
    assert counts["/setpoint"] > 100
    assert counts["/mavlink/tx"] > 500


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_dead_or_stopped_companion_ends_the_stream_and_px4_lands(
    tmp_path: Path, number: signal.Signals
) -> None:
    async def fly() -> None:
        async with flight_in_the_air(tmp_path) as flight:
            assert await advance_for(flight, 1.0) > 30
            pid = flight.companion.pid
            assert pid is not None
            os.kill(pid, number)
            try:
                await advance_for(flight, 0.5)
                assert await advance_for(flight, 0.5) == 0
                await advance_until(flight, lambda: flight.vehicle.autopilot.failsafe)
                assert flight.vehicle.autopilot.mode is VehicleMode.LAND
            finally:
                if number is signal.SIGSTOP:
                    os.kill(pid, signal.SIGCONT)
            if number is signal.SIGKILL:
                log = flight.companion.log()
                assert log is not None
                again = replayed(log)
                assert (again["complete"], again["equal"]) == (False, True), again["channels"]

    asyncio.run(fly())


def test_a_companion_that_wakes_up_after_a_failsafe_does_not_take_over_again(tmp_path: Path) -> None:
    async def fly() -> None:
        async with flight_in_the_air(tmp_path) as flight:
            pid = flight.companion.pid
            assert pid is not None
            os.kill(pid, signal.SIGSTOP)
            await advance_until(flight, lambda: flight.vehicle.autopilot.failsafe)
            os.kill(pid, signal.SIGCONT)
            # One message may have been on its way out when the process was stopped.
            assert await advance_for(flight, 3.0) <= 1

    asyncio.run(fly())


def test_a_pilots_mode_switch_ends_the_stream_until_a_new_authorisation(tmp_path: Path) -> None:
    async def fly() -> None:
        async with flight_in_the_air(tmp_path) as flight:
            flight.vehicle.autopilot.request_mode(VehicleMode.ALTITUDE)
            flight.vehicle.autopilot.request_mode(VehicleMode.TAKEOFF)
            await advance_until(flight, lambda: flight.vehicle.autopilot.mode is not VehicleMode.OFFBOARD)
            await advance_for(flight, 1.2)  # the autopilot tells its mode once or twice a second
            assert await advance_for(flight, 2.0) == 0
            flight.vehicle.autopilot.request_mode(VehicleMode.OFFBOARD)
            assert await advance_for(flight, 1.0) == 0
            answer = await asyncio.to_thread(ask, flight.companion.control_socket, {"verb": "engage"})
            assert answer["ok"] is True
            assert await advance_for(flight, 1.0) > 20

    asyncio.run(fly())


def test_sigterm_in_the_air_brakes_ends_the_stream_and_leaves_a_closed_log(tmp_path: Path) -> None:
    async def fly() -> None:
        async with flight_in_the_air(tmp_path) as flight:
            pid = flight.companion.pid
            assert pid is not None
            os.kill(pid, signal.SIGTERM)
            await advance_until(flight, lambda: not flight.companion.running)
            assert await advance_for(flight, 0.5) == 0
            log = flight.companion.log()
            assert log is not None
            assert log.suffix == ".mcap"

    asyncio.run(fly())
