"""Makes a complete log of one that was never closed, or of one that others have something to add to."""

import math
import os
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from companion.clock import ns_to_seconds
from companion.errors import LogError
from companion.logs.codec import codec_of
from companion.logs.container import ContainerWriter
from companion.logs.container_reader import ContainerReader, RawAttachment, RawChannel, RawMetadata
from companion.logs.log_file import UNFINISHED_SUFFIX
from companion.logs.log_queue import LogEntry

_CHUNK_BYTES = 64 * 1024
_COMPRESSION_LEVEL = 1
_PARTIAL_SUFFIX = ".recovering"


@dataclass(frozen=True, slots=True)
class Recovery:
    """What was saved of an unfinished log.

    Attributes:
        path: the complete log that was written.
        was_complete: nothing had been missing.
        messages: how many messages were saved.
        duration_s: time between the first and the last of them.
        bytes_lost: bytes of the old file that could not be used.
        seconds_lost: how much flight these bytes held, judged by the mean data rate. What had not
            reached the disk (at most the last second before a crash) is not in the file and not
            counted.
    """

    path: Path
    was_complete: bool
    messages: int
    duration_s: float
    bytes_lost: int
    seconds_lost: float


def recovered_path(path: Path) -> Path:
    """Return the name of the log that `recover` writes by default."""
    if path.name.endswith(UNFINISHED_SUFFIX):
        return path.with_name(path.name.removesuffix(UNFINISHED_SUFFIX))
    return path.with_name(f"{path.stem}.recovered{path.suffix}")


def recover(path: Path, output: Path | None = None) -> Recovery:
    """Copy everything readable of a log into a new, complete one; the old file stays.

    Args:
        path: a log, unfinished, cut off or damaged.
        output: the new log; by default beside the old one.

    Raises:
        LogError: if `path` is no log, or `output` exists or cannot be written.
    """
    output = output or recovered_path(path)
    if output.exists():
        raise LogError(f"{output}: exists already and is not overwritten")
    partial = output.with_name(output.name + _PARTIAL_SUFFIX)
    reader = ContainerReader(path)
    try:
        with FileIO(partial, "w") as file:
            messages, duration_s = _copy(reader, file)
            os.fsync(file.fileno())
        os.rename(partial, output)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise LogError(f"{output}: cannot be written: {error.strerror}") from error
    except LogError:
        partial.unlink(missing_ok=True)
        raise
    bytes_used = reader.bytes_total - reader.bytes_lost
    return Recovery(
        path=output,
        was_complete=reader.complete and reader.bytes_lost == 0,
        messages=messages,
        duration_s=duration_s,
        bytes_lost=reader.bytes_lost,
        seconds_lost=duration_s * reader.bytes_lost / bytes_used if bytes_used else 0.0,
    )


def add_messages(path: Path, additions: Sequence[LogEntry], output: Path) -> None:
    """Copy a log and insert messages by their time; the old file stays.

    Args:
        path: a log.
        additions: messages in the order of their times.
        output: the new log.

    Raises:
        LogError: if `path` is no log, or `output` exists or cannot be written.
    """
    try:
        with FileIO(output, "x") as file:
            _copy(ContainerReader(path), file, additions)
    except OSError as error:
        raise LogError(f"{output}: cannot be written: {error.strerror}") from error


def _copy(reader: ContainerReader, file: FileIO, additions: Sequence[LogEntry] = ()) -> tuple[int, float]:
    """Return the number of messages copied and the seconds they span."""
    container = ContainerWriter(file, chunk_bytes=_CHUNK_BYTES, compression_level=_COMPRESSION_LEVEL)
    added_ids: dict[str, int] = {}
    waiting = deque(additions)

    def add_until(t_ns: float) -> None:
        while waiting and waiting[0].t_ns <= t_ns:
            entry = waiting.popleft()
            topic, codec = entry.channel.topic, codec_of(entry.channel)
            if topic not in added_ids:
                added_ids[topic] = container.add_channel(
                    topic,
                    codec.message_encoding,
                    schema_name=entry.channel.schema,
                    schema_encoding=codec.schema_encoding,
                    schema=codec.schema,
                )
            container.add_message(added_ids[topic], entry.sequence, entry.t_ns, codec.encode(entry.message))

    ids: dict[RawChannel, int] = {}
    messages = 0
    first_ns = last_ns = 0
    for item in reader.items():
        if isinstance(item, RawMetadata):
            container.add_metadata(item.name, item.values)
        elif isinstance(item, RawAttachment):
            container.add_attachment(item.name, item.media_type, item.data)
        else:
            if item.channel not in ids:
                ids[item.channel] = container.add_channel(
                    item.channel.topic,
                    item.channel.message_encoding,
                    schema_name=item.channel.schema_name,
                    schema_encoding=item.channel.schema_encoding,
                    schema=item.channel.schema,
                )
            add_until(item.t_ns)
            container.add_message(ids[item.channel], item.sequence, item.t_ns, item.data)
            first_ns = item.t_ns if messages == 0 else min(first_ns, item.t_ns)
            last_ns = max(last_ns, item.t_ns)
            messages += 1
    add_until(math.inf)
    container.finish()
    return messages, ns_to_seconds(last_ns - first_ns)
