from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.drivers import livox_protocol as protocol
from companion.drivers.livox_protocol import Command, CommandFrame, Key, StreamAddress
from companion.errors import ProtocolError
from tests.drivers.livox_vectors import COMMANDS

FRAMES = {name: bytes.fromhex(text) for name, text in COMMANDS.items()}
ALL = pytest.mark.parametrize("payload", FRAMES.values(), ids=FRAMES.keys())
frames = st.builds(
    CommandFrame,
    st.integers(0, 2**32 - 1),
    st.integers(0, 0xFFFF),
    st.booleans(),
    st.booleans(),
    st.binary(max_size=1376),
)
parameter_lists = st.lists(st.tuples(st.integers(0, 0xFFFF), st.binary(max_size=64)), max_size=16)


def is_refused(parse: Callable[[bytes], object], payload: bytes) -> bool:
    try:
        parse(payload)
    except ProtocolError:
        return True
    return False


def body(name: str) -> bytes:
    return protocol.parse_frame(FRAMES[name]).data


@ALL
def test_a_published_frame_is_parsed_and_built_again_byte_for_byte(payload: bytes) -> None:
    assert protocol.build_frame(protocol.parse_frame(payload)) == payload


def test_published_frames_have_the_published_meaning() -> None:
    search = protocol.parse_frame(FRAMES["search"])
    assert search == CommandFrame(1, Command.SEARCH, acknowledges=False, from_lidar=False)
    answer = protocol.parse_search_answer(body("search answer"))
    assert (answer.return_code, answer.device_type, answer.serial) == (0, 9, "47MDL3Q0020001")
    assert (answer.lidar_ip, answer.command_port) == ("192.168.1.101", 56_100)
    assert protocol.parse_query(body("query firmware type")) == [Key.FIRMWARE_TYPE]
    assert protocol.parse_query_answer(body("firmware type answer")) == (0, {Key.FIRMWARE_TYPE: b"\x01"})
    addresses = {
        key: protocol.parse_stream_address(value)
        for key, value in protocol.parse_parameters(body("set host addresses"))
    }
    assert addresses == {
        Key.STATE_HOST: StreamAddress("192.168.1.50", 56_201, 56_200),
        Key.POINT_HOST: StreamAddress("192.168.1.50", 56_301, 56_300),
        Key.IMU_HOST: StreamAddress("192.168.1.50", 56_401, 56_400),
    }
    assert protocol.parse_set_answer(body("set answer")) == (0, 0)
    assert protocol.parse_set_answer(body("set refused")) == (0x20, 0x0002)
    assert protocol.parse_parameters(body("set sampling")) == [(Key.WORK_TARGET, b"\x01")]
    push = protocol.parse_frame(FRAMES["push"])
    assert (push.command, push.acknowledges, push.from_lidar) == (Command.PUSH, False, True)
    assert dict(protocol.parse_parameters(push.data)) == {
        Key.WORK_STATE: b"\x01",
        Key.CORE_TEMPERATURE: (4512).to_bytes(4, "little"),
    }


@ALL
def test_every_split_of_a_frame_is_refused(payload: bytes) -> None:
    for size in range(len(payload)):
        with pytest.raises(ProtocolError):
            protocol.parse_frame(payload[:size])
        with pytest.raises(ProtocolError):
            protocol.parse_frame(payload[size + 1 :])


@ALL
def test_every_single_bit_flip_of_a_frame_is_refused(payload: bytes) -> None:
    for bit in range(8 * len(payload)):
        flipped = bytearray(payload)
        flipped[bit // 8] ^= 1 << bit % 8
        with pytest.raises(ProtocolError):
            protocol.parse_frame(bytes(flipped))


def test_bytes_after_the_announced_length_are_ignored() -> None:
    assert protocol.parse_frame(FRAMES["push"] + b"\xff" * 9) == protocol.parse_frame(FRAMES["push"])


def test_a_frame_that_announces_more_than_1400_bytes_is_refused() -> None:
    with pytest.raises(ValueError, match="exceeds 1400"):
        protocol.build_frame(CommandFrame(1, Command.PUSH, False, True, bytes(1377)))
    longest = protocol.build_frame(CommandFrame(1, Command.PUSH, False, True, bytes(1376)))
    assert len(longest) == 1400
    forged = longest[:2] + (1401).to_bytes(2, "little") + longest[4:] + b"\0"
    with pytest.raises(ProtocolError, match="length 1401"):
        protocol.parse_frame(forged)


@given(frames)
def test_any_frame_survives_building_and_parsing(frame: CommandFrame) -> None:
    assert protocol.parse_frame(protocol.build_frame(frame)) == frame


@given(parameter_lists)
def test_any_parameters_survive_building_and_parsing(parameters: list[tuple[int, bytes]]) -> None:
    assert protocol.parse_parameters(protocol.build_parameters(parameters)) == parameters
    answer = protocol.build_query_answer(0, parameters)
    assert protocol.parse_query_answer(answer) == (0, dict(parameters))
    keys = [key for key, _ in parameters]
    assert protocol.parse_query(protocol.build_query(keys)) == keys


@given(parameter_lists.filter(bool), st.data())
def test_a_shortened_or_lengthened_parameter_list_is_refused(
    parameters: list[tuple[int, bytes]], data: st.DataObject
) -> None:
    whole = protocol.build_parameters(parameters)
    size = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(ProtocolError):
        protocol.parse_parameters(whole[:size])
    with pytest.raises(ProtocolError):
        protocol.parse_parameters(whole + b"\0")


def test_a_failed_query_answer_may_be_a_single_byte() -> None:
    assert protocol.parse_query_answer(b"\x20") == (0x20, {})
    with pytest.raises(ProtocolError):
        protocol.parse_query_answer(b"\x00")


def test_text_from_the_wire_never_contains_control_characters() -> None:
    assert protocol.unpack_text(b"AB\x1b[2J\xff\0rest") == "AB?[2J?"


def test_random_bodies_raise_nothing_but_protocol_errors() -> None:
    rng = np.random.default_rng(7)
    parsers = (
        protocol.parse_frame,
        protocol.parse_parameters,
        protocol.parse_query,
        protocol.parse_query_answer,
        protocol.parse_set_answer,
        protocol.parse_search_answer,
        protocol.parse_stream_address,
        protocol.parse_return_code,
    )
    noise = rng.integers(0, 256, 60_000, dtype=np.uint8).tobytes()
    sizes = rng.integers(0, 60, 5_000)
    starts = rng.integers(0, 59_000, 5_000)
    refused = 0
    for size, start in zip(sizes.tolist(), starts.tolist(), strict=True):
        piece = noise[start : start + size]
        # Small counts make the lists' inner checks work too.
        for candidate in (piece, bytes([size % 4, 0]) + piece[2:]):
            refused += sum(is_refused(parse, candidate) for parse in parsers)
    assert refused > 50_000
