"""The parts that fly, driven step by step: no threads, no sockets, the same bytes."""

from collections import deque
from collections.abc import Sequence
from typing import Protocol

from companion.assembly import assemble
from companion.clock import seconds_to_ns
from companion.config import Profile
from companion.decision_schedule import DecisionSchedule
from companion.drivers.external_odometry import ExternalOdometryReceiver
from companion.drivers.livox_framing import LivoxReceiver, LivoxStatistics
from companion.drivers.livox_handshake import LivoxHandshake
from companion.drivers.mavlink_codec import MavlinkEncoder, MavlinkParser
from companion.drivers.px4_session import Px4Session
from companion.exchange import Exchange
from companion.logs.writer import FlightLog
from companion.messages import (
    Datagram,
    FlightState,
    LidarScan,
    MavlinkMessage,
    NeighbourTracks,
    Odometry,
    PerceptionUpdate,
    RegisteredScan,
    SensorEvent,
)

_STATISTICS_PERIOD_NS = seconds_to_ns(1.0)


class SteppedCompanion:
    """One vehicle's companion; the same drivers, pipeline and exchange as in flight, called in turn.

    Attributes:
        tracks: other UAVs after the newest scan, None before the first.
        scan_odometry: own motion at that scan's end.
    """

    def __init__(self, profile: Profile, log: FlightLog, *, host_ip: str, perception_latency_ns: int) -> None:
        """Build every part; `perception_latency_ns` is what computing a scan takes."""
        self._pipeline = assemble(profile)
        self._session = Px4Session(profile.autopilot)
        self._exchange = Exchange(self._pipeline, self._session, log)
        self._receiver = LivoxReceiver(profile.lidar)
        self._external = ExternalOdometryReceiver(profile.external_odometry)
        self._handshake = LivoxHandshake(profile.lidar, host_ip)
        self._keeps_packets = profile.log.raw_lidar
        self._data_ports = (profile.lidar.host_ports.points, profile.lidar.host_ports.imu)
        self._encoder = MavlinkEncoder()
        self._parser = MavlinkParser()
        self._perception = PerceptionQueue(self._pipeline, perception_latency_ns)
        self._schedule = DecisionSchedule(round(1e9 / profile.autopilot.setpoint_hz), 0)
        self._next_statistics_ns = 0
        self.tracks: NeighbourTracks | None = None
        self.scan_odometry: Odometry | None = None

    @property
    def state(self) -> FlightState:
        """The supervisor's present state."""
        return self._exchange.state

    @property
    def mission_over(self) -> bool:
        """Whether a leader's pause at its last waypoint has ended, by its own account."""
        plan = self._exchange.plan
        return plan is not None and plan.status == "arrived"

    def lidar_statistics(self) -> LivoxStatistics:
        """Return what was received from the LiDAR."""
        return self._receiver.statistics()

    def receive_datagram(self, datagram: Datagram) -> list[Datagram]:
        """Take one datagram from the LiDAR; return what is answered."""
        if datagram.destination[1] not in self._data_ports:
            return self._handshake.receive(datagram)
        if self._keeps_packets:
            self._exchange.record_datagram(datagram)
        for event in self._receiver.receive(datagram):
            self._exchange.record_sensor_event(event)
            self._exchange.record_place(event, self._perception.submit(event))
        return []

    def receive_external(self, data: bytes, source: tuple[str, int], t_ns: int) -> None:
        """Take one datagram of another process's odometry."""
        for event in self._external.receive(t_ns, source, data):
            self._exchange.record_sensor_event(event)
            self._exchange.record_place(event, self._perception.submit(event))

    def receive_mavlink(self, data: bytes, t_ns: int) -> list[bytes]:
        """Take bytes from the autopilot; return what is answered."""
        answers: list[MavlinkMessage] = []
        for message in self._parser.feed(data):
            answers.extend(self._exchange.receive(message, t_ns))
        return self._send(answers, t_ns)

    def step(self, t_ns: int) -> tuple[list[Datagram], list[bytes]]:
        """Do everything that is due at `t_ns`; return datagrams to the LiDAR and bytes to the autopilot."""
        self._handshake.observe_data(self._receiver.t_points_ns, self._receiver.t_imu_ns)
        datagrams = self._handshake.poll(t_ns)
        messages: list[MavlinkMessage] = []
        updates = self._perception.finished(t_ns)
        for update in updates:
            messages.extend(self._exchange.update(update, t_ns))
            if isinstance(update, NeighbourTracks):
                self.tracks = update
            elif isinstance(update, RegisteredScan):
                self.scan_odometry = update.odometry
        if any(isinstance(update, RegisteredScan) for update in updates):
            messages.extend(self._exchange.tick(t_ns))
            self._schedule.seen(t_ns)
        elif self._schedule.due(t_ns):
            messages.extend(self._exchange.tick(t_ns))
            self._schedule.decided(t_ns)
        if t_ns >= self._next_statistics_ns:
            self._next_statistics_ns = t_ns + _STATISTICS_PERIOD_NS
            self._exchange.record_counters("lidar", self._receiver.statistics(), t_ns)
            self._exchange.record_link(t_ns)
            if self._pipeline.role_counters is not None:
                self._exchange.record_counters("policy", self._pipeline.role_counters, t_ns)
        return datagrams, self._send(messages, t_ns)

    def _send(self, messages: list[MavlinkMessage], t_ns: int) -> list[bytes]:
        if not messages:
            return []
        self._exchange.record_sent(messages, t_ns)
        return [self._encoder.encode(message) for message in messages]


class Perceiving(Protocol):
    """Who estimates: a pipeline, or somebody else's process."""

    def perceive(self, event: SensorEvent) -> Sequence[PerceptionUpdate]:
        """Take one event in; return the estimates that became known."""
        ...


class PerceptionQueue:
    """Computing time as simulated time: what arrives while a scan is being worked on has to wait."""

    def __init__(self, pipeline: Perceiving, latency_ns: int) -> None:
        """Take `latency_ns` for every scan and none for an IMU sample."""
        self._pipeline = pipeline
        self._latency_ns = latency_ns
        self._events: deque[SensorEvent] = deque()
        self._results: deque[tuple[int, Sequence[PerceptionUpdate]]] = deque()
        self._busy_until_ns = 0
        self._taken = 0

    def submit(self, event: SensorEvent) -> int:
        """Queue one event; return how many were queued before it."""
        self._events.append(event)
        self._taken += 1
        return self._taken - 1

    def finished(self, t_ns: int) -> list[PerceptionUpdate]:
        """Work until `t_ns`; return the estimates that are finished by then."""
        while self._events and self._busy_until_ns <= t_ns:
            event = self._events.popleft()
            updates = self._pipeline.perceive(event)
            if isinstance(event, LidarScan):
                self._busy_until_ns = t_ns + self._latency_ns
            if updates:
                self._results.append((max(t_ns, self._busy_until_ns), updates))
        done: list[PerceptionUpdate] = []
        while self._results and self._results[0][0] <= t_ns:
            done.extend(self._results.popleft()[1])
        return done
