"""Control protocol of the Livox Mid-360: command frames and parameter bodies, bytes <-> records.

No sockets, no state. Everything is little-endian. Every parse function checks sizes against the bytes
that really arrived and raises `ProtocolError`; nothing else can go wrong with bytes from the wire.
"""

import binascii
import ipaddress
import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum

from companion.errors import ProtocolError

START_OF_FRAME = 0xAA
PROTOCOL_VERSION = 0
FRAME_HEADER_SIZE = 24
MAX_FRAME_SIZE = 1400
MAX_SEQUENCE = 65_535
BROADCAST_IP = "255.255.255.255"

_HEADER = struct.Struct("<BBHIHBB6sHI")
_CHECKED_HEADER_SIZE = 18


class Command(IntEnum):
    """Commands of the control protocol."""

    SEARCH = 0x0000
    SET_PARAMETERS = 0x0100
    GET_PARAMETERS = 0x0101
    PUSH = 0x0102
    REBOOT = 0x0200
    FACTORY_RESET = 0x0201
    SET_RMC_TIME = 0x0202
    LOG_PUSH = 0x0300
    LOG_ENABLE = 0x0301
    LOG_TIME_SYNC = 0x0302
    DEBUG_RAW_DATA = 0x0303
    UPGRADE_START = 0x0400
    UPGRADE_DATA = 0x0401
    UPGRADE_COMPLETE = 0x0402
    UPGRADE_PROGRESS = 0x0403


class Key(IntEnum):
    """Parameters of the sensor; 0x8000 and above are read-only."""

    PCL_DATA_TYPE = 0x0000
    PATTERN_MODE = 0x0001
    DUAL_EMIT = 0x0002
    POINT_SEND = 0x0003
    LIDAR_ADDRESS = 0x0004
    STATE_HOST = 0x0005
    POINT_HOST = 0x0006
    IMU_HOST = 0x0007
    INSTALL_ATTITUDE = 0x0012
    BLIND_SPOT = 0x0013
    FOV_0 = 0x0015
    FOV_1 = 0x0016
    FOV_ENABLE = 0x0017
    DETECT_MODE = 0x0018
    FUNCTION_IO = 0x0019
    WORK_TARGET = 0x001A
    IMU_DATA_ENABLE = 0x001C
    MOTOR_SPEED = 0x0021
    TIME_FILTER = 0x0026
    IMU_RANGE = 0x002B
    SERIAL = 0x8000
    PRODUCT_INFO = 0x8001
    VERSION_APPLICATION = 0x8002
    VERSION_LOADER = 0x8003
    VERSION_HARDWARE = 0x8004
    MAC = 0x8005
    WORK_STATE = 0x8006
    CORE_TEMPERATURE = 0x8007
    POWER_UP_COUNT = 0x8008
    LOCAL_TIME = 0x8009
    LAST_SYNC_TIME = 0x800A
    TIME_OFFSET = 0x800B
    TIME_SYNC_TYPE = 0x800C
    DIAGNOSIS = 0x800E
    FIRMWARE_TYPE = 0x8010
    HMS_CODES = 0x8011


class ReturnCode(IntEnum):
    """First byte of every acknowledgement."""

    OK = 0x00
    FAILURE = 0x01
    NOT_PERMITTED = 0x02
    OUT_OF_RANGE = 0x03
    NOT_SUPPORTED = 0x20
    NEEDS_REBOOT = 0x21
    READ_ONLY = 0x22
    WRONG_LENGTH = 0x23
    KEY_COUNT_MISMATCH = 0x24


class WorkState(IntEnum):
    """Working states of the sensor; 1, 2 and 9 can be asked for."""

    SAMPLING = 0x01
    IDLE = 0x02
    ERROR = 0x04
    SELF_CHECK = 0x05
    MOTOR_STARTUP = 0x06
    UPGRADE = 0x08
    READY = 0x09


class DeviceType(IntEnum):
    """Device types that this driver serves."""

    MID360 = 9
    MID360S = 35


@dataclass(frozen=True, slots=True)
class CommandFrame:
    """One frame of the control protocol.

    Attributes:
        sequence: number chosen by the requester; the acknowledgement repeats it.
        command: command id, see `Command`; unknown ids are legal.
        acknowledges: True for an answer, False for a request or a push.
        from_lidar: who sent it.
        data: body, at most 1376 bytes.
    """

    sequence: int
    command: int
    acknowledges: bool
    from_lidar: bool
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class SearchAnswer:
    """Body of the answer to a search: who is there."""

    return_code: int
    device_type: int
    serial: str
    lidar_ip: str
    command_port: int


@dataclass(frozen=True, slots=True)
class StreamAddress:
    """Where the sensor sends one of its streams: keys 0x0005, 0x0006 and 0x0007."""

    ip: str
    port: int
    source_port: int = 0

    def pack(self) -> bytes:
        """Return the eight bytes of the parameter."""
        return struct.pack("<4sHH", pack_ip(self.ip), self.port, self.source_port)


Parameters = Sequence[tuple[int, bytes]]

_SEARCH_ANSWER = struct.Struct("<BB16s4sH")


def build_frame(frame: CommandFrame) -> bytes:
    """Return the bytes of a command frame.

    Raises:
        ValueError: if the frame would be longer than 1400 bytes.
    """
    length = FRAME_HEADER_SIZE + len(frame.data)
    if length > MAX_FRAME_SIZE:
        raise ValueError(f"a command frame of {length} bytes exceeds {MAX_FRAME_SIZE}")
    header = _HEADER.pack(
        START_OF_FRAME, PROTOCOL_VERSION, length, frame.sequence & 0xFFFF_FFFF, frame.command,
        int(frame.acknowledges), int(frame.from_lidar), bytes(6), 0, zlib.crc32(frame.data),
    )  # fmt: skip
    checked = header[:_CHECKED_HEADER_SIZE]
    crc16 = binascii.crc_hqx(checked, 0xFFFF)
    return checked + crc16.to_bytes(2, "little") + header[20:] + frame.data


def parse_frame(payload: bytes) -> CommandFrame:
    """Return the command frame at the start of a datagram.

    Raises:
        ProtocolError: if a size, a constant or one of the two checksums is wrong.
    """
    if len(payload) < FRAME_HEADER_SIZE:
        raise ProtocolError(f"a command frame has at least {FRAME_HEADER_SIZE} bytes, got {len(payload)}")
    start, version, length, sequence, command, kind, sender, _, crc16, crc32 = _HEADER.unpack_from(payload)
    if start != START_OF_FRAME or version != PROTOCOL_VERSION:
        raise ProtocolError(f"not a command frame: starts with 0x{start:02x}, version {version}")
    if not FRAME_HEADER_SIZE <= length <= min(MAX_FRAME_SIZE, len(payload)):
        raise ProtocolError(f"frame length {length} does not fit a datagram of {len(payload)} bytes")
    if binascii.crc_hqx(payload[:_CHECKED_HEADER_SIZE], 0xFFFF) != crc16:
        raise ProtocolError("wrong header checksum")
    data = bytes(payload[FRAME_HEADER_SIZE:length])
    if zlib.crc32(data) != crc32:
        raise ProtocolError("wrong body checksum")
    if kind > 1 or sender > 1:
        raise ProtocolError(f"unknown command type {kind} or sender {sender}")
    return CommandFrame(sequence, command, kind == 1, sender == 1, data)


def build_parameters(parameters: Parameters) -> bytes:
    """Return the body of a set request or a push: count, reserved, then key, length and value each."""
    return struct.pack("<HH", len(parameters), 0) + _pack_parameters(parameters)


def parse_parameters(body: bytes) -> list[tuple[int, bytes]]:
    """Return keys and values of a set request or a push, in the order sent.

    Raises:
        ProtocolError: if the body ends early, is too long or announces another number of keys.
    """
    if len(body) < 4:
        raise ProtocolError(f"a parameter list has at least 4 bytes, got {len(body)}")
    return _unpack_parameters(body, 4, int.from_bytes(body[:2], "little"))


def build_query(keys: Iterable[int]) -> bytes:
    """Return the body of a get request."""
    listed = list(keys)
    return struct.pack(f"<HH{len(listed)}H", len(listed), 0, *listed)


def parse_query(body: bytes) -> list[int]:
    """Return the keys of a get request.

    Raises:
        ProtocolError: if the number of keys does not fit the body.
    """
    if len(body) < 4:
        raise ProtocolError(f"a query has at least 4 bytes, got {len(body)}")
    count = int.from_bytes(body[:2], "little")
    if len(body) != 4 + 2 * count:
        raise ProtocolError(f"a query of {count} keys has {4 + 2 * count} bytes, got {len(body)}")
    return list(struct.unpack_from(f"<{count}H", body, 4))


def build_query_answer(return_code: int, parameters: Parameters) -> bytes:
    """Return the body of the answer to a get request."""
    return struct.pack("<BH", return_code, len(parameters)) + _pack_parameters(parameters)


def parse_query_answer(body: bytes) -> tuple[int, dict[int, bytes]]:
    """Return the return code and the values of the answer to a get request (none if it failed).

    Raises:
        ProtocolError: if the body ends early, is too long or announces another number of keys.
    """
    return_code = parse_return_code(body)
    if return_code != ReturnCode.OK and len(body) < 3:
        return return_code, {}
    if len(body) < 3:
        raise ProtocolError(f"an answer to a query has at least 3 bytes, got {len(body)}")
    return return_code, dict(_unpack_parameters(body, 3, int.from_bytes(body[1:3], "little")))


def build_set_answer(return_code: int, error_key: int = 0) -> bytes:
    """Return the body of the answer to a set request; `error_key` names the first bad key."""
    return struct.pack("<BH", return_code, error_key)


def parse_set_answer(body: bytes) -> tuple[int, int]:
    """Return the return code and the first bad key of the answer to a set request.

    Raises:
        ProtocolError: if the body is not 3 bytes long.
    """
    if len(body) != 3:
        raise ProtocolError(f"an answer to a set request has 3 bytes, got {len(body)}")
    return body[0], int.from_bytes(body[1:], "little")


def parse_return_code(body: bytes) -> int:
    """Return the first byte of an acknowledgement.

    Raises:
        ProtocolError: if the body is empty.
    """
    if not body:
        raise ProtocolError("an acknowledgement has at least 1 byte")
    return body[0]


def build_search_answer(answer: SearchAnswer) -> bytes:
    """Return the body of the answer to a search."""
    return _SEARCH_ANSWER.pack(
        answer.return_code, answer.device_type, answer.serial.encode("ascii"), pack_ip(answer.lidar_ip),
        answer.command_port,
    )  # fmt: skip


def parse_search_answer(body: bytes) -> SearchAnswer:
    """Return who answered a search.

    Raises:
        ProtocolError: if the body is not 24 bytes long.
    """
    if len(body) != _SEARCH_ANSWER.size:
        raise ProtocolError(f"an answer to a search has {_SEARCH_ANSWER.size} bytes, got {len(body)}")
    return_code, device_type, serial, ip, port = _SEARCH_ANSWER.unpack(body)
    return SearchAnswer(return_code, device_type, unpack_text(serial), unpack_ip(ip), port)


def parse_stream_address(value: bytes) -> StreamAddress:
    """Return the address in the value of key 0x0005, 0x0006 or 0x0007.

    Raises:
        ProtocolError: if the value is not 8 bytes long.
    """
    if len(value) != 8:
        raise ProtocolError(f"a stream address has 8 bytes, got {len(value)}")
    ip, port, source_port = struct.unpack("<4sHH", value)
    return StreamAddress(unpack_ip(ip), port, source_port)


def pack_ip(ip: str) -> bytes:
    """Return the four bytes of a dotted IPv4 address."""
    return ipaddress.IPv4Address(ip).packed


def unpack_ip(packed: bytes) -> str:
    """Return four bytes as a dotted IPv4 address."""
    return str(ipaddress.IPv4Address(packed))


def unpack_text(value: bytes) -> str:
    """Return a NUL padded string; what is not printable ASCII becomes a question mark."""
    text = value.split(b"\0", 1)[0]
    return "".join(chr(byte) if 32 <= byte < 127 else "?" for byte in text)


def _pack_parameters(parameters: Parameters) -> bytes:
    return b"".join(struct.pack("<HH", key, len(value)) + value for key, value in parameters)


def _unpack_parameters(body: bytes, offset: int, count: int) -> list[tuple[int, bytes]]:
    parameters: list[tuple[int, bytes]] = []
    while offset < len(body) and len(parameters) < count:
        if offset + 4 > len(body):
            raise ProtocolError("the parameter list ends within a key")
        key, length = struct.unpack_from("<HH", body, offset)
        offset += 4
        if offset + length > len(body):
            raise ProtocolError(f"the value of key 0x{key:04x} ends after the body")
        parameters.append((key, bytes(body[offset : offset + length])))
        offset += length
    if len(parameters) != count or offset != len(body):
        raise ProtocolError(f"{count} keys announced, {len(parameters)} found in {len(body)} bytes")
    return parameters
