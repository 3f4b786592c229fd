"""One log file on its way to the disk; after a disk error it stops cleanly and counts what it refuses."""

import errno
import os
from enum import Enum
from io import FileIO
from pathlib import Path

import structlog

from companion.clock import NANOSECONDS_PER_SECOND
from companion.logs import metadata as flight_metadata
from companion.logs.codec import Codec, codec_of
from companion.logs.container import ContainerWriter
from companion.logs.log_queue import LogEntry
from companion.logs.metadata import FlightMetadata

UNFINISHED_SUFFIX = ".open"
FLUSH_PERIOD_NS = NANOSECONDS_PER_SECOND

_log = structlog.get_logger(__name__)


class LogState(Enum):
    """Whether messages reach the disk."""

    RECORDING = "recording"
    FAILED = "failed"
    CLOSED = "closed"


def unfinished_path(path: Path) -> Path:
    """Return the name a log has until it is closed."""
    return path.with_name(path.name + UNFINISHED_SUFFIX)


class LogFile:
    """Writes entries to ``<path>.open`` and renames it to ``<path>`` when closed.

    No method raises OSError: the first one ends the recording, and the file is cut back to its last
    whole record.

    Attributes:
        state: whether entries reach the disk.
        reason: why not, empty while recording.
        written: messages accepted; those of the chunk that met a disk error are lost.
        refused: messages refused after a failure or after closing.
    """

    def __init__(
        self,
        path: Path,
        metadata: FlightMetadata,
        *,
        chunk_bytes: int,
        compression_level: int,
        durable: bool,
    ) -> None:
        """Create the file; an existing log of that name is never touched.

        Args:
            path: name of the closed log.
            metadata: what is true of the whole flight.
            chunk_bytes: size of a chunk before compression.
            compression_level: Zstandard's level.
            durable: wait for the disk at every `sync`.
        """
        self.state = LogState.RECORDING
        self.reason = ""
        self.written = 0
        self.refused = 0
        self._path = path
        self._durable = durable
        self._file: FileIO | None = None
        self._channel_ids: dict[str, int] = {}
        self._codecs: dict[str, Codec] = {}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.exists():
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
            self._file = FileIO(unfinished_path(path), "x")
            self._container = ContainerWriter(
                self._file, chunk_bytes=chunk_bytes, compression_level=compression_level
            )
            self._container.add_metadata(flight_metadata.FLIGHT, metadata.table())
            self._container.add_metadata(flight_metadata.VERSIONS, dict(sorted(metadata.versions.items())))
            self._container.add_attachment(
                flight_metadata.CONFIGURATION, "application/yaml", metadata.configuration.encode()
            )
        except OSError as error:
            self._fail(error)

    @property
    def size(self) -> int:
        """Bytes on the disk."""
        return 0 if self._file is None else self._container.size

    @property
    def free_bytes(self) -> int | None:
        """Bytes left on the disk for this process, None if unknown."""
        try:
            disk = os.statvfs(self._path.parent)
        except OSError:
            return None
        return disk.f_bavail * disk.f_frsize

    def append(self, entry: LogEntry) -> None:
        """Add one message.

        Raises:
            TypeError, ValueError, AttributeError: if it is no message of its channel.
        """
        if self.state is not LogState.RECORDING:
            self.refused += 1
            return
        codec = self._codecs.get(entry.channel.topic)
        if codec is None:
            codec = self._codecs[entry.channel.topic] = codec_of(entry.channel)
        data = codec.encode(entry.message)
        try:
            channel_id = self._channel_ids.get(entry.channel.topic)
            if channel_id is None:
                channel_id = self._channel_ids[entry.channel.topic] = self._container.add_channel(
                    entry.channel.topic,
                    codec.message_encoding,
                    schema_name=entry.channel.schema,
                    schema_encoding=codec.schema_encoding,
                    schema=codec.schema,
                )
            self._container.add_message(channel_id, entry.sequence, entry.t_ns, data)
            self.written += 1
        except OSError as error:
            self.refused += 1
            self._fail(error)

    def sync(self) -> None:
        """Bring everything accepted so far to the disk."""
        if self.state is not LogState.RECORDING or self._file is None:
            return
        try:
            self._container.flush()
            if self._durable:
                os.fdatasync(self._file.fileno())
        except OSError as error:
            self._fail(error)

    def close(self) -> None:
        """Complete the file and give it its final name; a failed log keeps its unfinished name."""
        if self.state is not LogState.RECORDING or self._file is None:
            return
        try:
            self._container.finish()
            if self._durable:
                os.fsync(self._file.fileno())
            self._file.close()
            os.rename(unfinished_path(self._path), self._path)
            if self._durable:
                _sync_directory(self._path.parent)
            self.state = LogState.CLOSED
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.state = LogState.FAILED
        self.reason = f"{self._path.name}: {error.strerror or error}"
        _log.error("recording stopped", reason=self.reason)
        if self._file is None or self._file.closed:
            return
        try:
            self._file.truncate(self._container.whole_size)
        except (OSError, AttributeError) as second:
            _log.warning("an unfinished record stays at the end of the log", reason=str(second))
        try:
            self._file.close()
        except OSError as second:
            _log.warning("the log could not be closed", reason=str(second))


def _sync_directory(directory: Path) -> None:
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
