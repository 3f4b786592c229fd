"""Datagrams as a network capture on Ethernet: PCAP and PCAPNG with nanosecond stamps.

Sources: draft-ietf-opsawg-pcap, draft-ietf-opsawg-pcapng, RFC 791, RFC 768.
"""

import struct
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from companion.clock import NANOSECONDS_PER_SECOND
from companion.drivers.livox_protocol import pack_ip
from companion.messages import Datagram

_SNAPLEN = 262_144
_ETHERNET = 1
_PCAP_NANOSECONDS = 0xA1B23C4D
_ETHERNET_HEAD = bytes.fromhex("020000000002 020000000001 0800")
_IP = struct.Struct(">BBHHHBBH4s4s")
_UDP = struct.Struct(">HHHH")
_DO_NOT_FRAGMENT = 0x4000
_TIME_TO_LIVE, _UDP_PROTOCOL = 64, 17
_NO_CHECKSUM = 0
_SECTION, _INTERFACE, _ENHANCED = 0x0A0D0D0A, 1, 6
_OPTION_RESOLUTION = struct.pack("<HHB3xHH", 9, 1, 9, 0, 0)


def write_pcap(path: Path, datagrams: Iterable[Datagram]) -> None:
    """Write a PCAP file; an older file is replaced.

    Args:
        path: where to.
        datagrams: in the order of capture, with times since 1970 below 2106.
    """
    record = struct.Struct("<IIII")
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", _PCAP_NANOSECONDS, 2, 4, 0, 0, _SNAPLEN, _ETHERNET))
        for datagram in datagrams:
            frame = ethernet_frame(datagram)
            seconds, fraction = divmod(datagram.t_ns, NANOSECONDS_PER_SECOND)
            file.write(record.pack(seconds, fraction, len(frame), len(frame)) + frame)


def write_pcapng(path: Path, datagrams: Iterable[Datagram]) -> None:
    """Write a PCAPNG file of one section and one interface; an older file is replaced.

    Args:
        path: where to.
        datagrams: in the order of capture.
    """
    with path.open("wb") as file:
        file.write(_block(_SECTION, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)))
        file.write(_block(_INTERFACE, struct.pack("<HHI", _ETHERNET, 0, _SNAPLEN) + _OPTION_RESOLUTION))
        for datagram in datagrams:
            frame = ethernet_frame(datagram)
            high, low = divmod(datagram.t_ns, 1 << 32)
            head = struct.pack("<IIIII", 0, high, low, len(frame), len(frame))
            file.write(_block(_ENHANCED, head + frame))


def ethernet_frame(datagram: Datagram) -> bytes:
    """Return the Ethernet frame that carries a datagram."""
    source, destination = pack_ip(datagram.source[0]), pack_ip(datagram.destination[0])
    udp = _UDP.pack(datagram.source[1], datagram.destination[1], 8 + len(datagram.payload), _NO_CHECKSUM)
    ip = _ip_header(source, destination, 20 + len(udp) + len(datagram.payload))
    return _ETHERNET_HEAD + ip + udp + datagram.payload


@lru_cache(maxsize=64)
def _ip_header(source: bytes, destination: bytes, length: int) -> bytes:
    fields = (0x45, 0, length, 0, _DO_NOT_FRAGMENT, _TIME_TO_LIVE, _UDP_PROTOCOL)
    total = sum(struct.unpack(">10H", _IP.pack(*fields, 0, source, destination)))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return _IP.pack(*fields, ~total & 0xFFFF, source, destination)


def _block(kind: int, body: bytes) -> bytes:
    padded = body + bytes(-len(body) % 4)
    length = struct.pack("<I", 12 + len(padded))
    return struct.pack("<I", kind) + length + padded + length
