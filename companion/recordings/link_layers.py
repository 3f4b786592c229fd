"""From a captured frame to the UDP datagram in it: link layers, VLAN tags, IPv4 with options.

Sources: the registry of link types at tcpdump.org; RFC 791 and RFC 768; IEEE 802.1Q.
"""

import socket
import struct
from collections.abc import Callable
from enum import Enum
from functools import lru_cache

from companion.messages import Datagram
from companion.recordings.capture_frames import Frame


class Skip(Enum):
    """Why a frame holds no datagram for us."""

    OTHER = "other packets"
    NO_TIME = "packets without time"
    FRAGMENT = "fragments of packets"
    CUT = "packets cut by the capture's limit"
    MALFORMED = "malformed packets"
    LINK = "packets of an unknown link layer"


_IPV4, _VLAN_TAGS = 0x0800, (0x8100, 0x88A8, 0x9100)
_VLAN_TAGS_MAX = 4
_UDP = 17
_IP = struct.Struct(">BxHxxHxBxx4s4s")
_UDP_HEAD = struct.Struct(">HHHxx")
# AF_INET is 2 on every system; loopback captures carry it in the byte order of the host that captured.
_LOOPBACK_IPV4 = (b"\x02\x00\x00\x00", b"\x00\x00\x00\x02")


def datagram_of(frame: Frame) -> Datagram | Skip:
    """Return the datagram in a frame, or why there is none."""
    packet_at = _LINKS.get(frame.link_type)
    if packet_at is None:
        return Skip.LINK
    data = frame.data
    start = packet_at(data)
    if start is None or len(data) < start + 20 or data[start] >> 4 != 4:
        return Skip.OTHER if frame.whole else Skip.CUT
    first, total, fragment, protocol, source, destination = _IP.unpack_from(data, start)
    if protocol != _UDP:
        return Skip.OTHER
    if fragment & 0x3FFF:
        return Skip.FRAGMENT
    if frame.t_ns is None:
        return Skip.NO_TIME
    udp = start + 4 * (first & 0x0F)
    # Some network cards hand over packets whose total length is still to be filled in.
    end = start + total if total else len(data)
    if udp < start + 20 or end < udp + 8:
        return Skip.MALFORMED
    if len(data) < udp + 8:
        return Skip.CUT if not frame.whole else Skip.MALFORMED
    source_port, destination_port, length = _UDP_HEAD.unpack_from(data, udp)
    if length < 8 or udp + length > end:
        return Skip.MALFORMED
    if len(data) < udp + length:
        return Skip.CUT if not frame.whole else Skip.MALFORMED
    return Datagram(
        frame.t_ns,
        (_address(source), source_port),
        (_address(destination), destination_port),
        data[udp + 8 : udp + length],
    )


@lru_cache(maxsize=256)
def _address(packed: bytes) -> str:
    return socket.inet_ntop(socket.AF_INET, packed)


def _behind_tags(data: bytes, type_at: int) -> int | None:
    """Return where the IPv4 packet begins if the Ethernet type at `type_at` leads to one."""
    for _ in range(_VLAN_TAGS_MAX + 1):
        ethernet_type = int.from_bytes(data[type_at : type_at + 2], "big")
        if ethernet_type == _IPV4:
            return type_at + 2
        if ethernet_type not in _VLAN_TAGS:
            return None
        type_at += 4
    return None


def _ethernet(data: bytes) -> int | None:
    return _behind_tags(data, 12)


def _cooked(data: bytes) -> int | None:
    return _behind_tags(data, 14)


def _cooked_2(data: bytes) -> int | None:
    return 20 if int.from_bytes(data[:2], "big") == _IPV4 else None


def _loopback(data: bytes) -> int | None:
    return 4 if data[:4] in _LOOPBACK_IPV4 else None


def _raw(data: bytes) -> int | None:
    return 0


_LINKS: dict[int, Callable[[bytes], int | None]] = {
    0: _loopback,
    1: _ethernet,
    12: _raw,
    14: _raw,
    101: _raw,
    108: _loopback,
    113: _cooked,
    228: _raw,
    276: _cooked_2,
}
