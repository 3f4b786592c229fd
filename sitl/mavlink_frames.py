"""MAVLink 2 frames of the emulated vehicle: fast packing of its streams, bounded cutting of what arrives."""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame that passed its checksum.

    Attributes:
        message: the decoded pymavlink message.
        raw: the frame as it arrived.
    """

    message_id: int
    system_id: int
    component_id: int
    message: Any
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
        self._decoder = dialect.MAVLink(None)

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
            frame = self._decode(bytes(buffer[start : start + length]))
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

    def _decode(self, raw: bytes) -> Frame | None:
        if raw[2] & ~_SIGNED:
            return None
        message_id = raw[7] | raw[8] << 8 | raw[9] << 16
        if message_id not in dialect.mavlink_map:
            return None
        try:
            message = self._decoder.decode(bytearray(raw))
        except (dialect.MAVError, struct.error, ValueError, TypeError, IndexError):
            return None
        return Frame(message_id, raw[5], raw[6], message, raw)


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
