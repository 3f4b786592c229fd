"""Conversation with one PX4 autopilot, without sockets: messages in, messages out.

Only the autopilot of the configured system id is believed; only configured ground stations may grant
control. Nothing that arrives raises: what cannot be used is counted. Nothing leaves that is not finite,
fresh and addressed. Commands are repeated a bounded number of times; setpoints never.
"""

from collections import Counter

from companion.clock import NANOSECONDS_PER_SECOND, seconds_to_ns
from companion.drivers import px4_commands, px4_messages
from companion.drivers.mavlink_fields import integer
from companion.drivers.px4_authority import Authority
from companion.drivers.px4_commands import Commands
from companion.drivers.px4_gates import OdometryGate, SetpointGate, TextGate
from companion.drivers.px4_mode_request import ModeRequests, ModeRequestStatus
from companion.drivers.px4_modes import TYPE_GROUND_STATION, system_status_of
from companion.drivers.px4_param_client import ParameterClient
from companion.drivers.px4_settings import Px4Settings
from companion.drivers.px4_statistics import LinkStatistics
from companion.drivers.px4_timesync import AutopilotClock
from companion.drivers.px4_vehicle import AutopilotHealth, Px4Vehicle
from companion.errors import ProtocolError
from companion.messages import (
    Authorisation,
    FlightState,
    MavlinkMessage,
    Odometry,
    Setpoint,
    Severity,
    StatusText,
    VehicleMode,
    VehicleState,
)

# Telemetry that is asked for, by message number and rate; HEARTBEAT cannot be had faster than 1 Hz,
# which is why CURRENT_MODE is asked for: it tells of a mode change sooner.
_TELEMETRY_HZ = {32: 30, 31: 50, 331: 30, 245: 10, 436: 10, 230: 10}
_HEARTBEAT_NS = seconds_to_ns(1.0)
_MAX_FOREIGN = 16
_MAX_REPORTS = 32


class Px4Session:
    """State of the conversation; all times are host monotonic nanoseconds."""

    def __init__(self, settings: Px4Settings) -> None:
        """Begin unconnected."""
        self._settings = settings
        self._vehicle = Px4Vehicle()
        self._address = (settings.system_id, settings.component_id)
        self._clock = AutopilotClock(round(NANOSECONDS_PER_SECOND / settings.timesync_hz), self._address)
        self._commands = Commands()
        self._authority = Authority(settings)
        self._setpoint_gate = SetpointGate(settings)
        self._odometry_gate = OdometryGate(settings)
        self._text_gate = TextGate()
        self.parameters = ParameterClient(settings.system_id)
        """Reads and writes the autopilot's parameters; its messages go out with `poll`."""
        self._heartbeat_due_ns: int | None = None
        self._was_connected = False
        self._mode_requests = ModeRequests(self._commands)
        self._received: Counter[str] = Counter()
        self._foreign: Counter[int] = Counter()
        self._refused: Counter[str] = Counter()
        self._sent: Counter[str] = Counter()
        self._malformed = 0
        self._reboots = 0
        self._reports: list[StatusText] = []

    def receive(self, message: MavlinkMessage, t_ns: int) -> list[MavlinkMessage]:
        """Take one message that arrived at `t_ns`; return the replies to send at once."""
        try:
            return self._receive(message, t_ns)
        except ProtocolError:
            self._malformed += 1
            return []

    def _receive(self, message: MavlinkMessage, t_ns: int) -> list[MavlinkMessage]:
        if message.name in ("COMMAND_LONG", "COMMAND_INT"):
            answer = self._authority.receive(message, t_ns)
            return [] if answer is None else [self._message("COMMAND_ACK", answer)]
        if message.system_id != self._settings.system_id:
            self._count_foreign(message)
            return []
        if message.component_id != px4_messages.AUTOPILOT_COMPONENT:
            return []
        self._received[message.name] += 1
        if message.name == "TIMESYNC":
            return self._take_timesync(message, t_ns)
        if message.name == "COMMAND_ACK":
            self._take_acknowledgement(message, t_ns)
        elif message.name == "PARAM_VALUE":
            self.parameters.receive(message, t_ns)
        else:
            self._vehicle.receive(message, t_ns)
            self._notice_connection(t_ns)
        return []

    def poll(self, t_ns: int, state: FlightState | None) -> list[MavlinkMessage]:
        """Return what is due at `t_ns`: heartbeat, clock question, commands, parameter requests.

        Args:
            t_ns: host time.
            state: the companion's state, for the heartbeat; None before there is one.
        """
        self._notice_connection(t_ns)
        messages: list[MavlinkMessage] = []
        if self._heartbeat_due_ns is None or t_ns >= self._heartbeat_due_ns:
            self._heartbeat_due_ns = t_ns + _HEARTBEAT_NS
            messages.append(self._message("HEARTBEAT", px4_messages.heartbeat(system_status_of(state))))
        if not self._was_connected:
            return messages
        question = self._clock.request(t_ns)
        if question is not None:
            messages.append(self._message("TIMESYNC", question))
        self._mode_requests.observe(self._vehicle.mode, self._vehicle.mode_changes)
        messages.extend(self._due_commands(t_ns))
        messages.extend(self._message(name, fields) for name, fields in self.parameters.poll(t_ns))
        return messages

    def setpoint(self, setpoint: Setpoint, t_ns: int) -> MavlinkMessage | None:
        """Return the message for one velocity setpoint, or None if it must not leave.

        Refused are numbers that are not finite, decisions older than the limit, and motion that rests on
        sensor data older than the limit; standing still needs no data.
        """
        refusal = "" if self._vehicle.connected(t_ns) else "not connected"
        refusal = refusal or self._setpoint_gate.refusal(setpoint, t_ns)
        autopilot_ns = self._clock.autopilot_ns(t_ns, t_ns)
        time_boot_ms = (t_ns if autopilot_ns is None else max(autopilot_ns, 0)) // 1_000_000
        fields = px4_messages.velocity_setpoint(setpoint, self._settings.system_id, time_boot_ms)
        if fields is None:
            refusal = "not finite"
        return self._gated("SET_POSITION_TARGET_LOCAL_NED", "setpoint", fields, refusal)

    def odometry(self, odometry: Odometry, t_ns: int) -> MavlinkMessage | None:
        """Return the message for one odometry estimate, or None if it must not leave.

        Refused are estimates that are lost, poor, old or not finite, those in excess of the rate, and
        every one while the autopilot's time is unknown.
        """
        autopilot_ns = self._clock.autopilot_ns(odometry.t_ns, t_ns)
        if autopilot_ns is None or autopilot_ns <= 0:
            self._refused["odometry without clock"] += 1
            return None
        refusal = self._odometry_gate.refusal(odometry, t_ns)
        fields = None
        if not refusal:
            noise = self._settings.angular_rate_noise_rad_s
            fields = px4_messages.external_odometry(odometry, autopilot_ns // 1000, noise)
            refusal = "not finite" if fields is None else ""
        return self._gated("ODOMETRY", "odometry", fields, refusal)

    def _gated(
        self, name: str, kind: str, fields: dict[str, object] | None, refusal: str
    ) -> MavlinkMessage | None:
        if fields is None or refusal:
            self._refused[f"{kind} {refusal}"] += 1
            return None
        self._sent[kind] += 1
        return self._message(name, fields)

    def request_mode(self, mode: VehicleMode, t_ns: int) -> list[MavlinkMessage]:
        """Ask for a flight mode; `mode_request` tells what became of it.

        The command is repeated until it is answered, but not once the autopilot has gone to another mode
        meanwhile: whoever changed it has the last word.

        Raises:
            ValueError: for an unknown mode.
        """
        vehicle = self._vehicle
        self._mode_requests.begin(mode, armed=vehicle.armed, mode_changes=vehicle.mode_changes)
        return self._due_commands(t_ns) if vehicle.connected(t_ns) else []

    def withdraw_mode_request(self) -> None:
        """Do not repeat a mode request that has not been answered yet."""
        self._mode_requests.withdraw()

    @property
    def mode_request(self) -> ModeRequestStatus:
        """The latest mode request and its outcome."""
        return self._mode_requests.status

    def status_text(self, status: StatusText) -> list[MavlinkMessage]:
        """Return the message for one line to the ground; none if it repeats itself or comes too fast."""
        refusal = self._text_gate.refusal(status)
        message = self._gated("STATUSTEXT", "text", px4_messages.status_text(status), refusal)
        return [] if message is None else [message]

    def vehicle_state(self, t_ns: int) -> VehicleState:
        """Return the latest state of the vehicle as known at `t_ns`."""
        return self._vehicle.state(t_ns)

    def health(self) -> AutopilotHealth:
        """Return the autopilot's view of itself."""
        return self._vehicle.health()

    def authorisations(self) -> list[Authorisation]:
        """Return what ground stations granted or revoked since the last call."""
        return self._authority.drain()

    def reports(self) -> list[StatusText]:
        """Return what happened to the link since the last call: found, lost, autopilot started anew."""
        reports, self._reports = self._reports, []
        return reports

    def autopilot_texts(self) -> list[StatusText]:
        """Return the autopilot's own status texts since the last call."""
        texts = list(self._vehicle.texts)
        self._vehicle.texts.clear()
        return texts

    def foreign_autopilots(self) -> list[int]:
        """Return the system ids of other vehicles heard on this link."""
        return sorted(self._foreign)

    def statistics(self, t_ns: int) -> LinkStatistics:
        """Return the counts at host time `t_ns`."""
        return LinkStatistics(
            received=dict(self._received),
            foreign=dict(self._foreign),
            malformed=self._malformed,
            wrong_target=self._authority.wrong_target,
            denied_authorisations=self._authority.denied,
            refused=dict(self._refused),
            sent=dict(self._sent),
            commands_denied=self._commands.denied,
            commands_timed_out=self._commands.timed_out,
            unmatched_timesync=self._clock.unmatched,
            reboots=self._reboots,
            round_trip_ns=self._clock.round_trip_ns,
            clock_offset_ns=self._clock.offset_ns(t_ns),
            suspect=self._vehicle.suspect(t_ns),
        )

    def _take_timesync(self, message: MavlinkMessage, t_ns: int) -> list[MavlinkMessage]:
        answer, started_anew = self._clock.receive(message, t_ns)
        if started_anew:
            self._reboots += 1
            self._report(t_ns, Severity.WARNING, "autopilot started anew")
            self._vehicle.forget()
            self._commands.clear()
            self.parameters.clear()
            self._was_connected = False
        return [] if answer is None else [self._message("TIMESYNC", answer)]

    def _take_acknowledgement(self, message: MavlinkMessage, t_ns: int) -> None:
        # An acknowledgement without target comes from an old autopilot.
        addressee = (
            integer(message, "target_system", 0, 0xFF),
            integer(message, "target_component", 0, 0xFF),
        )
        if addressee in ((0, 0), self._address):
            self._commands.receive(message, t_ns)

    def _notice_connection(self, t_ns: int) -> None:
        connected = self._vehicle.connected(t_ns)
        if connected and not self._was_connected:
            self._report(t_ns, Severity.INFO, f"autopilot {self._settings.system_id} connected")
            for number, rate_hz in _TELEMETRY_HZ.items():
                interval_us = round(1e6 / rate_hz)
                values = px4_commands.parameters(float(number), float(interval_us), rest=0.0)
                self._commands.begin(px4_commands.SET_MESSAGE_INTERVAL, values)
        elif self._was_connected and not connected:
            self._report(t_ns, Severity.CRITICAL, "autopilot lost")
            self._commands.clear()
        self._was_connected = connected

    def _count_foreign(self, message: MavlinkMessage) -> None:
        is_station = (message.system_id, message.component_id) in self._authority.stations
        if is_station or message.fields.get("type") == TYPE_GROUND_STATION:
            return
        if message.system_id in self._foreign or len(self._foreign) < _MAX_FOREIGN:
            self._foreign[message.system_id] += 1

    def _report(self, t_ns: int, severity: Severity, text: str) -> None:
        if len(self._reports) < _MAX_REPORTS:
            self._reports.append(StatusText(t_ns, severity, text))

    def _due_commands(self, t_ns: int) -> list[MavlinkMessage]:
        target = {
            "target_system": self._settings.system_id,
            "target_component": px4_messages.AUTOPILOT_COMPONENT,
        }
        return [self._message("COMMAND_LONG", {**target, **fields}) for fields in self._commands.poll(t_ns)]

    def _message(self, name: str, fields: dict[str, object]) -> MavlinkMessage:
        return MavlinkMessage(name, *self._address, fields)
