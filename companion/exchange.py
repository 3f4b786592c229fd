"""Carries values between the pipeline, the autopilot session and the log; the same in flight and in lockstep.

Every method takes what happened and returns the MAVLink messages to send because of it. Control events are
recorded in the order in which the pipeline handles them.
"""

from collections.abc import Iterable, Sequence

from companion.drivers.px4_session import Px4Session
from companion.logs import channels
from companion.logs.recorder import Recorder
from companion.logs.records import CallName, QueuePlace, RuntimeCall, Statistics, UnsentMessages
from companion.messages import (
    Authorisation,
    Datagram,
    FlightState,
    ImuSample,
    LidarScan,
    MavlinkMessage,
    ModeRequest,
    Odometry,
    Output,
    PerceptionUpdate,
    PlanUpdate,
    SensorEvent,
    Setpoint,
    StateChange,
    StatusText,
    Surroundings,
    Tick,
)
from companion.pipeline import Pipeline


class Exchange:
    """One vehicle's traffic between its parts.

    Attributes:
        plan: the role's newest plan, None before the first.
    """

    def __init__(self, pipeline: Pipeline, session: Px4Session, log: Recorder) -> None:
        """Join the parts."""
        self._pipeline = pipeline
        self._session = session
        self._log = log
        self.plan: PlanUpdate | None = None

    @property
    def state(self) -> FlightState:
        """The supervisor's present state."""
        return self._pipeline.state

    def record_datagram(self, datagram: Datagram) -> None:
        """Keep one raw LiDAR datagram."""
        self._log.record(datagram, datagram.t_ns)

    def record_sensor_event(self, event: SensorEvent) -> None:
        """Keep a summary of a scan, or an inertial sample where the settings want it; from any thread."""
        self._log.record(event, event.t_ns)

    def record_place(self, event: SensorEvent, place: int | None) -> None:
        """Keep where an event stands in perception's queue, if the raw packets do not tell; from any thread.

        Args:
            event: what was submitted.
            place: how many events the queue had taken before it, None if it was left out.
        """
        if isinstance(event, ImuSample):
            kind, t_source_ns = "imu", event.t_sensor_ns
        elif isinstance(event, LidarScan):
            kind, t_source_ns = "scan", event.t_sensor_start_ns
        else:
            kind, t_source_ns = "external", event.t_source_ns
        if place is None or kind == "external":
            mark = QueuePlace(event.t_ns, kind, t_source_ns, -1 if place is None else place)
            self._log.record(mark, event.t_ns)

    def record_counters(self, source: str, counters: object, t_ns: int) -> None:
        """Keep all numbers of a statistics snapshot (a slotted dataclass) under the name of its source."""
        values = {name: getattr(counters, name) for name in getattr(counters, "__slots__", ())}
        numbers = {name: value for name, value in values.items() if isinstance(value, (int, float))}
        self._log.record(Statistics(t_ns, source, numbers), t_ns)

    def record_link(self, t_ns: int) -> None:
        """Keep how the link to the autopilot fares; counts by name are summed."""
        statistics = self._session.statistics(t_ns)
        values: dict[str, int | float] = {}
        for name in statistics.__slots__:
            value = getattr(statistics, name)
            if isinstance(value, dict):
                values[name] = sum(value.values())
            elif value is not None:
                values[name] = int(value)
        self._log.record(Statistics(t_ns, "mavlink", values), t_ns)

    def record_sent(self, messages: Iterable[MavlinkMessage], t_ns: int) -> None:
        """Keep what has really left for the autopilot, with the time at which it did."""
        for message in messages:
            self._log.write(channels.MAVLINK_TX, message, t_ns)

    def record_unsent(self, first: int, count: int, t_ns: int) -> None:
        """Keep which messages never left: `count` of them, after the `first` ones that were decided."""
        self._log.record(UnsentMessages(t_ns, first, count), t_ns)

    def starting(self, t_ns: int) -> list[MavlinkMessage]:
        """Return what is due to the autopilot before the flight begins."""
        self._log.record(RuntimeCall(t_ns, CallName.STARTING), t_ns)
        return self._session.poll(t_ns, FlightState.STARTING)

    def receive(self, message: MavlinkMessage, t_ns: int) -> list[MavlinkMessage]:
        """Take one message from the autopilot's link."""
        self._log.write(channels.MAVLINK_RX, message, t_ns)
        return self._session.receive(message, t_ns)

    def update(self, update: PerceptionUpdate, t_ns: int) -> list[MavlinkMessage]:
        """Take one estimate from the heavy half of the pipeline."""
        self._log.record(update, t_ns)
        return self._carry_out(self._pipeline.decide(update), t_ns)

    def refusal(self, authorisation: Authorisation) -> str:
        """Return why an authorisation would not be followed now, or an empty string."""
        return self._pipeline.refusal(authorisation)

    def authorise(self, authorisation: Authorisation) -> list[MavlinkMessage]:
        """Take an operator's permission, or its withdrawal."""
        self._log.record(authorisation, authorisation.t_ns)
        return self._carry_out(self._pipeline.decide(authorisation), authorisation.t_ns)

    def request_stop(self, t_ns: int) -> None:
        """End the flight from outside."""
        self._log.record(RuntimeCall(t_ns, CallName.STOP), t_ns)
        self._pipeline.request_stop(t_ns)

    def tick(self, t_ns: int) -> list[MavlinkMessage]:
        """Decide at host time `t_ns`; call at the setpoint rate."""
        messages: list[MavlinkMessage] = self._carry_out(self._session.reports(), t_ns)
        for text in self._session.autopilot_texts():
            self._log.record(text, t_ns)
        for authorisation in self._session.authorisations():
            messages.extend(self.authorise(authorisation))
        for event in (self._session.vehicle_state(t_ns), Tick(t_ns)):
            self._log.record(event, t_ns)
            messages.extend(self._carry_out(self._pipeline.decide(event), t_ns))
        messages.extend(self._session.poll(t_ns, self._pipeline.state))
        return messages

    def _carry_out(self, outputs: Sequence[Output], t_ns: int) -> list[MavlinkMessage]:
        messages: list[MavlinkMessage] = []
        for output in outputs:
            match output:
                case Setpoint():
                    message = self._session.setpoint(output, t_ns)
                    if message is not None:
                        self._log.record(output, t_ns)
                        messages.append(message)
                case Odometry():
                    message = self._session.odometry(output, t_ns)
                    if message is not None:
                        messages.append(message)
                case ModeRequest():
                    self._log.record(output, t_ns)
                    messages.extend(self._session.request_mode(output.mode, t_ns))
                case StatusText():
                    self._log.record(output, t_ns)
                    messages.extend(self._session.status_text(output))
                case StateChange():
                    # Whatever was asked for belongs to the state that has ended.
                    self._session.withdraw_mode_request()
                    self._log.record(output, t_ns)
                case PlanUpdate():
                    self.plan = output
                    self._log.record(output, t_ns)
                case Surroundings():
                    self._log.record(output, t_ns)
        return messages
