"""One vehicle complete: airframe, autopilot, sensor, network, companion and operator, step by step."""

from companion.clock import seconds_to_ns
from companion.logs import channels
from companion.logs.writer import FlightLog
from companion.messages import Datagram
from sitl.mavlink_emulator import Outgoing, Peer
from sitl.network import Network
from sitl.operator import Operator
from sitl.scenario import Stage
from sitl.slots import PointSlots
from sitl.stepped_companion import SteppedCompanion
from sitl.stepped_peer import ADDRESS as PEER_ADDRESS
from sitl.stepped_peer import SteppedPeer
from sitl.vehicle import SimulatedVehicle, build_livox, build_operator

_TRUTH_PERIOD_NS = seconds_to_ns(0.02)


class SteppedVehicle:
    """Advances in steps of 5 ms, each in two halves.

    First it moves, as its autopilot wants; then, once everybody in its world has moved, its sensor measures
    and its companion, autopilot and operator talk.

    Attributes:
        simulated: airframe, autopilot and sensor.
        companion: the parts that fly.
        operator: who arms and authorises.
    """

    def __init__(self, stage: Stage, log: FlightLog, boot_ns: int, operator: Operator | None = None) -> None:
        """Switch everything on at host time `boot_ns`.

        Args:
            stage: where and what.
            log: of this vehicle.
            boot_ns: time of power-on.
            operator: instead of the one whom the scenario describes.
        """
        scenario, profile = stage.scenario, stage.profile
        self._log = log
        self.simulated = SimulatedVehicle(stage, boot_ns)
        self._livox = build_livox(stage, boot_ns)
        self._network = Network(scenario.network, stage.generator("network"), boot_ns)
        self.operator = operator or build_operator(stage)
        self.companion = SteppedCompanion(
            profile,
            log,
            host_ip=profile.lidar.host_ip,
            perception_latency_ns=seconds_to_ns(1e-3 * scenario.perception_latency_ms),
        )
        self._peer: SteppedPeer | None = None
        if profile.odometry.source == "external":
            self._peer = SteppedPeer(profile, boot_ns, seconds_to_ns(1e-3 * scenario.perception_latency_ms))
        self._to_companion: list[bytes] = []
        self._next_truth_ns = boot_ns

    def end_peer(self) -> None:
        """Let the other odometry process die."""
        self._peer = None

    def move(self) -> None:
        """Advance the airframe by 5 ms."""
        self.simulated.move()

    def live(self, slots: PointSlots | None = None) -> None:
        """Measure and talk during the step just made.

        Args:
            slots: what the LiDAR measured, if somebody else simulates it.
        """
        measured = self.simulated.measure(slots)
        t_ns = self.simulated.t_ns
        self._dispatch(self.simulated.mavlink.poll(t_ns))
        lidar = self._livox.inertial(measured.inertial) + self._livox.points(measured.slots)
        for datagram in lidar + self._livox.poll(t_ns):
            self._network.send(datagram)
        to_lidar: list[Datagram] = []
        for datagram in self._network.deliver(t_ns):
            to_lidar.extend(self.companion.receive_datagram(datagram))
            if self._peer is not None:
                self._peer.receive_datagram(datagram)
        if self._peer is not None:
            for data in self._peer.step(t_ns):
                self.companion.receive_external(data, PEER_ADDRESS, t_ns)
        to_autopilot: list[bytes] = []
        waiting, self._to_companion = self._to_companion, []
        for data in waiting:
            to_autopilot.extend(self.companion.receive_mavlink(data, t_ns))
        datagrams, data_due = self.companion.step(t_ns)
        for datagram in to_lidar + datagrams:
            for answer in self._livox.receive(datagram):
                self._network.send(answer)
        for data in to_autopilot + data_due:
            self._dispatch(self.simulated.mavlink.receive(data, t_ns, Peer.COMPANION))
        for data in self.operator.poll(t_ns):
            self._dispatch(self.simulated.mavlink.receive(data, t_ns, Peer.GROUND))
        if t_ns >= self._next_truth_ns:
            self._next_truth_ns = t_ns + _TRUTH_PERIOD_NS
            self._log.write(channels.TRUTH, self.simulated.true_pose(), t_ns)

    def _dispatch(self, outgoing: list[Outgoing]) -> None:
        """Bytes for the companion arrive with the next step; the operator hears at once."""
        for item in outgoing:
            if item.peer is Peer.COMPANION:
                self._to_companion.append(item.payload)
            else:
                self.operator.receive(item.payload, self.simulated.t_ns)
