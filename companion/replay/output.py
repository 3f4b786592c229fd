"""The log of a replayed flight: what was recorded, with what came out anew in its place."""

import errno
from collections import Counter
from collections.abc import Container, Mapping
from io import FileIO
from pathlib import Path
from types import TracebackType

from companion.errors import LogError
from companion.logs import metadata as flight_metadata
from companion.logs.channels import Channel
from companion.logs.codec import codec_of
from companion.logs.container import ContainerWriter
from companion.logs.reader import EncodedEntry

REPLAY_OF = "replay_of"
_CHUNK_BYTES = 64 * 1024
_COMPRESSION_LEVEL = 1


class ReplayLog:
    """Writes a new log while an old one is replayed; leaving its context completes the file."""

    def __init__(
        self,
        path: Path,
        *,
        replay_of: Path,
        flight: Mapping[str, str],
        configuration: str,
        made: Container[str],
    ) -> None:
        """Create the file.

        Args:
            path: of the new log.
            replay_of: the log that is replayed.
            flight: what that one says about the flight.
            configuration: of the replay, YAML.
            made: topics that the replay writes anew; they are not copied.

        Raises:
            LogError: if the file exists or cannot be created.
        """
        self._path = path
        self._made = made
        self._sequences: Counter[str] = Counter()
        self._ids: dict[str, int] = {}
        try:
            self._file = FileIO(path, "x")
            self._container = ContainerWriter(
                self._file, chunk_bytes=_CHUNK_BYTES, compression_level=_COMPRESSION_LEVEL
            )
            self._container.add_metadata(
                flight_metadata.FLIGHT, dict(sorted({**flight, REPLAY_OF: replay_of.name}.items()))
            )
            self._container.add_metadata(
                flight_metadata.VERSIONS, dict(sorted(flight_metadata.software_versions().items()))
            )
            self._container.add_attachment(
                flight_metadata.CONFIGURATION, "application/yaml", configuration.encode()
            )
        except OSError as error:
            raise self._failure(error) from error

    def __enter__(self) -> "ReplayLog":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        # An interrupted replay leaves what it has so far as a complete log.
        try:
            self._container.finish()
            self._file.close()
        except OSError as failure:
            if error is None:
                raise self._failure(failure) from failure

    def copy(self, entry: EncodedEntry) -> None:
        """Take over a message of the old log, unless the replay makes it anew.

        Raises:
            LogError: if the disk refuses it.
        """
        if entry.channel.topic not in self._made:
            self._add(entry.channel, entry.sequence, entry.t_ns, entry.data)

    def write(self, channel: Channel, message: object, t_ns: int) -> None:
        """Add a message of the replay.

        Raises:
            LogError: if the disk refuses it.
        """
        sequence = self._sequences[channel.topic]
        self._sequences[channel.topic] = sequence + 1
        self._add(channel, sequence, t_ns, codec_of(channel).encode(message))

    def _add(self, channel: Channel, sequence: int, t_ns: int, data: bytes) -> None:
        try:
            channel_id = self._ids.get(channel.topic)
            if channel_id is None:
                codec = codec_of(channel)
                channel_id = self._ids[channel.topic] = self._container.add_channel(
                    channel.topic,
                    codec.message_encoding,
                    schema_name=channel.schema,
                    schema_encoding=codec.schema_encoding,
                    schema=codec.schema,
                )
            self._container.add_message(channel_id, sequence, t_ns, data)
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> LogError:
        if error.errno == errno.EEXIST:
            return LogError(f"{self._path}: exists already and is not overwritten")
        return LogError(f"{self._path}: cannot be written: {error.strerror}")
