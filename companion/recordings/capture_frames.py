"""Frames in network captures: PCAP (microseconds or nanoseconds, either byte order) and PCAPNG.

Source: draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng. Lengths in the file are believed only
within bounds; where one is impossible, nothing behind it can be found, and reading ends.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from companion.clock import NANOSECONDS_PER_SECOND
from companion.recordings.recording import damage

PCAP_MAGICS = {
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\x3c\x4d": (">", 1),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
}
"""Byte order and nanoseconds per unit of the fraction, by the first four bytes."""
PCAPNG_MAGIC = b"\x0a\x0d\x0d\x0a"

FRAME_BYTES_MAX = 262_144
BLOCK_BYTES_MAX = 16 * 1024 * 1024
INTERFACES_MAX = 1024
_T_MAX_NS = 1 << 62

_SECTION, _INTERFACE, _SIMPLE, _ENHANCED = 0x0A0D0D0A, 1, 3, 6
_OPTION_RESOLUTION, _OPTION_OFFSET = 9, 14
_SECTION_ORDERS = {b"\x1a\x2b\x3c\x4d": ">", b"\x4d\x3c\x2b\x1a": "<"}


@dataclass(frozen=True, slots=True)
class Frame:
    """What was captured of one packet on a link.

    Attributes:
        t_ns: time of capture since 1970, None if the file does not tell.
        link_type: number of the link layer in the registry of link types.
        whole: nothing was cut off by the capture's own limit.
    """

    t_ns: int | None
    link_type: int
    data: bytes
    whole: bool


@dataclass(frozen=True, slots=True)
class _Interface:
    """One interface of a PCAPNG section."""

    link_type: int
    ticks_per_s: int
    offset_s: int

    def t_ns(self, ticks: int) -> int:
        return (ticks * NANOSECONDS_PER_SECOND) // self.ticks_per_s + self.offset_s * NANOSECONDS_PER_SECOND


def pcap_frames(path: Path) -> Iterator[Frame]:
    """Yield the frames of a PCAP file in its order.

    Raises:
        LogError: where the file is cut or damaged; everything before was yielded.
        OSError: if reading the disk fails.
    """
    with path.open("rb") as file:
        head = file.read(24)
        if len(head) < 24 or head[:4] not in PCAP_MAGICS:
            raise damage(path, 0, "no complete PCAP header")
        order, fraction_ns = PCAP_MAGICS[head[:4]]
        record = struct.Struct(f"{order}IIII")
        # The upper bits tell about checksums at the frames' ends.
        link_type = struct.unpack_from(f"{order}I", head, 20)[0] & 0xFFFF
        offset = 24
        while fields := file.read(record.size):
            if len(fields) < record.size:
                raise damage(path, offset, "the file ends within a packet's header")
            seconds, fraction, length, original = record.unpack(fields)
            if length > FRAME_BYTES_MAX:
                raise damage(
                    path, offset, f"a packet of {length} bytes, at most {FRAME_BYTES_MAX} are possible"
                )
            data = file.read(length)
            if len(data) < length:
                raise damage(path, offset, "the file ends within a packet")
            t_ns = seconds * NANOSECONDS_PER_SECOND + fraction * fraction_ns
            yield Frame(t_ns, link_type, data, length >= original)
            offset += record.size + length


def pcapng_frames(path: Path) -> Iterator[Frame]:
    """Yield the frames of a PCAPNG file in its order, all sections and interfaces together.

    Raises:
        LogError: where the file is cut or damaged; everything before was yielded.
        OSError: if reading the disk fails.
    """
    order = ""
    interfaces: list[_Interface] = []
    with path.open("rb") as file:
        offset = 0
        while head := file.read(8):
            if head[:4] == PCAPNG_MAGIC:
                order = _SECTION_ORDERS.get(file.read(4), "")
                file.seek(-4, 1) if order else None
                interfaces = []
            if not order or len(head) < 8:
                raise damage(path, offset, "no PCAPNG block")
            kind, length = struct.unpack(f"{order}II", head)
            if length < 12 or length % 4 or length > BLOCK_BYTES_MAX:
                raise damage(path, offset, f"a block of {length} bytes is impossible")
            body = _block_body(path, file, offset, length, order)
            if kind == _INTERFACE:
                if len(interfaces) == INTERFACES_MAX:
                    raise damage(path, offset, f"more than {INTERFACES_MAX} interfaces")
                interfaces.append(_interface(path, offset, body, order))
            elif kind in (_ENHANCED, _SIMPLE):
                yield _frame(path, offset, kind, body, interfaces, order)
            offset += length


def _block_body(path: Path, file: BinaryIO, offset: int, length: int, order: str) -> bytes:
    rest = file.read(length - 8)
    if len(rest) < length - 8:
        raise damage(path, offset, "the file ends within a block")
    if struct.unpack(f"{order}I", rest[-4:])[0] != length:
        raise damage(path, offset, "a block's two lengths differ")
    return rest[:-4]


def _interface(path: Path, offset: int, body: bytes, order: str) -> _Interface:
    if len(body) < 8:
        raise damage(path, offset, "an interface's description is too short")
    link_type = struct.unpack_from(f"{order}H", body)[0]
    ticks_per_s, offset_s = 1_000_000, 0
    position = 8
    while position + 4 <= len(body):
        code, size = struct.unpack_from(f"{order}HH", body, position)
        value = body[position + 4 : position + 4 + size]
        position += 4 + (size + 3) // 4 * 4
        if code == 0 or len(value) < size:
            break
        if code == _OPTION_RESOLUTION and size == 1:
            ticks_per_s = pow(2 if value[0] & 0x80 else 10, value[0] & 0x7F)
        elif code == _OPTION_OFFSET and size == 8:
            offset_s = struct.unpack(f"{order}q", value)[0]
    return _Interface(link_type, ticks_per_s, offset_s)


def _frame(
    path: Path, offset: int, kind: int, body: bytes, interfaces: list[_Interface], order: str
) -> Frame:
    head = 20 if kind == _ENHANCED else 4
    if len(body) < head:
        raise damage(path, offset, "a packet's block is too short")
    t_ns: int | None = None
    if kind == _ENHANCED:
        index, high, low, length, original = struct.unpack_from(f"{order}IIIII", body)
    else:
        index, original = 0, struct.unpack_from(f"{order}I", body)[0]
        length = min(original, len(body) - head)
    if index >= len(interfaces):
        raise damage(path, offset, f"a packet of interface {index}, which was not described")
    if length > len(body) - head:
        raise damage(path, offset, f"a packet of {length} bytes in a block of {len(body)}")
    if kind == _ENHANCED:
        t_ns = interfaces[index].t_ns(high << 32 | low)
        t_ns = t_ns if 0 <= t_ns < _T_MAX_NS else None
    return Frame(t_ns, interfaces[index].link_type, body[head : head + length], length >= original)
