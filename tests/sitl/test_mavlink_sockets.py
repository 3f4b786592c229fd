import asyncio
import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from companion.clock import SystemClock
from sitl.mavlink_emulator import MavlinkEmulator
from sitl.mavlink_frames import FrameCutter
from sitl.mavlink_sockets import MavlinkSockets, MavlinkSocketSettings
from tests.sitl.autopilot_rig import Rig
from tests.sitl.mavlink_peer import PeerRig, velocity_target

_ROOT = Path(__file__).parents[2]


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_mavsdk_connects_arms_takes_off_flies_offboard_and_lands() -> None:
    pytest.importorskip("mavsdk.asyncio")
    command = [sys.executable, "-m", "tests.sitl.mavsdk_flight", str(_free_port()), str(_free_port())]
    run = subprocess.run(command, cwd=_ROOT, capture_output=True, text=True, timeout=90, check=False)
    lines = [line for line in run.stdout.splitlines() if line.startswith("RESULT ")]
    assert lines, run.stdout[-2000:] + run.stderr[-2000:]
    seen = json.loads(lines[-1].removeprefix("RESULT "))
    assert seen.pop("speed") == pytest.approx(1.0, abs=0.2)
    assert seen == {
        "connected": True,
        "armable": True,
        "takeoff_altitude": 1.0,
        "climbed": True,
        "flew_north": True,
        "mode": "offboard",
        "disarmed": True,
    }


def test_both_links_send_heartbeats_and_only_the_configured_host_is_heard() -> None:
    companion_port, ground_port = _free_port(), _free_port()

    async def exchange() -> tuple[set[str], set[str], int, int]:
        rig = Rig()
        rig.run(1.0)
        emulator = MavlinkEmulator(rig.autopilot)
        settings = MavlinkSocketSettings(
            companion_port=companion_port,
            companion_local_port=0,
            ground_port=ground_port,
            ground_local_port=0,
        )
        sockets = MavlinkSockets(emulator, settings)
        names: list[set[str]] = []
        with _bound(companion_port) as companion, _bound(ground_port) as ground:
            await sockets.open()
            sockets.poll()
            for receiver in (companion, ground):
                data, sender = await asyncio.to_thread(receiver.recvfrom, 2048)
                names.append({frame.message.get_type() for frame in FrameCutter().feed(data)})
                receiver.sendto(PeerRig().pack(velocity_target(0.0)), sender)
            await _until(lambda: emulator.counters.setpoints == 2)
            sockets.received(b"", ("10.9.9.9", 5), next(iter(emulator.links)))
            sockets.close()
        return names[0], names[1], emulator.counters.setpoints, sockets.foreign_datagrams

    first, second, setpoints, foreign = asyncio.run(exchange())
    assert "HEARTBEAT" in first
    assert "HEARTBEAT" in second
    assert (setpoints, foreign) == (2, 1)


def _bound(port: int) -> socket.socket:
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.settimeout(5.0)
    receiver.bind(("127.0.0.1", port))
    return receiver


async def _until(condition) -> None:  # type: ignore[no-untyped-def]
    for _ in range(500):
        if condition():
            return
        await SystemClock().sleep(10_000_000)
