"""A flight step by step: no sockets, no threads, no real time, the same bytes, the same result each time."""

import gc
from collections.abc import Callable
from pathlib import Path

from companion.clock import SystemClock, ns_to_seconds, seconds_to_ns
from companion.config import profile_text
from companion.logs import channels
from companion.logs.metadata import FlightMetadata
from companion.logs.writer import FlightLog
from companion.messages import Datagram, FlightState
from sitl.mavlink_emulator import Outgoing, Peer
from sitl.network import Network
from sitl.outcome import Ending
from sitl.referee import Referee
from sitl.scenario import Stage
from sitl.stepped_companion import SteppedCompanion
from sitl.stepped_peer import ADDRESS as PEER_ADDRESS
from sitl.stepped_peer import SteppedPeer
from sitl.vehicle import SimulatedVehicle, build_livox, build_operator

BOOT_NS = 1_000_000_000
"""Host time at power-on; any value but zero, which some fields take for "never"."""

_TRUTH_PERIOD_NS = seconds_to_ns(0.02)
_PROGRESS_PERIOD_NS = seconds_to_ns(1.0)

Progress = Callable[[float, str, float], None]


class Lockstep:
    """One vehicle, its companion and its operator, advanced together in steps of 5 ms."""

    def __init__(self, stage: Stage, log: FlightLog) -> None:
        """Switch everything on."""
        scenario, profile = stage.scenario, stage.profile
        self._log = log
        self._vehicle = SimulatedVehicle(stage, BOOT_NS)
        self._livox = build_livox(stage, BOOT_NS)
        self._network = Network(scenario.network, stage.generator("network"), BOOT_NS)
        self._operator = build_operator(stage)
        self._referee = Referee(stage, BOOT_NS)
        self._companion = SteppedCompanion(
            profile,
            log,
            host_ip=profile.lidar.host_ip,
            perception_latency_ns=seconds_to_ns(1e-3 * scenario.perception_latency_ms),
        )
        self._peer: SteppedPeer | None = None
        if profile.odometry.source == "external":
            self._peer = SteppedPeer(profile, BOOT_NS, seconds_to_ns(1e-3 * scenario.perception_latency_ms))
        self._to_companion: list[bytes] = []
        self._next_truth_ns = BOOT_NS

    @property
    def referee(self) -> Referee:
        """Who decides whether the flight has ended, and how."""
        return self._referee

    @property
    def state(self) -> FlightState:
        """The companion's state."""
        return self._companion.state

    def end_peer(self) -> None:
        """Let the other odometry process die."""
        self._peer = None

    def step(self) -> None:
        """Advance everything by 5 ms."""
        measured = self._vehicle.step()
        t_ns = self._vehicle.t_ns
        self._dispatch(self._vehicle.mavlink.poll(t_ns))
        lidar = self._livox.inertial(measured.inertial) + self._livox.points(measured.slots)
        for datagram in lidar + self._livox.poll(t_ns):
            self._network.send(datagram)
        to_lidar: list[Datagram] = []
        for datagram in self._network.deliver(t_ns):
            to_lidar.extend(self._companion.receive_datagram(datagram))
            if self._peer is not None:
                self._peer.receive_datagram(datagram)
        if self._peer is not None:
            for data in self._peer.step(t_ns):
                self._companion.receive_external(data, PEER_ADDRESS, t_ns)
        to_autopilot: list[bytes] = []
        waiting, self._to_companion = self._to_companion, []
        for data in waiting:
            to_autopilot.extend(self._companion.receive_mavlink(data, t_ns))
        datagrams, data_due = self._companion.step(t_ns)
        for datagram in to_lidar + datagrams:
            for answer in self._livox.receive(datagram):
                self._network.send(answer)
        for data in to_autopilot + data_due:
            self._dispatch(self._vehicle.mavlink.receive(data, t_ns, Peer.COMPANION))
        for data in self._operator.poll(t_ns):
            self._dispatch(self._vehicle.mavlink.receive(data, t_ns, Peer.GROUND))
        if t_ns >= self._next_truth_ns:
            self._next_truth_ns = t_ns + _TRUTH_PERIOD_NS
            self._log.write(channels.TRUTH, self._vehicle.true_pose(), t_ns)
        self._referee.watch(self._vehicle.sighting())

    def _dispatch(self, outgoing: list[Outgoing]) -> None:
        """Bytes for the companion arrive with the next step; the operator hears at once."""
        for item in outgoing:
            if item.peer is Peer.COMPANION:
                self._to_companion.append(item.payload)
            else:
                self._operator.receive(item.payload, self._vehicle.t_ns)


def fly_lockstep(stage: Stage, log_path: Path, on_progress: Progress | None = None) -> Ending:
    """Fly one scenario to its end and write its log.

    Args:
        stage: the scenario with its seed.
        log_path: where the log goes; must not exist.
        on_progress: called once per simulated second with (seconds, state, goal distance in m).
    """
    metadata = FlightMetadata(
        vehicle=stage.profile.vehicle.name,
        role=stage.profile.role,
        mode="lockstep",
        configuration=profile_text(stage.profile),
        seed=stage.scenario.seed,
    )
    clock = SystemClock()
    wall_start_ns = clock.now_ns()
    log = FlightLog(log_path, stage.profile.log, metadata, threaded=False)
    try:
        lockstep = Lockstep(stage, log)
        gc.collect()
        gc.freeze()  # nothing built so far ever becomes garbage during the flight
        referee = lockstep.referee
        next_progress_ns = BOOT_NS
        while not referee.over:
            lockstep.step()
            if on_progress is not None and referee.t_ns >= next_progress_ns:
                next_progress_ns = referee.t_ns + _PROGRESS_PERIOD_NS
                on_progress(referee.elapsed_s, lockstep.state.value, referee.goal_distance_m)
    finally:
        log.close()
    return referee.ending(wall_time_s=ns_to_seconds(clock.now_ns() - wall_start_ns))
