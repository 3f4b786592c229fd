"""A flight in real time over real sockets, with the companion as its own process."""

import gc
from collections.abc import Callable
from pathlib import Path

from companion.clock import SystemClock, ns_to_seconds, seconds_to_ns
from companion.kernel_cache import load_kernels
from companion.logs import channels
from companion.logs.log_queue import LogEntry
from sitl.companion_process import CompanionProcess, run_until_terminated
from sitl.dynamics import STEP_NS
from sitl.ground_link import GROUND_ADDRESS, GroundLink
from sitl.livox_sockets import LivoxSockets
from sitl.mavlink_sockets import MavlinkSockets, MavlinkSocketSettings
from sitl.network import Network
from sitl.odometry_peer_process import OdometryPeerProcess, mirrored_ports
from sitl.outcome import Ending
from sitl.referee import Referee
from sitl.scenario import Stage
from sitl.vehicle import SimulatedVehicle, build_livox, build_operator

Progress = Callable[[float, str, float], None]

_TRUTH_PERIOD_NS = seconds_to_ns(0.02)
_PROGRESS_PERIOD_NS = seconds_to_ns(1.0)


class WireFlight:
    """Emulated hardware behind sockets, and one companion process that flies it."""

    def __init__(self, stage: Stage, folder: Path, clock: SystemClock) -> None:
        """Switch the emulated hardware on."""
        boot_ns = clock.now_ns()
        self._clock = clock
        self.vehicle = SimulatedVehicle(stage, boot_ns)
        self.companion = CompanionProcess(stage.profile_path, folder)
        self.operator = build_operator(stage)
        self.referee = Referee(stage, boot_ns)
        self.truth: list[LogEntry] = []
        port = int(stage.profile.autopilot.url.rsplit(":", 1)[1])
        self.links = MavlinkSockets(
            self.vehicle.mavlink,
            MavlinkSocketSettings(companion_port=port, companion_local_port=0, ground_local_port=0),
            clock,
        )
        self.peer: OdometryPeerProcess | None = None
        if stage.profile.odometry.source == "external":
            self.peer = OdometryPeerProcess(stage.profile, stage.profile_path, folder)
        self._lidar = LivoxSockets(
            build_livox(stage, boot_ns),
            clock,
            hears_broadcast=stage.profile.lidar.broadcast_search,
            network=Network(stage.scenario.network, stage.generator("network"), boot_ns),
            mirrored_ports=mirrored_ports(stage.profile) if self.peer is not None else None,
        )
        self._ground = GroundLink(self.operator, clock)
        self._next_truth_ns = boot_ns

    async def open(self) -> None:
        """Open all sockets and start the companion.

        Raises:
            OSError: if an address is taken.
        """
        await self._ground.open(GROUND_ADDRESS)
        await self.links.open()
        self._lidar.start()
        if self.peer is not None:
            await self.peer.start()
        await self.companion.start()

    async def close(self) -> None:
        """End the companion, then the emulators."""
        await self.companion.stop()
        if self.peer is not None:
            await self.peer.stop()
        self._lidar.stop()
        self.links.close()
        self._ground.close()

    async def advance(self) -> None:
        """Keep pace with real time: simulate up to one step ahead of now, then wait for it to come.

        Being ahead lets every packet leave at its own moment instead of in bursts.
        """
        while self.vehicle.t_ns <= self._clock.now_ns():
            measured = self.vehicle.step()
            self._lidar.inertial(measured.inertial)
            self._lidar.points(measured.slots)
            self.links.poll()
            self._ground.poll()
            self._record_truth()
            self.referee.watch(self.vehicle.sighting())
            # Between two steps the sockets get their turn, even when simulation is late.
            await self._clock.sleep(0)
        await self._clock.sleep_until(self.vehicle.t_ns - STEP_NS + STEP_NS // 2)

    def _record_truth(self) -> None:
        t_ns = self.vehicle.t_ns
        if t_ns >= self._next_truth_ns:
            self._next_truth_ns = t_ns + _TRUTH_PERIOD_NS
            self.truth.append(LogEntry(channels.TRUTH, t_ns, len(self.truth), self.vehicle.true_pose()))


async def _fly(stage: Stage, log_path: Path, on_progress: Progress | None) -> Ending:
    clock = SystemClock()
    start_ns = clock.now_ns()
    flight = WireFlight(stage, log_path.parent, clock)
    referee = flight.referee
    next_progress_ns = start_ns
    try:
        await flight.open()
        while not referee.over:
            await flight.advance()
            if not flight.companion.running:
                referee.end(f"the companion ended: {flight.companion.last_words()}")
            if flight.peer is not None and not flight.peer.running:
                referee.end(f"the other odometry process ended: {flight.peer.last_words()}")
            if on_progress is not None and referee.t_ns >= next_progress_ns:
                next_progress_ns = referee.t_ns + _PROGRESS_PERIOD_NS
                mode = flight.vehicle.autopilot.mode.value
                on_progress(referee.elapsed_s, mode, referee.goal_distance_m)
    finally:
        await flight.close()
        flight.companion.hand_over_log(flight.truth, log_path)
    return referee.ending(wall_time_s=ns_to_seconds(clock.now_ns() - start_ns))


def fly_wire(stage: Stage, log_path: Path, on_progress: Progress | None = None) -> Ending:
    """Fly one scenario in real time and write its log.

    Args:
        stage: the scenario with its seed.
        log_path: where the companion's log goes, with the truth added; must not exist.
        on_progress: called once a second with (seconds, the autopilot's mode, goal distance in m).

    Raises:
        OSError: if an address is taken.
        StartError: if the companion did not even write a log.
    """
    load_kernels()
    gc.collect()
    gc.freeze()
    return run_until_terminated(_fly(stage, log_path, on_progress))
