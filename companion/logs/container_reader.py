"""Reads MCAP files front to back, as far as they go: complete, cut off anywhere, or damaged.

The reader needs no index, holds one chunk at a time, believes no length it cannot check against the
file, and always moves forward.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema

from companion.errors import LogError
from companion.logs.container import MAGIC

RECORD_BYTES_MAX = 64 * 1024 * 1024

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_PARSE_ERRORS = (McapError, ValueError, struct.error, zstandard.ZstdError)


@dataclass(frozen=True, slots=True)
class RawChannel:
    """A channel as announced in the file."""

    topic: str
    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message not yet decoded."""

    channel: RawChannel
    sequence: int
    t_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class RawMetadata:
    """One table of texts."""

    name: str
    values: dict[str, str]


@dataclass(frozen=True, slots=True)
class RawAttachment:
    """One attached file."""

    name: str
    media_type: str
    data: bytes


RawItem = RawMessage | RawMetadata | RawAttachment


class ContainerReader:
    """One pass over a file.

    Attributes:
        complete: the file was closed properly.
        bytes_total: size of the file.
        bytes_good: bytes up to the end of the last whole record.
        bytes_damaged: bytes of whole records before that whose content is unusable.
    """

    def __init__(self, path: Path) -> None:
        """Prepare to read `path`.

        Raises:
            LogError: if there is no such file.
        """
        try:
            self.bytes_total = path.stat().st_size
        except OSError as error:
            raise LogError(f"{path}: cannot be read: {error.strerror}") from error
        self._path = path
        self.complete = False
        self.bytes_good = 0
        self.bytes_damaged = 0
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, RawChannel] = {}

    @property
    def bytes_lost(self) -> int:
        """Bytes in the file that could not be used."""
        return self.bytes_total - self.bytes_good + self.bytes_damaged

    def items(self) -> Iterator[RawItem]:
        """Yield what the file contains, in its order; call once.

        Raises:
            LogError: if it is no MCAP file at all, or reading the disk fails.
        """
        try:
            with self._path.open("rb") as file:
                yield from self._items(file)
        except OSError as error:
            raise LogError(f"{self._path}: cannot be read: {error.strerror}") from error

    def _items(self, file: BinaryIO) -> Iterator[RawItem]:
        magic = file.read(len(MAGIC))
        if not MAGIC.startswith(magic):
            raise LogError(f"{self._path}: is not a flight log (no MCAP file)")
        if len(magic) < len(MAGIC):
            return
        self.bytes_good = len(MAGIC)
        in_summary = False
        while (record := self._next_record(file)) is not None:
            opcode, body = record
            if opcode == Opcode.FOOTER:
                tail = file.read(len(MAGIC))
                self.complete = tail == MAGIC
                self.bytes_good += len(tail) if self.complete else 0
                return
            in_summary = in_summary or opcode == Opcode.DATA_END
            if in_summary:
                continue
            try:
                yield from self._parse(opcode, body)
            except _PARSE_ERRORS:
                self.bytes_damaged += _RECORD.size + len(body)

    def _next_record(self, file: BinaryIO) -> tuple[int, bytes] | None:
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            return None
        opcode, length = _RECORD.unpack(head)
        left = self.bytes_total - self.bytes_good - _RECORD.size
        # A file system may leave zeros where a power cut hit.
        if opcode == 0 or length > min(left, RECORD_BYTES_MAX):
            return None
        body = file.read(length)
        if len(body) < length:
            return None
        self.bytes_good += _RECORD.size + length
        return opcode, body

    def _parse(self, opcode: int, body: bytes) -> Iterator[RawItem]:
        if opcode == Opcode.CHUNK:
            yield from self._messages(_unpacked(body))
        elif opcode == Opcode.MESSAGE:
            yield from self._messages(_RECORD.pack(opcode, len(body)) + body)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._announce(opcode, body)
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(_stream(body))
            yield RawMetadata(metadata.name, metadata.metadata)
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(_stream(body))
            yield RawAttachment(attachment.name, attachment.media_type, attachment.data)

    def _announce(self, opcode: int, body: bytes) -> None:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(_stream(body))
            self._schemas[schema.id] = schema
            return
        channel = Channel.read(_stream(body))
        schema = self._schemas.get(channel.schema_id)
        self._channels[channel.id] = RawChannel(
            channel.topic,
            channel.message_encoding,
            schema.name if schema else "",
            schema.encoding if schema else "",
            schema.data if schema else b"",
        )

    def _messages(self, records: bytes) -> Iterator[RawMessage]:
        position = 0
        while position < len(records):
            opcode, length = _RECORD.unpack_from(records, position)
            start = position + _RECORD.size
            position = start + length
            if position > len(records):
                raise ValueError("a record reaches beyond its chunk")
            if opcode != Opcode.MESSAGE:
                self._announce_within_chunk(opcode, records[start:position])
                continue
            channel_id, sequence, t_ns, _ = _MESSAGE.unpack_from(records, start)
            channel = self._channels.get(channel_id)
            if channel is None:
                raise ValueError(f"a message on channel {channel_id}, which was never announced")
            yield RawMessage(channel, sequence, t_ns, records[start + _MESSAGE.size : position])

    def _announce_within_chunk(self, opcode: int, body: bytes) -> None:
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._announce(opcode, body)


def _stream(body: bytes) -> Any:
    return ReadDataStream(BytesIO(body))


def _unpacked(body: bytes) -> bytes:
    """Return the records of a chunk; its checksum is verified before anything is believed."""
    size = _CHUNK_HEAD.unpack_from(body)[2]
    if size > RECORD_BYTES_MAX:
        raise ValueError(f"a chunk of {size} bytes")
    chunk = Chunk.read(_stream(body))
    plain: bytes = chunk.data
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(chunk.data) not in (-1, size):
            raise ValueError("the chunk and its content disagree about its size")
        plain = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)
    elif chunk.compression:
        raise ValueError(f"unknown compression {chunk.compression!r}")
    if len(plain) != size or (chunk.uncompressed_crc and zlib.crc32(plain) != chunk.uncompressed_crc):
        raise ValueError("the chunk's checksum is wrong")
    return plain
