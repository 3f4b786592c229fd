"""Raw UDP datagrams in batches: every payload with its time, source and destination, nothing lost."""

import socket
import struct
from collections.abc import Sequence
from functools import lru_cache

from companion.messages import Datagram

SCHEMA = b"""Little-endian, packed. A batch of UDP datagrams (IPv4) in the order they passed:
  u8   version = 1
  u8   reserved = 0
  u16  count
count times:
  i64  t_ns             host time of reception, or of sending
  u8   source_ip[4]
  u16  source_port
  u8   destination_ip[4]
  u16  destination_port
  u16  length
  u8   payload[length]
"""
DATAGRAMS_MAX = 4096
_VERSION = 1
_HEADER = struct.Struct("<BBH")
_ENTRY = struct.Struct("<q4sH4sHH")


@lru_cache(maxsize=64)
def _packed_address(address: str) -> bytes:
    return socket.inet_pton(socket.AF_INET, address)


@lru_cache(maxsize=64)
def _address(packed: bytes) -> str:
    return socket.inet_ntop(socket.AF_INET, packed)


def encode(datagrams: Sequence[Datagram]) -> bytes:
    """Return a batch of datagrams as bytes.

    Raises:
        ValueError: if there are more than `DATAGRAMS_MAX`, or an address or a size is not UDP over IPv4.
    """
    if len(datagrams) > DATAGRAMS_MAX:
        raise ValueError(f"{len(datagrams)} datagrams in one batch, at most {DATAGRAMS_MAX} fit")
    parts = [_HEADER.pack(_VERSION, 0, len(datagrams))]
    try:
        for datagram in datagrams:
            source, destination = datagram.source, datagram.destination
            parts.append(
                _ENTRY.pack(
                    datagram.t_ns,
                    _packed_address(source[0]),
                    source[1],
                    _packed_address(destination[0]),
                    destination[1],
                    len(datagram.payload),
                )
            )
            parts.append(datagram.payload)
    except (OSError, struct.error) as error:
        raise ValueError(f"not a UDP datagram over IPv4: {error}") from error
    return b"".join(parts)


def decode(data: bytes) -> tuple[Datagram, ...]:
    """Return the datagrams of a batch.

    Raises:
        ValueError: if the bytes are not a batch.
    """
    try:
        version, _, count = _HEADER.unpack_from(data)
        if version != _VERSION or count > DATAGRAMS_MAX:
            raise ValueError(f"batch of version {version} with {count} datagrams")
        datagrams = []
        position = _HEADER.size
        for _ in range(count):
            t_ns, source, source_port, destination, destination_port, length = _ENTRY.unpack_from(
                data, position
            )
            position += _ENTRY.size
            payload = data[position : position + length]
            position += length
            if len(payload) != length:
                raise ValueError("the batch ends inside a payload")
            datagrams.append(
                Datagram(
                    t_ns, (_address(source), source_port), (_address(destination), destination_port), payload
                )
            )
    except struct.error as error:
        raise ValueError(f"the batch ends inside a header: {error}") from error
    if position != len(data):
        raise ValueError(f"{len(data) - position} bytes follow the batch")
    return tuple(datagrams)
