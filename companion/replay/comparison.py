"""Recorded against replayed messages of one channel: byte for byte, told apart by what names a message."""

from collections import Counter, deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Protocol

from companion.logs.channels import Channel
from companion.logs.codec import codec_of
from companion.logs.reader import EncodedEntry
from companion.messages import MavlinkMessage
from companion.replay.difference import Difference, first_difference, only_one

# How far one side may run ahead of the other before a message counts as missing or extra.
_MAX_AHEAD = 20_000

OnDifferent = Callable[[object, object], None]


@dataclass(frozen=True, slots=True)
class Ends:
    """Where the recording of a channel ends: what stands alone from there on was cut off.

    Attributes:
        recorded_ns, replayed_ns: host times, for messages that only one of the two flights has; None if
            the recording of the channel is complete.
    """

    recorded_ns: int | None = None
    replayed_ns: int | None = None


@dataclass(frozen=True, slots=True)
class ChannelResult:
    """How one channel came out.

    Attributes:
        topic: the channel.
        equal, different: messages in both flights, by their bytes.
        missing: recorded but not replayed.
        extra: replayed but not recorded.
        cut_off: of either kind, where the recording ends.
        first: the first difference, None if there is none.
    """

    topic: str
    equal: int
    different: int
    missing: int
    extra: int
    cut_off: int
    first: Difference | None

    @property
    def agrees(self) -> bool:
        """Nothing came out differently."""
        return not (self.different or self.missing or self.extra)


class Comparison(Protocol):
    """Compares the messages of one channel."""

    def take_recorded(self, entry: EncodedEntry) -> None:
        """Take the next message of the recorded flight."""
        ...

    def take_replayed(self, message: object, t_ns: int) -> None:
        """Take the next message of the replayed flight, handled at host time `t_ns`."""
        ...

    def finish(self, ends: Ends) -> ChannelResult:
        """Return the result; call once."""
        ...


class _Account:
    """Counts, and the first difference by time."""

    def __init__(self, channel: Channel, on_different: OnDifferent | None) -> None:
        self._channel = channel
        self._on_different = on_different
        self.equal = self.different = self.missing = self.extra = self.cut_off = 0
        self.first: Difference | None = None

    def pair(self, entry: EncodedEntry, message: object, note: str = "") -> None:
        if codec_of(self._channel).encode(message) == entry.data and not note:
            self.equal += 1
            return
        self.different += 1
        recorded = _decoded(entry)
        if note:
            self._note(Difference(entry.t_ns, note, "", ""))
        elif self.first is None or entry.t_ns < self.first.t_ns:
            self._note(first_difference(entry.t_ns, recorded, message))
        if self._on_different is not None:
            self._on_different(recorded, message)

    def alone(
        self, t_ns: int, end_ns: int | None, *, entry: EncodedEntry | None = None, message: object = None
    ) -> None:
        if end_ns is not None and t_ns >= end_ns:
            self.cut_off += 1
            return
        if entry is not None:
            self.missing += 1
            self._note(only_one(t_ns, recorded=_decoded(entry)))
        else:
            self.extra += 1
            self._note(only_one(t_ns, replayed=message))

    def result(self) -> ChannelResult:
        return ChannelResult(
            self._channel.topic,
            self.equal,
            self.different,
            self.missing,
            self.extra,
            self.cut_off,
            self.first,
        )

    def _note(self, difference: Difference) -> None:
        if self.first is None or difference.t_ns < self.first.t_ns:
            self.first = difference


class NamedComparison:
    """Pairs messages by a name, such as their time; names that repeat are counted in their order."""

    def __init__(
        self,
        channel: Channel,
        name_of: Callable[[object], Hashable] | None = None,
        on_different: OnDifferent | None = None,
    ) -> None:
        """Prepare.

        Args:
            channel: whose messages are compared.
            name_of: names a message; the time at which it was handled by default.
            on_different: told of every pair that differs.
        """
        self._name_of = name_of
        self._account = _Account(channel, on_different)
        self._recorded: dict[Hashable, EncodedEntry] = {}
        self._replayed: dict[Hashable, tuple[int, object]] = {}
        self._names = (_Names(), _Names())

    def take_recorded(self, entry: EncodedEntry) -> None:
        """Take the next message of the recorded flight."""
        name: Hashable = entry.t_ns
        if self._name_of is not None:
            message = _decoded(entry)
            name = entry.t_ns if message is None else self._name_of(message)
        name = self._names[0].distinct(name)
        replayed = self._replayed.pop(name, None)
        if replayed is not None:
            self._account.pair(entry, replayed[1])
            return
        self._recorded[name] = entry
        if len(self._recorded) > _MAX_AHEAD:
            oldest = self._recorded.pop(next(iter(self._recorded)))
            self._account.alone(oldest.t_ns, None, entry=oldest)

    def take_replayed(self, message: object, t_ns: int) -> None:
        """Take the next message of the replayed flight, handled at host time `t_ns`."""
        name = self._names[1].distinct(t_ns if self._name_of is None else self._name_of(message))
        entry = self._recorded.pop(name, None)
        if entry is not None:
            self._account.pair(entry, message)
            return
        self._replayed[name] = t_ns, message
        if len(self._replayed) > _MAX_AHEAD:
            oldest_ns, oldest = self._replayed.pop(next(iter(self._replayed)))
            self._account.alone(oldest_ns, None, message=oldest)

    def finish(self, ends: Ends) -> ChannelResult:
        """Return the result; call once."""
        for entry in self._recorded.values():
            self._account.alone(entry.t_ns, ends.recorded_ns, entry=entry)
        for t_ns, message in self._replayed.values():
            self._account.alone(t_ns, ends.replayed_ns, message=message)
        return self._account.result()


class SentComparison:
    """Pairs messages to the autopilot: each kind in its order, and all in one order.

    They leave later than they are decided, and those that never left are told by their number.
    """

    def __init__(self, channel: Channel) -> None:
        """Prepare for a channel of MAVLink messages."""
        self._account = _Account(channel, None)
        self._decided: dict[str, deque[tuple[int, int, MavlinkMessage]]] = {}
        self._count = 0
        self._last = -1
        self._unsent: set[int] = set()

    def take_unsent(self, first: int, count: int) -> None:
        """Learn that `count` messages, after the `first` ones decided, never left."""
        if count <= _MAX_AHEAD and len(self._unsent) <= _MAX_AHEAD:
            self._unsent.update(range(first, first + count))

    def take_recorded(self, entry: EncodedEntry) -> None:
        """Take the next message that left in the recorded flight."""
        message = _decoded(entry)
        kind = message.name if isinstance(message, MavlinkMessage) else ""
        waiting = self._waiting(kind)
        if not waiting:
            self._account.alone(entry.t_ns, None, entry=entry)
            return
        number, _, replayed = waiting.popleft()
        self._account.pair(entry, replayed, "left in another order" if number < self._last else "")
        self._last = max(self._last, number)

    def take_replayed(self, message: object, t_ns: int) -> None:
        """Take the next message that was decided on in the replayed flight."""
        assert isinstance(message, MavlinkMessage)
        waiting = self._decided.setdefault(message.name, deque())
        waiting.append((self._count, t_ns, message))
        self._count += 1
        if len(waiting) > _MAX_AHEAD:
            _, oldest_ns, oldest = waiting.popleft()
            self._account.alone(oldest_ns, None, message=oldest)

    def finish(self, ends: Ends) -> ChannelResult:
        """Return the result; what was decided after the last message that left never left."""
        for kind in self._decided:
            for number, t_ns, message in self._waiting(kind):
                end_ns = t_ns if number > self._last else ends.replayed_ns
                self._account.alone(t_ns, end_ns, message=message)
        return self._account.result()

    def _waiting(self, kind: str) -> deque[tuple[int, int, MavlinkMessage]]:
        """Return what of a kind has been decided and is still to leave."""
        waiting = self._decided.get(kind, deque())
        while waiting and waiting[0][0] in self._unsent:
            self._unsent.discard(waiting.popleft()[0])
        return waiting


class _Names:
    """Tells repeated names apart by counting them; those in a row, and a few more, are remembered."""

    def __init__(self) -> None:
        self._counts: Counter[Hashable] = Counter()

    def distinct(self, name: Hashable) -> Hashable:
        count = self._counts[name]
        self._counts[name] = count + 1
        if len(self._counts) > _MAX_AHEAD:
            del self._counts[next(iter(self._counts))]
        return name, count


def _decoded(entry: EncodedEntry) -> object:
    try:
        return entry.message()
    except ValueError:
        return None
