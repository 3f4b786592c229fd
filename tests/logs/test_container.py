import io
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from companion.errors import LogError
from companion.logs.container import MAGIC, ContainerWriter
from companion.logs.container_reader import (
    ContainerReader,
    RawAttachment,
    RawItem,
    RawMessage,
    RawMetadata,
)


class Memory:
    """A disk that takes `room` bytes, at most `gulp` at a time."""

    def __init__(self, room: int = 10**9, gulp: int = 10**9) -> None:
        self.data = bytearray()
        self._room = room
        self._gulp = gulp

    def write(self, data: memoryview, /) -> int:
        taken = min(len(data), self._gulp, self._room - len(self.data))
        if taken == 0:
            raise OSError(28, "No space left on device")
        self.data += data[:taken]
        return taken


def fill(sink: Memory, *, finish: bool = True, messages: int = 200) -> None:
    writer = ContainerWriter(sink, chunk_bytes=4096, compression_level=1)
    writer.add_metadata("flight", {"vehicle": "uav_1"})
    writer.add_attachment("configuration.yaml", "application/yaml", b"a: 1\n")
    first = writer.add_channel("/a", "json", schema_name="A", schema_encoding="jsonschema", schema=b"{}")
    second = writer.add_channel("/b", "json", schema_name="A", schema_encoding="jsonschema", schema=b"{}")
    for index in range(messages):
        writer.add_message(
            first if index % 3 else second, index, 1000 + index, f"message {index} ".encode() * 20
        )
    if finish:
        writer.finish()
    else:
        writer.flush()


def read(data: bytes, tmp_path: Path) -> tuple[list[RawItem], ContainerReader]:
    path = tmp_path / "file.mcap"
    path.write_bytes(data)
    reader = ContainerReader(path)
    return list(reader.items()), reader


def test_the_reference_reader_accepts_the_file_and_its_checksums() -> None:
    sink = Memory()
    fill(sink)
    reader = make_reader(io.BytesIO(sink.data), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 200
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 5
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (1000, 1199)
    assert [message.sequence for _, _, message in reader.iter_messages()] == list(range(200))
    only_b = list(reader.iter_messages(topics=["/b"]))
    assert [message.sequence for _, _, message in only_b] == list(range(0, 200, 3))
    assert [metadata.metadata for metadata in reader.iter_metadata()] == [{"vehicle": "uav_1"}]
    assert [attachment.data for attachment in reader.iter_attachments()] == [b"a: 1\n"]
    assert sum(1 for _ in StreamReader(io.BytesIO(sink.data), validate_crcs=True).records) > 200


def test_own_reader_returns_everything_in_order(tmp_path: Path) -> None:
    sink = Memory(gulp=777)
    fill(sink)
    items, reader = read(bytes(sink.data), tmp_path)
    assert items[0] == RawMetadata("flight", {"vehicle": "uav_1"})
    assert items[1] == RawAttachment("configuration.yaml", "application/yaml", b"a: 1\n")
    messages = [item for item in items if isinstance(item, RawMessage)]
    assert [message.sequence for message in messages] == list(range(200))
    assert {message.channel.topic for message in messages} == {"/a", "/b"}
    assert messages[7].data == b"message 7 " * 20
    assert reader.complete
    assert reader.bytes_lost == 0


def test_a_file_cut_anywhere_gives_every_whole_chunk_before_the_cut(tmp_path: Path) -> None:
    sink = Memory()
    fill(sink)
    whole = bytes(sink.data)
    seen = -1
    for cut in range(0, len(whole), 13):
        items, reader = read(whole[:cut], tmp_path)
        count = sum(isinstance(item, RawMessage) for item in items)
        assert not reader.complete
        assert count >= seen, "a longer file never gives less"
        assert 0 <= reader.bytes_lost <= cut
        seen = count
    assert seen == 200


def test_a_damaged_chunk_costs_its_own_messages_only(tmp_path: Path) -> None:
    sink = Memory()
    fill(sink)
    broken = bytearray(sink.data)
    index = make_reader(io.BytesIO(sink.data)).get_summary()
    assert index is not None
    chunk = index.chunk_indexes[2]
    broken[chunk.chunk_start_offset + chunk.chunk_length - 20] ^= 0xFF
    items, reader = read(bytes(broken), tmp_path)
    sequences = [item.sequence for item in items if isinstance(item, RawMessage)]
    lost = set(range(200)) - set(sequences)
    times = range(chunk.message_start_time - 1000, chunk.message_end_time - 1000 + 1)
    assert lost == set(times)
    assert reader.bytes_lost == chunk.chunk_length


@pytest.mark.parametrize("position", range(8, 3000, 61))
def test_a_flipped_byte_never_raises_and_never_invents_a_message(position: int, tmp_path: Path) -> None:
    sink = Memory()
    fill(sink, messages=60)
    broken = bytearray(sink.data)
    broken[position % len(broken)] ^= 0x41
    items, _ = read(bytes(broken), tmp_path)
    for item in items:
        if isinstance(item, RawMessage):
            assert item.data == f"message {item.sequence} ".encode() * 20


def test_absurd_lengths_are_refused_before_memory_is_taken(tmp_path: Path) -> None:
    sink = Memory()
    fill(sink, finish=False, messages=1)
    record = struct.pack("<BQ", 6, 2**63) + bytes(100)
    items, reader = read(bytes(sink.data) + record, tmp_path)
    assert sum(isinstance(item, RawMessage) for item in items) == 1
    assert reader.bytes_lost == len(record)
    chunk = struct.pack("<QQQII4sQ", 0, 0, 2**40, 0, 4, b"zstd", 3) + b"abc"
    items, reader = read(bytes(sink.data) + struct.pack("<BQ", 6, len(chunk)) + chunk, tmp_path)
    assert sum(isinstance(item, RawMessage) for item in items) == 1
    assert reader.bytes_lost == 9 + len(chunk)


def test_zeros_after_a_power_cut_end_the_file(tmp_path: Path) -> None:
    sink = Memory()
    fill(sink, finish=False)
    items, reader = read(bytes(sink.data) + bytes(5000), tmp_path)
    assert sum(isinstance(item, RawMessage) for item in items) == 200
    assert reader.bytes_lost == 5000


def test_something_else_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no MCAP file"):
        read(b"GIF89a and so on", tmp_path)
    with pytest.raises(LogError, match="cannot be read"):
        ContainerReader(tmp_path / "missing.mcap")
    assert read(MAGIC[:3], tmp_path)[0] == []


def test_a_full_disk_raises_and_tells_where_the_last_whole_record_ended(tmp_path: Path) -> None:
    sink = Memory(room=3000, gulp=500)
    writer = ContainerWriter(sink, chunk_bytes=1024, compression_level=1)
    channel = writer.add_channel("/a", "json", schema_name="A", schema_encoding="jsonschema", schema=b"{}")
    rng = np.random.default_rng(1)

    def write_on() -> None:
        for sequence in range(10_000):
            writer.add_message(channel, sequence, sequence, rng.bytes(200))

    with pytest.raises(OSError, match="No space"):
        write_on()
    assert writer.whole_size < len(sink.data) == 3000
    _, reader = read(bytes(sink.data[: writer.whole_size]), tmp_path)
    assert reader.bytes_lost == 0
