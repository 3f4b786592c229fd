"""MCAP files as a stream of synced chunks: what is on disk stays readable wherever the file ends.

Schemas and channels are written outside the chunks, before the first message that needs them, so a
damaged chunk costs its own messages only. Format: MCAP specification 1, https://mcap.dev/spec.
"""

import errno
import struct
import zlib
from typing import Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "companion"

_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS_SIZE = _MESSAGE.size - 9
_INDEX_ENTRY = struct.Struct("<QQ")
_INDEX_HEAD = struct.Struct("<BQHI")
_FOOTER_HEAD = struct.Struct("<BQQQ")


class ByteSink(Protocol):
    """An unbuffered binary file."""

    def write(self, data: memoryview, /) -> int | None:
        """Write some or all of `data`; return how many bytes were taken."""
        ...


class ContainerWriter:
    """Writes one MCAP file; every method may raise OSError and is then not to be called again.

    Attributes:
        size: bytes written so far.
        whole_size: size of the file after the last record that was written completely.
    """

    def __init__(self, sink: ByteSink, *, chunk_bytes: int, compression_level: int) -> None:
        """Write the file's beginning to `sink`."""
        self.size = 0
        self.whole_size = 0
        self._sink = sink
        self._chunk_bytes = chunk_bytes
        self._compressor = zstandard.ZstdCompressor(level=compression_level)
        self._schema_ids: dict[tuple[str, str, bytes], int] = {}
        self._chunk = bytearray()
        self._chunk_first_ns = self._chunk_last_ns = 0
        self._chunk_index: dict[int, bytearray] = {}
        self._message_counts: dict[int, int] = {}
        self._messages = self._first_ns = self._last_ns = 0
        # Indices are kept packed: a long flight has tens of thousands of chunks.
        self._summary: dict[int, RecordBuilder] = {
            opcode: RecordBuilder()
            for opcode in (
                Opcode.SCHEMA,
                Opcode.CHANNEL,
                Opcode.CHUNK_INDEX,
                Opcode.ATTACHMENT_INDEX,
                Opcode.METADATA_INDEX,
            )
        }
        self._chunks = self._attachments = self._metadata = 0
        self._put(MAGIC + _packed(Header("", LIBRARY)))

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add one table of texts."""
        record = _packed(Metadata(name=name, metadata=values))
        MetadataIndex(offset=self.size, length=len(record), name=name).write(
            self._summary[Opcode.METADATA_INDEX]
        )
        self._metadata += 1
        self._put(record)

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Add a file; it carries no time, so that equal flights give equal bytes."""
        attachment = Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)
        record = _packed(attachment)
        AttachmentIndex(
            offset=self.size,
            length=len(record),
            create_time=0,
            log_time=0,
            data_size=len(data),
            name=name,
            media_type=media_type,
        ).write(self._summary[Opcode.ATTACHMENT_INDEX])
        self._attachments += 1
        self._put(record)

    def add_channel(
        self,
        topic: str,
        message_encoding: str,
        *,
        schema_name: str,
        schema_encoding: str,
        schema: bytes,
    ) -> int:
        """Announce a channel and return its number."""
        records = b""
        key = (schema_name, schema_encoding, schema)
        schema_id = self._schema_ids.get(key)
        if schema_id is None:
            schema_id = self._schema_ids[key] = len(self._schema_ids) + 1
            record = Schema(id=schema_id, data=schema, encoding=schema_encoding, name=schema_name)
            record.write(self._summary[Opcode.SCHEMA])
            records = _packed(record)
        channel_id = len(self._message_counts) + 1
        channel = Channel(
            id=channel_id, topic=topic, message_encoding=message_encoding, metadata={}, schema_id=schema_id
        )
        channel.write(self._summary[Opcode.CHANNEL])
        self._message_counts[channel_id] = 0
        self._put(records + _packed(channel))
        return channel_id

    def add_message(self, channel_id: int, sequence: int, t_ns: int, data: bytes) -> None:
        """Add a message to the present chunk and write the chunk when it is full."""
        chunk = self._chunk
        if not chunk:
            self._chunk_first_ns = self._chunk_last_ns = t_ns
        if self._messages == 0:
            self._first_ns = self._last_ns = t_ns
        self._messages += 1
        self._chunk_first_ns = min(self._chunk_first_ns, t_ns)
        self._chunk_last_ns = max(self._chunk_last_ns, t_ns)
        self._message_counts[channel_id] += 1
        self._chunk_index.setdefault(channel_id, bytearray()).extend(_INDEX_ENTRY.pack(t_ns, len(chunk)))
        chunk += _MESSAGE.pack(
            Opcode.MESSAGE,
            _MESSAGE_FIELDS_SIZE + len(data),
            channel_id,
            sequence & 0xFFFFFFFF,
            t_ns,
            t_ns,
        )
        chunk += data
        if len(chunk) >= self._chunk_bytes:
            self.flush()

    def flush(self) -> None:
        """Write the present chunk, if it holds anything."""
        if not self._chunk:
            return
        plain = bytes(self._chunk)
        compressed = self._compressor.compress(plain)
        chunk = _packed(
            Chunk(
                compression="zstd",
                data=compressed,
                message_start_time=self._chunk_first_ns,
                message_end_time=self._chunk_last_ns,
                uncompressed_crc=zlib.crc32(plain),
                uncompressed_size=len(plain),
            )
        )
        offsets: dict[int, int] = {}
        indices = bytearray()
        for channel_id, entries in self._chunk_index.items():
            offsets[channel_id] = self.size + len(chunk) + len(indices)
            indices += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel_id, len(entries))
            indices += entries
        ChunkIndex(
            message_start_time=self._chunk_first_ns,
            message_end_time=self._chunk_last_ns,
            chunk_start_offset=self.size,
            chunk_length=len(chunk),
            message_index_offsets=offsets,
            message_index_length=len(indices),
            compression="zstd",
            compressed_size=len(compressed),
            uncompressed_size=len(plain),
        ).write(self._summary[Opcode.CHUNK_INDEX])
        self._first_ns = min(self._first_ns, self._chunk_first_ns)
        self._last_ns = max(self._last_ns, self._chunk_last_ns)
        self._chunks += 1
        self._chunk.clear()
        self._chunk_index.clear()
        self._put(chunk + indices)

    def finish(self) -> None:
        """Write the last chunk and the summary; the file is then complete."""
        self.flush()
        self._put(_packed(DataEnd(0)))
        start = self.size
        groups = [(opcode, builder.end()) for opcode, builder in self._summary.items()]
        groups.insert(2, (Opcode.STATISTICS, _packed(self._statistics())))
        summary = bytearray()
        offsets = RecordBuilder()
        for opcode, group in groups:
            if group:
                SummaryOffset(
                    group_opcode=opcode, group_start=start + len(summary), group_length=len(group)
                ).write(offsets)
            summary += group
        offset_start = start + len(summary)
        summary += offsets.end()
        checked = bytes(summary) + _FOOTER_HEAD.pack(Opcode.FOOTER, 20, start, offset_start)
        footer = Footer(
            summary_start=start, summary_offset_start=offset_start, summary_crc=zlib.crc32(checked)
        )
        self._put(bytes(summary) + _packed(footer) + MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=self._attachments,
            channel_count=len(self._message_counts),
            channel_message_counts=self._message_counts,
            chunk_count=self._chunks,
            message_count=self._messages,
            message_end_time=self._last_ns,
            message_start_time=self._first_ns,
            metadata_count=self._metadata,
            schema_count=len(self._schema_ids),
        )

    def _put(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            # A nearly full disk takes a part and refuses the rest only on the next call.
            taken = self._sink.write(rest)
            if not taken:
                raise OSError(errno.EIO, "the disk takes no more bytes")
            self.size += taken
            rest = rest[taken:]
        self.whole_size = self.size


def _packed(record: object) -> bytes:
    builder = RecordBuilder()
    record.write(builder)  # type: ignore[attr-defined]
    packed: bytes = builder.end()
    return packed
