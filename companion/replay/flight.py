"""A recorded flight through the parts that fly: the same drivers, pipeline and exchange, fed from its log.

No sockets, no threads, no clock: every part is called with the times that the log holds.
"""

from collections.abc import Callable
from typing import cast

from companion.assembly import assemble
from companion.clock import seconds_to_ns
from companion.config import Profile
from companion.drivers.livox_framing import LivoxReceiver
from companion.drivers.px4_session import Px4Session
from companion.exchange import Exchange
from companion.logs import channels
from companion.logs.channels import Channel
from companion.logs.reader import EncodedEntry
from companion.logs.records import CallName, QueuePlace, RuntimeCall, ScanMark, UnsentMessages
from companion.messages import (
    Authorisation,
    Datagram,
    ExternalOdometry,
    MavlinkMessage,
    NeighbourTracks,
    Odometry,
    PerceptionUpdate,
    RegisteredScan,
    SensorEvent,
    Tick,
)
from companion.replay.comparison import Ends
from companion.replay.holes import Holes
from companion.replay.perception import PerceptionReplay, UpdateKey
from companion.replay.recorder import ReplayRecorder

# What perception may still have been working on when the flight ended: it gets two seconds to finish.
_UNHANDLED_NS = seconds_to_ns(3.0)
_UNWRITTEN_NS = seconds_to_ns(0.2)

SENSOR_INPUTS = (
    channels.LIDAR_PACKETS,
    channels.EXTERNAL_ODOMETRY,
    channels.QUEUE_PLACE,
    channels.ODOMETRY,
    channels.NEIGHBOURS,
    channels.SCAN,
)


class FlightReplay:
    """Takes the messages of a recorded flight in their order, and flies them again."""

    def __init__(
        self,
        profile: Profile,
        recorder: ReplayRecorder,
        holes: Holes,
        *,
        odometry_only: bool,
        on_update: Callable[[PerceptionUpdate], None],
    ) -> None:
        """Build every part.

        Args:
            profile: to fly with.
            recorder: takes what comes out.
            holes: told of what cannot be decoded.
            odometry_only: leave decisions out.
            on_update: told every estimate, in the order in which it is handled.
        """
        pipeline = assemble(profile)
        self._recorder = recorder
        self._holes = holes
        self._on_update = on_update
        self._odometry_only = odometry_only
        self._exchange = Exchange(pipeline, Px4Session(profile.autopilot), recorder)
        self.perception = PerceptionReplay(
            LivoxReceiver(profile.lidar), pipeline.perceive, self._take_sensor_event
        )
        self.packets = 0
        self._t_packets_ns = 0
        self._t_update_ns = 0
        self._t_tick_ns = 0

    def take(self, entry: EncodedEntry) -> None:
        """Take the next message of the recording."""
        handle = _HANDLERS.get(entry.channel.topic)
        if handle is None or (self._odometry_only and entry.channel not in SENSOR_INPUTS):
            return
        try:
            message = entry.message()
        except ValueError:
            self._holes.undecodable(entry)
            return
        handle(self, message, entry.t_ns)

    def finish(self) -> None:
        """Work on what is left: sensor data of which nothing was handled before the recording ended."""
        for update in self.perception.rest():
            self._on_update(update)
            t_ns = update.t_ns if isinstance(update, RegisteredScan) else max(update.t_ns, self._t_update_ns)
            self._recorder.record(update, t_ns)

    def ends_of(self, channel: Channel, *, complete: bool) -> Ends:
        """Return where the recording of a channel ends; `complete` if the log was closed properly."""
        if channel in (channels.LIDAR_FRAMES, channels.IMU):
            end_ns = self._t_packets_ns - _UNWRITTEN_NS
            return Ends(end_ns, end_ns)
        if channel in (channels.ODOMETRY, channels.NEIGHBOURS, channels.SCAN, channels.CLOUD):
            return Ends(None, self._t_update_ns - _UNHANDLED_NS)
        return Ends() if complete else Ends(self._t_tick_ns + 1, self._t_tick_ns)

    def _take_sensor_event(self, event: SensorEvent) -> None:
        self._exchange.record_sensor_event(event)

    def _take_packets(self, message: object, t_ns: int) -> None:
        datagrams = cast(tuple[Datagram, ...], message)
        self.packets += len(datagrams)
        self._t_packets_ns = t_ns
        self.perception.take_datagrams(datagrams)

    def _take_external(self, message: object, t_ns: int) -> None:
        self.perception.take_external(cast(ExternalOdometry, message))

    def _take_place(self, message: object, t_ns: int) -> None:
        self.perception.take_place(cast(QueuePlace, message))

    def _take_odometry(self, message: object, t_ns: int) -> None:
        self._handle_until(("odometry", cast(Odometry, message).t_sensor_ns), t_ns)

    def _take_neighbours(self, message: object, t_ns: int) -> None:
        self._handle_until(("neighbours", cast(NeighbourTracks, message).sequence), t_ns)

    def _take_scan(self, message: object, t_ns: int) -> None:
        self._handle_until(("scan", cast(ScanMark, message).sequence), t_ns)

    def _handle_until(self, wanted: UpdateKey, t_ns: int) -> None:
        self._t_update_ns = t_ns
        for update in self.perception.until(wanted, t_ns):
            self._on_update(update)
            if self._odometry_only:
                self._recorder.record(update, t_ns)
            else:
                self._recorder.decided(self._exchange.update(update, t_ns), t_ns)

    def _take_mavlink(self, message: object, t_ns: int) -> None:
        self._recorder.decided(self._exchange.receive(cast(MavlinkMessage, message), t_ns), t_ns)

    def _take_authorisation(self, message: object, t_ns: int) -> None:
        authorisation = cast(Authorisation, message)
        # Those of a ground station come out of its messages again.
        if authorisation.source == "command":
            self._recorder.decided(self._exchange.authorise(authorisation), t_ns)

    def _take_tick(self, message: object, t_ns: int) -> None:
        self._t_tick_ns = t_ns
        tick = cast(Tick, message)
        self._recorder.decided(self._exchange.tick(tick.t_ns), tick.t_ns)

    def _take_call(self, message: object, t_ns: int) -> None:
        call = cast(RuntimeCall, message)
        if call.name is CallName.STOP:
            self._exchange.request_stop(call.t_ns)
        else:
            # What is said before the flight goes out directly and is not recorded.
            self._exchange.starting(call.t_ns)

    def _take_unsent(self, message: object, t_ns: int) -> None:
        unsent = cast(UnsentMessages, message)
        if self._recorder.sent is not None:
            self._recorder.sent.take_unsent(unsent.first, unsent.count)


_HANDLERS: dict[str, Callable[[FlightReplay, object, int], None]] = {
    channels.LIDAR_PACKETS.topic: FlightReplay._take_packets,
    channels.EXTERNAL_ODOMETRY.topic: FlightReplay._take_external,
    channels.QUEUE_PLACE.topic: FlightReplay._take_place,
    channels.ODOMETRY.topic: FlightReplay._take_odometry,
    channels.NEIGHBOURS.topic: FlightReplay._take_neighbours,
    channels.SCAN.topic: FlightReplay._take_scan,
    channels.MAVLINK_RX.topic: FlightReplay._take_mavlink,
    channels.AUTHORISATION.topic: FlightReplay._take_authorisation,
    channels.TICK.topic: FlightReplay._take_tick,
    channels.CALL.topic: FlightReplay._take_call,
    channels.MAVLINK_UNSENT.topic: FlightReplay._take_unsent,
}
