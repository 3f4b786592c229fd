"""What a recording does not hold, and since when a replay therefore cannot agree with it."""

from companion.logs import channels
from companion.logs.reader import EncodedEntry
from companion.replay.comparison import ChannelResult
from companion.replay.recorder import PERCEPTION

_SENSORS = (channels.LIDAR_PACKETS, channels.EXTERNAL_ODOMETRY, channels.QUEUE_PLACE)
_EVENTS = (
    channels.ODOMETRY,
    channels.NEIGHBOURS,
    channels.SCAN,
    channels.AUTHORISATION,
    channels.TICK,
    channels.CALL,
    channels.MAVLINK_RX,
    channels.MAVLINK_UNSENT,
)


class Holes:
    """Finds gaps in what a replay is fed with.

    Attributes:
        missing: by topic, how many messages were recorded by number but are not in the file.
        sensors_ns, events_ns: host time since when sensor data, or any input, is incomplete; None if it
            is not.
    """

    def __init__(self) -> None:
        """Expect every channel to begin with its first message."""
        self.missing: dict[str, int] = {}
        self.sensors_ns: int | None = None
        self.events_ns: int | None = None
        self._next: dict[str, int] = {}
        self._last_ns: dict[str, int] = {}

    def observe(self, entry: EncodedEntry) -> None:
        """Take the next message of the recording."""
        topic = entry.channel.topic
        gap = entry.sequence - self._next.get(topic, 0)
        self._next[topic] = entry.sequence + 1
        since_ns = self._last_ns.get(topic, 0)
        self._last_ns[topic] = entry.t_ns
        if gap > 0:
            self.missing[topic] = self.missing.get(topic, 0) + gap
            self._open(entry, since_ns)

    def explain(self, result: ChannelResult) -> bool:
        """Whether a channel agrees, or differs only because of what the recording does not hold."""
        if result.agrees:
            return True
        own = self.missing.get(result.topic, 0)
        if result.different == result.missing == 0 and result.extra <= own:
            return True
        perception = any(channel.topic == result.topic for channel in PERCEPTION)
        since_ns = self.sensors_ns if perception else self.events_ns
        return since_ns is not None and result.first is not None and result.first.t_ns >= since_ns

    def undecodable(self, entry: EncodedEntry) -> None:
        """Note a message that is not what its channel promises."""
        self.missing[entry.channel.topic] = self.missing.get(entry.channel.topic, 0) + 1
        self._open(entry, entry.t_ns)

    def _open(self, entry: EncodedEntry, t_ns: int) -> None:
        if entry.channel in _SENSORS:
            self.sensors_ns = t_ns if self.sensors_ns is None else min(self.sensors_ns, t_ns)
        if entry.channel in _SENSORS or entry.channel in _EVENTS:
            self.events_ns = t_ns if self.events_ns is None else min(self.events_ns, t_ns)
