"""Fields to and from MAVSDK's JSON."""

import json
import math

import pytest

from companion.drivers.mavlink_json import fields_from_json, fields_to_json
from companion.errors import ProtocolError


def test_numbers_texts_and_arrays_survive() -> None:
    fields: dict[str, object] = {"tc1": -(2**62), "text": 'a"ä\n', "q": [1.0, 0.0], "x": 1.4e-45, "n": 3}
    assert fields_from_json(fields_to_json(fields)) == fields


def test_what_is_not_finite_becomes_null_and_null_becomes_nan() -> None:
    text = fields_to_json({"x": math.nan, "y": -math.inf, "c": [math.nan, 1.0], "z": 2.0})
    assert json.loads(text) == {"x": None, "y": None, "c": [None, 1.0], "z": 2.0}
    fields = fields_from_json(text)
    assert isinstance(fields["x"], float)
    assert math.isnan(fields["x"])
    assert isinstance(fields["c"], list)
    assert math.isnan(fields["c"][0])
    assert fields["c"][1] == 1.0


def test_what_mavsdk_adds_is_no_field() -> None:
    assert fields_from_json('{"message_id":0,"message_name":"HEARTBEAT","type":2}') == {"type": 2}


@pytest.mark.parametrize("text", ["", "[]", "1", "{", "\x00", '{"a":' * 3000, " " * 20_000])
def test_what_is_no_message_is_refused(text: str) -> None:
    with pytest.raises(ProtocolError):
        fields_from_json(text)
