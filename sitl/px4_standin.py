"""A stand-in for a PX4 with its internal simulator: real time, real sockets, none of our sensors."""

import asyncio
from collections.abc import Mapping

import numpy as np

from companion.clock import SystemClock
from companion.geometry import rotation
from companion.geometry.pose import Pose
from sitl.airframe import Airframe
from sitl.autopilot import Autopilot, AutopilotSettings
from sitl.autopilot_parameters import Parameters
from sitl.dynamics import STEP_NS, QuadrotorSettings
from sitl.hil_state import HilStatePublisher, HilStateSettings
from sitl.mavlink_emulator import EmulatorSettings, MavlinkEmulator
from sitl.mavlink_sockets import MavlinkSockets, MavlinkSocketSettings
from sitl.wind import WindSettings
from sitl.worlds.primitives import Ground, World

# PX4's internal simulator runs this much slower than real time.
_CLOCK_SLOW = 0.007
_NORTH = np.pi / 2.0


class Px4StandIn:
    """Autopilot and airframe alone; publishes the true motion as PX4's simulator does."""

    def __init__(
        self,
        parameters: Mapping[str, int | float],
        sockets: MavlinkSocketSettings,
        truth_address: tuple[str, int],
        clock: SystemClock,
        seed: int,
    ) -> None:
        """Boot, heading north, with PX4's default parameters but for `parameters`."""
        boot_ns = clock.now_ns()
        quadrotor = QuadrotorSettings()
        self._clock = clock
        self._t_ns = boot_ns
        self._truth_address = truth_address
        self._airframe = Airframe(
            Pose.of([0.0, 0.0, quadrotor.standing_height_m], rotation.from_yaw(_NORTH)),
            World.of([Ground()]),
            quadrotor=quadrotor,
            wind=WindSettings(),
            radius_m=0.2,
            rng=np.random.default_rng([seed, 0]),
        )
        self.autopilot = Autopilot(
            AutopilotSettings(), Parameters(parameters), np.random.default_rng([seed, 1])
        )
        emulator = MavlinkEmulator(self.autopilot, EmulatorSettings(clock_slow=_CLOCK_SLOW), boot_ns)
        self._links = MavlinkSockets(emulator, sockets, clock)
        self._publisher = HilStatePublisher(HilStateSettings(clock_slow=_CLOCK_SLOW), boot_ns=boot_ns)

    async def run(self) -> None:
        """Run until cancelled.

        Raises:
            OSError: if a port is taken.
        """
        await self._links.open()
        loop = asyncio.get_running_loop()
        truth, _ = await loop.create_datagram_endpoint(
            asyncio.DatagramProtocol, remote_addr=self._truth_address
        )
        try:
            while True:
                while self._t_ns + STEP_NS <= self._clock.now_ns():
                    self._step(truth)
                self._links.poll()
                await self._clock.sleep_until(self._t_ns + STEP_NS)
        finally:
            truth.close()
            self._links.close()

    def _step(self, truth: asyncio.DatagramTransport) -> None:
        command = self.autopilot.step(self._t_ns, self._airframe.truth(self._t_ns))
        self._airframe.step(command)
        self._t_ns += STEP_NS
        data = self._publisher.poll(self._t_ns, self._airframe.truth(self._t_ns))
        if data is not None:
            truth.sendto(data)
