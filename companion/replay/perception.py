"""The heavy half of a recorded flight, once more: datagrams to estimates, in the order in which it worked.

In flight three threads meet here. Which events perception saw, and in which order, follows from the raw
datagrams (recorded in the order in which they were handled) and from the places in its queue that the log
keeps for the rest. When an estimate was handled follows from the journal; so events are worked on only when
the journal asks for what they give, and by then everything about their places has been read.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence

from companion.drivers.livox_framing import LivoxReceiver
from companion.logs.records import QueuePlace
from companion.messages import (
    Datagram,
    ExternalOdometry,
    ImuSample,
    LidarScan,
    NeighbourTracks,
    PerceptionUpdate,
    RegisteredScan,
    SensorEvent,
)

# More than perception's queue ever held: whatever waits beyond this, nobody will ask for in particular.
_MAX_WAITING = 4000
_MAX_MARKS = 10_000

UpdateKey = tuple[str, int]
_Mark = tuple[str, int, int]


def key_of(update: PerceptionUpdate) -> UpdateKey:
    """Return what names an estimate in the recorded and in the replayed flight alike."""
    if isinstance(update, RegisteredScan):
        return "scan", update.sequence
    if isinstance(update, NeighbourTracks):
        return "neighbours", update.sequence
    return "odometry", update.t_sensor_ns


class PerceptionReplay:
    """Works on recorded sensor data when asked for what it gives.

    Attributes:
        skipped: events left out because they had been left out in flight.
    """

    def __init__(
        self,
        receiver: LivoxReceiver,
        perceive: Callable[[SensorEvent], Sequence[PerceptionUpdate]],
        on_event: Callable[[SensorEvent], None],
    ) -> None:
        """Prepare.

        Args:
            receiver: turns datagrams into events.
            perceive: `Pipeline.perceive`.
            on_event: told every event of the LiDAR, as the log is in flight.
        """
        self.skipped = 0
        self._receiver = receiver
        self._perceive = perceive
        self._on_event = on_event
        self._lidar: deque[SensorEvent] = deque()
        self._external: deque[ExternalOdometry] = deque()
        self._places: dict[_Mark, int] = {}
        self._taken = 0
        self._made: deque[PerceptionUpdate] = deque()

    def take_datagrams(self, datagrams: Sequence[Datagram]) -> None:
        """Take one batch of raw datagrams of the LiDAR."""
        for datagram in datagrams:
            for event in self._receiver.receive(datagram):
                self._on_event(event)
                self._lidar.append(event)
        while len(self._lidar) > _MAX_WAITING and self._work(None):
            pass

    def take_external(self, event: ExternalOdometry) -> None:
        """Take one estimate of another process."""
        self._external.append(event)

    def take_place(self, mark: QueuePlace) -> None:
        """Learn where an event stood in perception's queue."""
        self._places[mark.kind, mark.t_source_ns, mark.t_ns] = mark.place
        if len(self._places) > _MAX_MARKS:
            del self._places[next(iter(self._places))]

    def until(self, wanted: UpdateKey, t_ns: int) -> Iterator[PerceptionUpdate]:
        """Yield the estimates up to the wanted one, or else all that were possible by host time `t_ns`."""
        while True:
            while self._made:
                update = self._made.popleft()
                yield update
                if key_of(update) == wanted:
                    return
            if not self._work(t_ns):
                return

    def rest(self) -> Iterator[PerceptionUpdate]:
        """Yield all estimates that nobody has asked for."""
        while True:
            while self._made:
                yield self._made.popleft()
            if not self._work(None):
                return

    def _work(self, t_ns: int | None) -> bool:
        """Work on the next event that was received by host time `t_ns`, if there is one."""
        source = self._next_source(at_the_end=t_ns is None)
        if source is None or (t_ns is not None and source[0].t_ns > t_ns):
            return False
        event = source.popleft()
        if self._places.pop(_mark_of(event), 0) < 0:
            self.skipped += 1
            return True
        self._taken += 1
        self._made.extend(self._perceive(event))
        return True

    def _next_source(self, *, at_the_end: bool) -> deque[SensorEvent] | deque[ExternalOdometry] | None:
        """Return whose turn it is: the LiDAR's events or those of another process.

        One of those waits for its place, but not for events of the LiDAR that never come.
        """
        if not self._external:
            return self._lidar or None
        external = self._external[0]
        place = self._places.get(_mark_of(external))
        if place is None:
            lidar_first = bool(self._lidar) and self._lidar[0].t_ns <= external.t_ns
        else:
            lidar_first = place > self._taken
        if lidar_first and not self._lidar and not at_the_end and len(self._external) <= _MAX_WAITING:
            return None
        return self._lidar if lidar_first and self._lidar else self._external


def _mark_of(event: SensorEvent) -> _Mark:
    if isinstance(event, ImuSample):
        return "imu", event.t_sensor_ns, event.t_ns
    if isinstance(event, LidarScan):
        return "scan", event.t_sensor_start_ns, event.t_ns
    return "external", event.t_source_ns, event.t_ns
