"""The autopilot's side of MAVLink 2 without sockets: bytes in, bytes out, for two links.

One link goes to the companion, one to the ground station. Messages for somebody else are forwarded from
one to the other, as PX4 does with forwarding enabled. Nothing received can raise; it is counted instead.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from pydantic import Field

from companion.settings import Settings
from sitl import mavlink_commands as commands
from sitl.autopilot import Autopilot
from sitl.autopilot_modes import CommandResult
from sitl.mavlink_frames import Frame, message_class
from sitl.mavlink_inbound import external_vision, offboard_setpoint, vision_position_estimate
from sitl.mavlink_link import Link
from sitl.mavlink_schedule import GROUND_RATES_HZ, ONBOARD_RATES_HZ
from sitl.mavlink_streams import BUILDERS, Snapshot

_TIMESYNC_PERIOD_US = 100_000
_PARAMETERS_PER_POLL = 4
_GROUND_STATION_TYPE = 6
_COMPONENT_ID = 1


class Peer(Enum):
    """Who is at the other end of a link."""

    COMPANION = "companion"
    GROUND = "ground"


@dataclass(frozen=True, slots=True)
class Outgoing:
    """One datagram to send."""

    peer: Peer
    payload: bytes


@dataclass(slots=True)
class EmulatorCounters:
    """What the emulator met on its links.

    Attributes:
        setpoints, setpoints_refused: offboard setpoints taken, and those in unsupported frames.
        odometry, odometry_dropped: external odometry handed to the estimator, and dropped by its type.
        forwarded: frames passed on to another link.
        ignored: well-formed messages for this autopilot that it has no use for.
    """

    setpoints: int = 0
    setpoints_refused: int = 0
    odometry: int = 0
    odometry_dropped: int = 0
    forwarded: int = 0
    ignored: int = 0


class EmulatorSettings(Settings):
    """Imperfections of the autopilot's clock."""

    clock_slow: float = Field(0.0, ge=-0.1, le=0.1)
    """Share by which the boot clock runs slow (0.007 for PX4's own simulator)."""


class MavlinkEmulator:
    """Speaks MAVLink for one autopilot.

    Attributes:
        counters: what was met.
        links: state of each link.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        settings: EmulatorSettings | None = None,
        boot_ns: int = 0,
    ) -> None:
        """Open both links of an autopilot that booted at `boot_ns`.

        Args:
            autopilot: the state machine to speak for; its MAV_SYS_ID is the system id.
            settings: the clock's imperfections, perfect by default.
            boot_ns: boot time on the simulation's clock.
        """
        self.autopilot = autopilot
        self.counters = EmulatorCounters()
        self._settings = settings or EmulatorSettings()
        self._boot_ns = boot_ns
        self._system_id = int(autopilot.parameters["MAV_SYS_ID"])
        self.links = {
            Peer.COMPANION: Link(ONBOARD_RATES_HZ, self._system_id, _COMPONENT_ID),
            Peer.GROUND: Link(GROUND_RATES_HZ, self._system_id, _COMPONENT_ID),
        }
        self._ping_sequence = 0
        self._next_timesync_us = 0
        self._parameters_to_send: dict[Peer, int] = {}
        self._t_ns = boot_ns
        self._handlers: dict[str, Callable[[Peer, Frame], None]] = {
            "HEARTBEAT": self._on_heartbeat,
            "COMMAND_LONG": self._on_command,
            "COMMAND_INT": self._on_command,
            "SET_POSITION_TARGET_LOCAL_NED": self._on_setpoint,
            "ODOMETRY": self._on_odometry,
            "VISION_POSITION_ESTIMATE": self._on_vision_position,
            "TIMESYNC": self._on_timesync,
            "PARAM_SET": self._on_parameter_set,
            "PARAM_REQUEST_READ": self._on_parameter_read,
            "PARAM_REQUEST_LIST": self._on_parameter_list,
            "MANUAL_CONTROL": self._on_manual_control,
        }

    def receive(self, data: bytes, t_ns: int, peer: Peer = Peer.COMPANION) -> list[Outgoing]:
        """Take bytes from a link and return what is answered or forwarded at once.

        Args:
            data: any bytes; a frame may be split over calls.
            t_ns: time of arrival on the simulation's clock.
            peer: the link they came from.
        """
        self._t_ns = max(self._t_ns, t_ns)
        link = self.links[peer]
        for frame in link.cutter.feed(data):
            if (frame.system_id, frame.component_id) == (self._system_id, _COMPONENT_ID):
                continue
            link.learn(frame)
            self._forward(peer, frame)
            if self._is_for_me(frame):
                handler = self._handlers.get(frame.message.get_type())
                if handler is None:
                    self.counters.ignored += 1
                else:
                    handler(peer, frame)
        return self._drain()

    def poll(self, t_ns: int) -> list[Outgoing]:
        """Return the datagrams that are due at `t_ns`."""
        self._t_ns = max(self._t_ns, t_ns)
        boot_us = self.boot_us(self._t_ns)
        due = [(link, name) for link in self.links.values() for name in link.schedule.take_due(boot_us)]
        if due:
            self._send_streams(due)
        if boot_us >= self._next_timesync_us:
            self._next_timesync_us = max(self._next_timesync_us, boot_us - _TIMESYNC_PERIOD_US)
            self._next_timesync_us += _TIMESYNC_PERIOD_US
            for link in self.links.values():
                link.send("TIMESYNC", (0, boot_us * 1000))
        self._send_parameters()
        while self.autopilot.notices:
            severity, text = self.autopilot.notices.popleft()
            self.links[Peer.GROUND].send("STATUSTEXT", (severity, text.encode()[:50], 0, 0))
        return self._drain()

    def boot_us(self, t_ns: int) -> int:
        """Return microseconds since boot on the autopilot's clock."""
        return int((t_ns - self._boot_ns) * (1.0 - self._settings.clock_slow)) // 1000

    def _drain(self) -> list[Outgoing]:
        return [
            Outgoing(peer, data) for peer, link in self.links.items() if link.waits for data in link.drain()
        ]

    def _snapshot(self) -> Snapshot:
        return Snapshot(self.autopilot, self.boot_us(self._t_ns), self._ping_sequence)

    def _send_streams(self, due: list[tuple[Link, str]]) -> None:
        """Send streams on the links where they are due; each is built once."""
        snapshot = self._snapshot()
        built = {name: BUILDERS[name](snapshot) for name in {name: None for _, name in due}}
        self._ping_sequence += "PING" in built
        for link, name in due:
            values = built[name]
            if values is not None:
                link.send(name, values)

    def _is_for_me(self, frame: Frame) -> bool:
        target_system, target_component = _target(frame)
        return target_system in (0, self._system_id) and target_component in (0, _COMPONENT_ID)

    def _forward(self, source: Peer, frame: Frame) -> None:
        if not int(self.autopilot.parameters["MAV_FWDEXTSP"]):
            return
        target = _target(frame)
        if target == (self._system_id, _COMPONENT_ID) or frame.message.get_type() in ("TIMESYNC", "PING"):
            return
        for peer, link in self.links.items():
            if peer is not source and (target == (0, 0) or link.reaches(*target)):
                link.forward(frame.raw)
                self.counters.forwarded += 1

    def _on_heartbeat(self, _: Peer, frame: Frame) -> None:
        if frame.message.type == _GROUND_STATION_TYPE:
            self.autopilot.ground_station_heartbeat(self._t_ns)

    def _on_command(self, peer: Peer, frame: Frame) -> None:
        message = frame.message
        parameters = (message.param1, message.param2, message.param3)
        link, command = self.links[peer], int(message.command)
        if command in (commands.SET_INTERVAL, commands.GET_INTERVAL):
            result = self._message_interval(link, command, parameters)
        elif command in (commands.REQUEST_MESSAGE, commands.REQUEST_CAPABILITIES):
            wanted = 148.0 if command == commands.REQUEST_CAPABILITIES else parameters[0]
            result = self._request_message(link, wanted)
        else:
            result = commands.execute(self.autopilot, command, parameters)
        link.send("COMMAND_ACK", (command, int(result), 0, 0, frame.system_id, frame.component_id))

    def _message_interval(self, link: Link, command: int, parameters: tuple[float, ...]) -> CommandResult:
        name = _stream_name(parameters[0])
        if name is None:
            return CommandResult.FAILED
        if command == commands.GET_INTERVAL:
            link.send("MESSAGE_INTERVAL", (int(parameters[0]), link.schedule.interval_us(name)))
            return CommandResult.ACCEPTED
        changed = link.schedule.set_interval(name, parameters[1], self.boot_us(self._t_ns))
        return CommandResult.ACCEPTED if changed else CommandResult.FAILED

    def _request_message(self, link: Link, wanted: float) -> CommandResult:
        name = _stream_name(wanted)
        values = None if name is None else BUILDERS[name](self._snapshot())
        if name is None or values is None:
            return CommandResult.DENIED
        link.send(name, values)
        return CommandResult.ACCEPTED

    def _on_setpoint(self, _: Peer, frame: Frame) -> None:
        setpoint = offboard_setpoint(frame.message)
        if setpoint is None:
            self.counters.setpoints_refused += 1
            return
        self.counters.setpoints += 1
        self.autopilot.offboard_setpoint(self._t_ns, setpoint)

    def _on_odometry(self, peer: Peer, frame: Frame) -> None:
        sample = external_vision(frame.message, self._sample_time_ns(peer, frame.message.time_usec))
        if sample is None:
            self.counters.odometry_dropped += 1
            return
        self.counters.odometry += 1
        self.autopilot.external_vision(sample)

    def _on_vision_position(self, peer: Peer, frame: Frame) -> None:
        t_sample_ns = self._sample_time_ns(peer, frame.message.usec)
        self.counters.odometry += 1
        self.autopilot.external_vision(vision_position_estimate(frame.message, t_sample_ns))

    def _sample_time_ns(self, peer: Peer, stamp_us: int) -> int:
        """Return a peer's stamp on the simulation's clock, by way of the boot clock."""
        now_us = self.boot_us(self._t_ns)
        age_us = now_us - self.links[peer].timesync.to_boot_us(stamp_us, now_us)
        return self._t_ns - age_us * 1000

    def _on_timesync(self, peer: Peer, frame: Frame) -> None:
        link, message = self.links[peer], frame.message
        now_us = self.boot_us(self._t_ns)
        if message.tc1 == 0:
            link.send("TIMESYNC", (now_us * 1000, message.ts1))
        else:
            link.timesync.reply(now_us, message.ts1 // 1000, message.tc1 // 1000)

    def _on_parameter_set(self, _: Peer, frame: Frame) -> None:
        name = commands.set_parameter(self.autopilot.parameters, frame.message)
        if name is not None:
            for link in self.links.values():
                link.send("PARAM_VALUE", commands.parameter_value(self.autopilot.parameters, name))

    def _on_parameter_read(self, peer: Peer, frame: Frame) -> None:
        name = commands.requested_parameter(self.autopilot.parameters, frame.message)
        if name is not None:
            self.links[peer].send("PARAM_VALUE", commands.parameter_value(self.autopilot.parameters, name))

    def _on_parameter_list(self, peer: Peer, _: Frame) -> None:
        self._parameters_to_send[peer] = 0

    def _send_parameters(self) -> None:
        parameters = self.autopilot.parameters
        for peer, start in list(self._parameters_to_send.items()):
            for name in parameters.names()[start : start + _PARAMETERS_PER_POLL]:
                self.links[peer].send("PARAM_VALUE", commands.parameter_value(parameters, name))
            self._parameters_to_send[peer] = start + _PARAMETERS_PER_POLL
            if self._parameters_to_send[peer] >= len(parameters):
                del self._parameters_to_send[peer]

    def _on_manual_control(self, _: Peer, frame: Frame) -> None:
        if not commands.manual_control(self.autopilot, self._t_ns, frame.message):
            self.counters.ignored += 1


def _target(frame: Frame) -> tuple[int, int]:
    message = frame.message
    system = getattr(message, "target_system", getattr(message, "target", 0))
    return int(system), int(getattr(message, "target_component", 0))


_STREAM_NAMES = {int(message_class(name).id): name for name in BUILDERS}


def _stream_name(number: float) -> str | None:
    return _STREAM_NAMES.get(int(number)) if 0.0 <= number < 2**24 else None
