"""Reads a recorded flight, finished or not, one message at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from companion.logs import metadata as flight_metadata
from companion.logs.channels import BY_TOPIC, JOURNAL, Channel
from companion.logs.codec import codec_of
from companion.logs.container_reader import (
    ContainerReader,
    RawAttachment,
    RawMessage,
    RawMetadata,
)
from companion.logs.log_queue import LogEntry


@dataclass(slots=True, eq=False)
class EncodedEntry:
    """One message as it stands in the log.

    Attributes:
        t_ns: time at which it was handled, as told to the log.
        sequence: counts the messages of its channel from 0, including those that were dropped.
    """

    channel: Channel
    t_ns: int
    sequence: int
    data: bytes
    _decoded: object = field(default=None, init=False, repr=False)

    def message(self) -> object:
        """Return the message; it is decoded once.

        Raises:
            ValueError: if the bytes are not what the channel promises.
        """
        if self._decoded is None:
            self._decoded = codec_of(self.channel).decode(self.data)
        return self._decoded


@dataclass(frozen=True, slots=True)
class Integrity:
    """How much of a recording could be read.

    Attributes:
        complete: the log was closed properly and everything in it could be read.
        messages: by topic, how many messages the file holds.
        missing: by topic, how many messages were never written although the flight produced them.
        undecodable: messages that are not what their channel promises.
        unknown: messages on channels that are not known here.
        bytes_total, bytes_lost: size of the file and what of it could not be used.
        start_ns, end_ns: times of the first and the last message, 0 if there is none.
    """

    complete: bool
    messages: dict[str, int]
    missing: dict[str, int]
    undecodable: int
    unknown: int
    bytes_total: int
    bytes_lost: int
    start_ns: int
    end_ns: int


class FlightRecording:
    """One recorded flight.

    Attributes:
        flight: vehicle, role, mode, seed, git_commit, as texts; what is unknown is left out.
        versions: names and versions of the software that flew.
        configuration: the configuration as it was, YAML or JSON text.
    """

    def __init__(self, path: Path) -> None:
        """Open a recording and read what it says about the whole flight.

        Raises:
            LogError: if there is no such file or it is no flight log.
        """
        self._path = path
        self.flight: dict[str, str] = {}
        self.versions: dict[str, str] = {}
        self.configuration = ""
        self._integrity: Integrity | None = None
        self._reader: ContainerReader | None = None
        for item in ContainerReader(path).items():
            if isinstance(item, RawMessage):
                break
            if isinstance(item, RawMetadata):
                self._take_table(item)
            elif item.name == flight_metadata.CONFIGURATION:
                self._take_configuration(item)

    def messages(self, *wanted: Channel) -> Iterator[LogEntry]:
        """Yield messages in the order of the log, of the `wanted` channels or of all.

        Messages that cannot be decoded are counted and left out: see `integrity`.

        Raises:
            LogError: if reading the disk fails.
        """
        tally = _Tally()
        for entry in self._encoded(tally, wanted):
            try:
                message = entry.message()
            except ValueError:
                tally.undecodable += 1
                continue
            yield LogEntry(entry.channel, entry.t_ns, entry.sequence, message)

    def encoded(self, *wanted: Channel) -> Iterator[EncodedEntry]:
        """Yield messages as they stand in the file, in its order, of the `wanted` channels or of all.

        Raises:
            LogError: if reading the disk fails.
        """
        return self._encoded(_Tally(), wanted)

    @property
    def progress(self) -> float:
        """How much of the file the pass begun last has read, 0 to 1."""
        if self._reader is None or not self._reader.bytes_total:
            return 0.0
        return self._reader.bytes_good / self._reader.bytes_total

    def _encoded(self, tally: "_Tally", wanted: Sequence[Channel]) -> Iterator[EncodedEntry]:
        topics = {channel.topic for channel in wanted or BY_TOPIC.values()}
        reader = self._reader = ContainerReader(self._path)
        known: dict[str, Channel | None] = {}
        for item in reader.items():
            if not isinstance(item, RawMessage):
                continue
            topic = item.channel.topic
            if topic not in known:
                known[topic] = _known_channel(item)
            channel = known[topic]
            tally.count(item, known=channel is not None)
            if channel is not None and topic in topics:
                yield EncodedEntry(channel, item.t_ns, item.sequence, item.data)
        self._integrity = tally.integrity(reader)

    def control_events(self) -> Iterator[LogEntry]:
        """Yield the control events in the order in which they were handled."""
        return self.messages(*JOURNAL)

    def integrity(self) -> Integrity:
        """Return how much of the log could be read, as found by the last complete pass."""
        if self._integrity is None:
            for _ in self.messages():
                pass
        assert self._integrity is not None
        return self._integrity

    def _take_table(self, item: RawMetadata) -> None:
        if item.name == flight_metadata.FLIGHT:
            self.flight = item.values
        elif item.name == flight_metadata.VERSIONS:
            self.versions = item.values

    def _take_configuration(self, item: RawAttachment) -> None:
        self.configuration = item.data.decode(errors="replace")


def _known_channel(item: RawMessage) -> Channel | None:
    channel = BY_TOPIC.get(item.channel.topic)
    if channel is None or channel.schema != item.channel.schema_name:
        return None
    return channel


class _Tally:
    """Counts what one pass over the file finds."""

    def __init__(self) -> None:
        self.undecodable = 0
        self._unknown = 0
        self._messages: dict[str, int] = {}
        self._highest: dict[str, int] = {}
        self._start_ns: int | None = None
        self._end_ns = 0

    def count(self, item: RawMessage, *, known: bool) -> None:
        topic = item.channel.topic
        self._messages[topic] = self._messages.get(topic, 0) + 1
        self._highest[topic] = max(self._highest.get(topic, -1), item.sequence)
        self._unknown += not known
        self._start_ns = item.t_ns if self._start_ns is None else min(self._start_ns, item.t_ns)
        self._end_ns = max(self._end_ns, item.t_ns)

    def integrity(self, reader: ContainerReader) -> Integrity:
        missing = {
            topic: self._highest[topic] + 1 - count
            for topic, count in self._messages.items()
            if self._highest[topic] + 1 > count
        }
        return Integrity(
            complete=reader.complete and reader.bytes_lost == 0,
            messages=dict(sorted(self._messages.items())),
            missing=dict(sorted(missing.items())),
            undecodable=self.undecodable,
            unknown=self._unknown,
            bytes_total=reader.bytes_total,
            bytes_lost=reader.bytes_lost,
            start_ns=self._start_ns or 0,
            end_ns=self._end_ns,
        )
