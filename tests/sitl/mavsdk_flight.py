"""A flight of the emulated autopilot by MAVSDK over real UDP sockets; a program run by a test."""

import asyncio
import json
import sys
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, VelocityNedYaw
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

from companion.clock import SystemClock
from sitl.mavlink_emulator import MavlinkEmulator
from sitl.mavlink_sockets import MavlinkSockets, MavlinkSocketSettings
from tests.sitl.autopilot_rig import STEP_NS, Rig

_QUICK = {
    "MPC_TKO_RAMP_T": 0.5,
    "COM_SPOOLUP_TIME": 0.2,
    "MPC_LAND_SPEED": 1.0,
    "COM_DISARM_LAND": 0.2,
}


class SimulationClock:
    """Host time since the program's start."""

    def __init__(self) -> None:
        self._clock = SystemClock()
        self._start_ns = self._clock.now_ns()

    def now_ns(self) -> int:
        return self._clock.now_ns() - self._start_ns


async def simulate(rig: Rig, sockets: MavlinkSockets, clock: SimulationClock) -> None:
    """Keep body and autopilot at real time and send what is due."""
    while True:
        while rig.t_ns + STEP_NS <= clock.now_ns():
            rig.run(STEP_NS * 1e-9)
        sockets.poll()
        await SystemClock().sleep(STEP_NS)


async def until(condition: Any, seconds: float) -> bool:
    """Poll an asynchronous condition every 50 ms."""
    for _ in range(round(seconds / 0.05)):
        if await condition():
            return True
        await SystemClock().sleep(50_000_000)
    return False


async def fly(rig: Rig, port: int) -> dict[str, Any]:
    """Connect, arm, take off, fly north, land; return what MAVSDK and the body saw."""
    seen: dict[str, Any] = {}
    configuration = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
    async with Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await mavsdk.first_autopilot(timeout_s=10.0)
        seen["connected"] = system is not None
        if system is None:
            return seen
        action, offboard, telemetry = ActionAsync(system), OffboardAsync(system), TelemetryAsync(system)

        async def armable() -> bool:
            return bool((await telemetry.health()).is_armable)

        seen["armable"] = await until(armable, 10.0)
        await action.set_takeoff_altitude(1.0)
        seen["takeoff_altitude"] = rig.parameters["MIS_TAKEOFF_ALT"]
        await action.arm()
        await action.takeoff()

        async def high() -> bool:
            return -float((await telemetry.position_velocity_ned()).position.down_m) > 0.7

        seen["climbed"] = await until(high, 10.0)
        await offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        await offboard.start()
        await offboard.set_velocity_ned(VelocityNedYaw(1.0, 0.0, 0.0, 0.0))

        async def fast() -> bool:
            return float((await telemetry.position_velocity_ned()).velocity.north_m_s) > 0.9

        seen["flew_north"] = await until(fast, 5.0)
        seen["speed"] = float((rig.body.v @ rig.body.v) ** 0.5)
        seen["mode"] = rig.autopilot.mode.value
        await action.land()

        async def disarmed() -> bool:
            return not await telemetry.armed()

        seen["disarmed"] = await until(disarmed, 10.0)
    return seen


async def main(companion_port: int, ground_port: int) -> None:
    clock = SimulationClock()
    rig = Rig(_QUICK, gnss=True)
    settings = MavlinkSocketSettings(
        companion_port=companion_port, companion_local_port=0, ground_port=ground_port, ground_local_port=0
    )
    sockets = MavlinkSockets(MavlinkEmulator(rig.autopilot), settings, clock)
    await sockets.open()
    simulation = asyncio.create_task(simulate(rig, sockets, clock))
    try:
        seen = await fly(rig, companion_port)
    finally:
        simulation.cancel()
        sockets.close()
    sys.stdout.write("RESULT " + json.dumps(seen) + "\n")


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), int(sys.argv[2])))
