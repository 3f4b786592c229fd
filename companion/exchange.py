"""Carries values between the pipeline, the autopilot session and the log; the same in flight and in lockstep.

Every method takes what happened and returns the MAVLink messages to send because of it.
"""

from collections.abc import Iterable, Sequence
from typing import Protocol

from companion.drivers.px4_session import Px4Session
from companion.messages import (
    Authorisation,
    ControlEvent,
    Datagram,
    FlightState,
    MavlinkMessage,
    ModeRequest,
    Odometry,
    Output,
    PerceptionUpdate,
    PlanUpdate,
    RegisteredScan,
    Setpoint,
    StateChange,
    StatusText,
    Tick,
)
from companion.pipeline import Pipeline

MAVLINK_RECEIVED = "/mavlink/rx"
MAVLINK_SENT = "/mavlink/tx"
LIDAR_PACKETS = "/lidar/packets"


class Recorder(Protocol):
    """Where everything that happened is kept."""

    def write(self, topic: str, message: object, t_ns: int) -> None:
        """Append one message under a topic; never blocks, never raises."""
        ...


class Exchange:
    """One vehicle's traffic between its parts."""

    def __init__(self, pipeline: Pipeline, session: Px4Session, recorder: Recorder) -> None:
        """Join the parts."""
        self._pipeline = pipeline
        self._session = session
        self._recorder = recorder

    @property
    def state(self) -> FlightState:
        """The supervisor's present state."""
        return self._pipeline.state

    def record_datagram(self, datagram: Datagram) -> None:
        """Keep one raw LiDAR datagram."""
        self._recorder.write(LIDAR_PACKETS, datagram, datagram.t_ns)

    def receive(self, message: MavlinkMessage, t_ns: int) -> list[MavlinkMessage]:
        """Take one message from the autopilot's link."""
        self._recorder.write(MAVLINK_RECEIVED, message, t_ns)
        return self._sent(self._session.receive(message, t_ns), t_ns)

    def update(self, update: PerceptionUpdate, t_ns: int) -> list[MavlinkMessage]:
        """Take one estimate from the heavy half of the pipeline."""
        self._record_event(update, t_ns)
        return self._carry_out(self._pipeline.decide(update), t_ns)

    def authorise(self, authorisation: Authorisation) -> list[MavlinkMessage]:
        """Take an operator's permission that did not come over MAVLink."""
        self._record_event(authorisation, authorisation.t_ns)
        return self._carry_out(self._pipeline.decide(authorisation), authorisation.t_ns)

    def request_stop(self, t_ns: int) -> None:
        """End the flight from outside."""
        self._pipeline.request_stop(t_ns)

    def tick(self, t_ns: int) -> list[MavlinkMessage]:
        """Decide at host time `t_ns`; call at the setpoint rate."""
        messages: list[MavlinkMessage] = []
        for authorisation in self._session.authorisations():
            messages.extend(self.authorise(authorisation))
        vehicle = self._session.vehicle_state(t_ns)
        self._record_event(vehicle, t_ns)
        self._pipeline.decide(vehicle)
        messages.extend(self._carry_out(self._pipeline.decide(Tick(t_ns)), t_ns))
        messages.extend(self._sent(self._session.poll(t_ns, self._pipeline.state), t_ns))
        return messages

    def _record_event(self, event: ControlEvent, t_ns: int) -> None:
        match event:
            case Odometry():
                self._recorder.write("/odometry", event, t_ns)
            case RegisteredScan():
                self._recorder.write("/cloud", event, t_ns)
            case Authorisation():
                self._recorder.write("/authorisation", event, t_ns)
            case Tick():
                pass
            case _:
                self._recorder.write("/vehicle", event, t_ns)

    def _carry_out(self, outputs: Sequence[Output], t_ns: int) -> list[MavlinkMessage]:
        messages: list[MavlinkMessage] = []
        for output in outputs:
            match output:
                case Setpoint():
                    message = self._session.setpoint(output, t_ns)
                    if message is not None:
                        self._recorder.write("/setpoint", output, t_ns)
                        messages.append(message)
                case Odometry():
                    message = self._session.odometry(output, t_ns)
                    if message is not None:
                        messages.append(message)
                case ModeRequest():
                    messages.extend(self._session.request_mode(output.mode, t_ns))
                case StatusText():
                    self._recorder.write("/log", output, t_ns)
                    messages.extend(self._session.status_text(output))
                case StateChange():
                    self._recorder.write("/state", output, t_ns)
                case PlanUpdate():
                    self._recorder.write("/plan", output, t_ns)
        return self._sent(messages, t_ns)

    def _sent(self, messages: Iterable[MavlinkMessage], t_ns: int) -> list[MavlinkMessage]:
        kept = list(messages)
        for message in kept:
            self._recorder.write(MAVLINK_SENT, message, t_ns)
        return kept
