"""MAVLink bytes to and from messages, for the emulator, the log and tests.

The tables (field layout, checksum seeds) are pymavlink's; framing is done here, because a receiver that
resynchronises byte by byte loses one damaged frame where pymavlink's loses its neighbours as well, and
because sequence numbers are counted per sender. `development` is `common` plus CURRENT_MODE.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from pymavlink.dialects.v20 import development as dialect

from companion.messages import MavlinkMessage

MAX_FRAME_BYTES = 280
_START_V1 = 0xFE
_START_V2 = 0xFD
_HEADER_V1 = 6
_HEADER_V2 = 10
_SIGNED = 0x01
_SIGNATURE_BYTES = 13
_CHECKSUM_BYTES = 2
# Extensions that PX4 1.18 sends and pymavlink 2.4.50 does not know; they change no checksum seed.
_NEWER_EXTENSIONS: dict[str, dict[str, str]] = {"TIMESYNC": {"target_system": "B", "target_component": "B"}}


@dataclass(frozen=True, slots=True)
class _Field:
    """One field in wire order: how many values it takes, and how they become one."""

    name: str
    values: int
    is_text: bool
    is_array: bool


@dataclass(frozen=True, slots=True)
class _Layout:
    """One message type of the dialect."""

    id: int
    name: str
    fields: tuple[_Field, ...]
    declared: tuple[str, ...]
    extensions: frozenset[str]
    packer: struct.Struct
    checksum_seed: int
    flat: bool
    """No field is an array or a text, or a single character."""
    order: tuple[int, ...]
    """Places of the declared fields among those in wire order."""


@dataclass(frozen=True, slots=True)
class CodecStatistics:
    """What a parser has met since it was made.

    Attributes:
        frames: whole frames with a correct checksum.
        bad_checksums: candidates for a frame whose checksum was wrong.
        bad_flags: frames that demand an unknown feature.
        unknown: frames of a type outside the dialect.
        signed: frames with a signature, which is not verified.
        lost: gaps in the senders' sequence numbers.
        skipped_bytes: bytes that belonged to no frame.
    """

    frames: int
    bad_checksums: int
    bad_flags: int
    unknown: int
    signed: int
    lost: int
    skipped_bytes: int


@lru_cache(maxsize=512)
def _layout(message_id: int) -> _Layout | None:
    kind: Any = dialect.mavlink_map.get(message_id)
    if kind is None:
        return None
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    fields: list[_Field] = []
    for name, length, array_length in zip(
        kind.ordered_fieldnames, kind.lengths, kind.array_lengths, strict=True
    ):
        # A text is one value to `struct`, whatever its length.
        is_text = types[name] == "char" and array_length > 0
        fields.append(_Field(name, length, is_text, array_length > 0 and not is_text))
    defaults = kind.__init__.__defaults__ or ()
    newer = _NEWER_EXTENSIONS.get(kind.msgname, {})
    fields.extend(_Field(name, 1, False, False) for name in newer)
    places = {field.name: place for place, field in enumerate(fields)}
    declared = (*kind.fieldnames, *newer)
    return _Layout(
        id=message_id,
        name=kind.msgname,
        fields=tuple(fields),
        declared=declared,
        extensions=frozenset((*kind.fieldnames[len(kind.fieldnames) - len(defaults) :], *newer)),
        packer=struct.Struct(kind.unpacker.format + "".join(newer.values())),
        checksum_seed=kind.crc_extra,
        flat="char" not in types.values() and not any(field.is_array for field in fields),
        order=tuple(places[name] for name in declared),
    )


_IDS: dict[str, int] = {kind.msgname: number for number, kind in dialect.mavlink_map.items()}


def _checksum(body: bytes, seed: int) -> int:
    return int(dialect.x25crc(body + bytes((seed,))).crc)


def message_id(name: str) -> int:
    """Return the number of a message type, for example 245 for ``EXTENDED_SYS_STATE``.

    Raises:
        ValueError: if the dialect does not know it.
    """
    try:
        return _IDS[name]
    except KeyError:
        raise ValueError(f"{name!r} is not a message of the MAVLink dialect") from None


class MavlinkEncoder:
    """Turns messages into MAVLink 2 frames; counts sequence numbers per sender."""

    def __init__(self) -> None:
        """Begin every sender's sequence at 0."""
        self._sequences: dict[tuple[int, int], int] = {}

    def encode(self, message: MavlinkMessage) -> bytes:
        """Return the frame of `message`, trailing zero bytes of the payload cut off.

        Extension fields may be left out. Values are rounded to the field's precision.

        Raises:
            ValueError: if the type is unknown or a field is missing, unknown or does not fit.
        """
        layout = _layout(message_id(message.name))
        assert layout is not None
        payload = _pack(layout, message.fields).rstrip(b"\0") or b"\0"
        sender = (message.system_id, message.component_id)
        sequence = self._sequences.get(sender, 0)
        self._sequences[sender] = (sequence + 1) & 0xFF
        header = struct.pack(
            "<BBBBBBBHB",
            _START_V2,
            len(payload),
            0,
            0,
            sequence,
            message.system_id,
            message.component_id,
            layout.id & 0xFFFF,
            layout.id >> 16,
        )
        return header + payload + struct.pack("<H", _checksum(header[1:] + payload, layout.checksum_seed))


def _pack(layout: _Layout, fields: Mapping[str, object]) -> bytes:
    unknown = fields.keys() - set(layout.declared)
    if unknown:
        raise ValueError(f"{layout.name} has no field {sorted(unknown)[0]!r}")
    values: list[object] = []
    for field in layout.fields:
        if field.name in fields:
            value = fields[field.name]
        elif field.name in layout.extensions:
            value = "" if field.is_text else [0] * field.values if field.is_array else 0
        else:
            raise ValueError(f"{layout.name} needs the field {field.name!r}")
        if field.is_text:
            values.append(str(value).encode("utf-8"))
        elif field.is_array:
            if not isinstance(value, Sequence) or len(value) != field.values:
                raise ValueError(f"{layout.name}.{field.name} needs {field.values} values")
            values.extend(value)
        else:
            values.append(value)
    try:
        return layout.packer.pack(*values)
    except (struct.error, OverflowError, TypeError) as error:
        raise ValueError(f"{layout.name} does not fit its fields: {error}") from None


def _unpack(layout: _Layout, payload: bytes) -> dict[str, object]:
    size = layout.packer.size
    values = layout.packer.unpack(payload[:size].ljust(size, b"\0"))
    if layout.flat:
        return dict(zip(layout.declared, map(values.__getitem__, layout.order), strict=True))
    wire: dict[str, object] = {}
    position = 0
    for field in layout.fields:
        if field.is_text:
            wire[field.name] = values[position].split(b"\0", 1)[0].decode("utf-8", "replace")
        elif field.is_array:
            wire[field.name] = list(values[position : position + field.values])
        elif isinstance(values[position], bytes):
            wire[field.name] = values[position].rstrip(b"\0").decode("utf-8", "replace")
        else:
            wire[field.name] = values[position]
        position += field.values if field.is_array else 1
    return {name: wire[name] for name in layout.declared}


class MavlinkParser:
    """Finds MAVLink 1 and 2 frames in a stream of bytes, whatever else the stream holds."""

    def __init__(self) -> None:
        """Begin with an empty buffer."""
        self._buffer = bytearray()
        self._expected: dict[tuple[int, int], int] = {}
        self._frames = self._bad_checksums = self._bad_flags = 0
        self._unknown = self._signed = self._lost = self._skipped = 0

    @property
    def statistics(self) -> CodecStatistics:
        """Counts so far."""
        return CodecStatistics(
            self._frames,
            self._bad_checksums,
            self._bad_flags,
            self._unknown,
            self._signed,
            self._lost,
            self._skipped,
        )

    @property
    def buffered_bytes(self) -> int:
        """Bytes kept for the next call; always fewer than the largest frame."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[MavlinkMessage]:
        """Return the messages completed by `data`; never raises."""
        self._buffer += data
        buffer = self._buffer
        messages: list[MavlinkMessage] = []
        position = 0
        while position < len(buffer):
            start = buffer[position]
            if start not in (_START_V1, _START_V2):
                position += 1
                self._skipped += 1
                continue
            header = _HEADER_V2 if start == _START_V2 else _HEADER_V1
            if len(buffer) - position < header:
                break
            length = header + buffer[position + 1] + _CHECKSUM_BYTES
            if start == _START_V2 and buffer[position + 2] & _SIGNED:
                length += _SIGNATURE_BYTES
            if len(buffer) - position < length:
                break
            following = buffer[position + length] if position + length < len(buffer) else None
            taken = self._take(bytes(buffer[position : position + length]), following, messages)
            position += taken
            self._skipped += taken == 1
        del buffer[:position]
        return messages

    def _take(self, frame: bytes, following: int | None, messages: list[MavlinkMessage]) -> int:
        """Judge one candidate; return how many of its bytes are done with: all, or only the first."""
        if frame[0] == _START_V2:
            header, flags = _HEADER_V2, frame[2]
            sequence, system_id, component_id = frame[4], frame[5], frame[6]
            number = int.from_bytes(frame[7:10], "little")
        else:
            header, flags = _HEADER_V1, 0
            sequence, system_id, component_id, number = frame[2], frame[3], frame[4], frame[5]
        layout = _layout(number)
        if layout is None:
            # Its checksum cannot be told; a frame it is when another begins where it ends.
            if following not in (None, _START_V1, _START_V2):
                return 1
            self._unknown += 1
            self._count_sequence(system_id, component_id, sequence)
            return len(frame)
        if flags & ~_SIGNED:
            self._bad_flags += 1
            return 1
        payload_end = header + frame[1]
        checksum = int.from_bytes(frame[payload_end : payload_end + 2], "little")
        if checksum != _checksum(frame[1:payload_end], layout.checksum_seed):
            self._bad_checksums += 1
            return 1
        self._frames += 1
        self._signed += flags & _SIGNED
        self._count_sequence(system_id, component_id, sequence)
        fields = _unpack(layout, frame[header:payload_end])
        messages.append(MavlinkMessage(layout.name, system_id, component_id, fields))
        return len(frame)

    def _count_sequence(self, system_id: int, component_id: int, sequence: int) -> None:
        sender = (system_id, component_id)
        expected = self._expected.get(sender)
        if expected is not None:
            gap = (sequence - expected) & 0xFF
            # Going back by a little is a late frame, not a loss of nearly 256.
            self._lost += gap if gap < 128 else 0
        if expected is not None or len(self._expected) < 64:
            self._expected[sender] = (sequence + 1) & 0xFF
