"""MAVLink 2 frames of the emulated vehicle: fast packing of its streams, bounded cutting of what arrives."""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from pymavlink.dialects.v20 import development as dialect

MAGIC = 0xFD
_HEADER = struct.Struct("<BBBBBBBHB")
_CHECKSUM = struct.Struct("<H")
_HEADER_LENGTH = 10
_CHECKSUM_LENGTH = 2
_SIGNATURE_LENGTH = 13
_SIGNED = 0x01
_BUFFER_MAX = 4096


class FrameEncoder:
    """Packs one kind of message straight from values, without building message objects."""

    def __init__(self, name: str) -> None:
        """Prepare for the message called `name`.

        Raises:
            KeyError: if the dialect has no such message.
        """
        message = message_class(name)
        self.message_id: int = message.id
        self._pack = message.unpacker.pack
        self._extra = bytes([message.crc_extra])
        names: list[str] = list(message.fieldnames)
        self._order = [names.index(field) for field in message.ordered_fieldnames]
        self._arrays = [
            is_array and message.fieldtypes[names.index(field)] != "char"
            for field, is_array in zip(message.ordered_fieldnames, message.array_lengths, strict=True)
        ]
        self._flat = not any(self._arrays)

    def frame(self, sequence: int, system_id: int, component_id: int, values: tuple[Any, ...]) -> bytes:
        """Return one frame.

        Args:
            sequence: 0 to 255.
            system_id: the sender's system.
            component_id: the sender's component.
            values: fields in the order of the message's definition; arrays as sequences.
        """
        if self._flat:
            payload = self._pack(*[values[index] for index in self._order])
        else:
            wire: list[Any] = []
            for index, is_array in zip(self._order, self._arrays, strict=True):
                if is_array:
                    wire.extend(values[index])
                else:
                    wire.append(values[index])
            payload = self._pack(*wire)
        payload = payload.rstrip(b"\x00") or b"\x00"
        header = _HEADER.pack(
            MAGIC,
            len(payload),
            0,
            0,
            sequence,
            system_id,
            component_id,
            self.message_id & 0xFFFF,
            self.message_id >> 16,
        )
        body = header + payload
        return body + _CHECKSUM.pack(_crc(body[1:] + self._extra))


class Message:
    """One decoded message: its fields are its attributes, texts as strings, arrays as lists."""

    def __init__(self, name: str, fields: dict[str, Any]) -> None:
        self._name = name
        self.__dict__.update(fields)

    def get_type(self) -> str:
        """Return the name of its kind."""
        return self._name


class _Layout:
    """How one kind of message is read."""

    def __init__(self, message_id: int) -> None:
        kind: Any = dialect.mavlink_map[message_id]
        self.name: str = kind.msgname
        self.seed = bytes([kind.crc_extra])
        self._unpacker: struct.Struct = kind.unpacker
        self._names: list[str] = list(kind.ordered_fieldnames)
        self._lengths: list[int] = list(kind.lengths)
        self._flat = not any(kind.array_lengths)

    def read(self, payload: bytes) -> Message:
        """Return the message; what was cut off its end is zero."""
        size = self._unpacker.size
        values = self._unpacker.unpack(payload[:size].ljust(size, b"\0"))
        if self._flat:
            return Message(self.name, dict(zip(self._names, values, strict=True)))
        fields: dict[str, Any] = {}
        at = 0
        for name, length in zip(self._names, self._lengths, strict=True):
            value = values[at]
            if isinstance(value, bytes):
                fields[name] = value.split(b"\0", 1)[0].decode("ascii", "replace")
            else:
                fields[name] = value if length == 1 else list(values[at : at + length])
            at += length
        return Message(self.name, fields)


@lru_cache(maxsize=512)
def _layout(message_id: int) -> _Layout | None:
    return _Layout(message_id) if message_id in dialect.mavlink_map else None


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame that passed its checksum.

    Attributes:
        raw: the frame as it arrived.
    """

    message_id: int
    system_id: int
    component_id: int
    message: Any  # a `Message`, whose attributes are known when it runs only
    raw: bytes


class FrameCutter:
    """Cuts a byte stream into frames; never raises, never keeps more than 4 KiB.

    Attributes:
        frames: frames cut so far.
        garbage_bytes: bytes that belonged to no valid frame.
        bad_frames: frames of unknown kind or with a wrong checksum.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.garbage_bytes = 0
        self.bad_frames = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that `data` completes."""
        frames: list[Frame] = []
        for start in range(0, len(data), _BUFFER_MAX):
            self._buffer += data[start : start + _BUFFER_MAX]
            frames.extend(self._cut())
            if len(self._buffer) > _BUFFER_MAX:
                surplus = len(self._buffer) - _BUFFER_MAX
                self.garbage_bytes += surplus
                del self._buffer[:surplus]
        return frames

    def _cut(self) -> Iterable[Frame]:
        buffer = self._buffer
        position = 0
        frames: list[Frame] = []
        while True:
            start = buffer.find(MAGIC, position)
            if start < 0:
                self.garbage_bytes += len(buffer) - position
                position = len(buffer)
                break
            self.garbage_bytes += start - position
            position = start
            if len(buffer) - start < _HEADER_LENGTH:
                break
            length = _HEADER_LENGTH + buffer[start + 1] + _CHECKSUM_LENGTH
            if buffer[start + 2] & _SIGNED:
                length += _SIGNATURE_LENGTH
            if len(buffer) - start < length:
                break
            frame = _decoded(bytes(buffer[start : start + length]))
            if frame is None:
                self.bad_frames += 1
                self.garbage_bytes += 1
                position = start + 1
                continue
            frames.append(frame)
            self.frames += 1
            position = start + length
        del buffer[:position]
        return frames


def _decoded(raw: bytes) -> Frame | None:
    """Return what a whole frame says, None if it is unknown or damaged; signatures are not judged."""
    if raw[2] & ~_SIGNED:
        return None
    message_id = raw[7] | raw[8] << 8 | raw[9] << 16
    layout = _layout(message_id)
    end = _HEADER_LENGTH + raw[1]
    if layout is None or _crc(raw[1:end] + layout.seed) != raw[end] | raw[end + 1] << 8:
        return None
    return Frame(message_id, raw[5], raw[6], layout.read(raw[_HEADER_LENGTH:end]), raw)


def message_class(name: str) -> Any:
    """Return the dialect's class of a message.

    Raises:
        KeyError: if there is none.
    """
    return dialect.mavlink_map[message_id(name)]


def message_id(name: str) -> int:
    """Return the number of a message.

    Raises:
        KeyError: if there is none.
    """
    number = getattr(dialect, f"MAVLINK_MSG_ID_{name}", None)
    if number is None or number not in dialect.mavlink_map:
        raise KeyError(name)
    return int(number)


def _crc(data: bytes) -> int:
    return int(dialect.x25crc(data).crc)
