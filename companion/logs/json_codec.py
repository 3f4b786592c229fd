"""Frozen dataclasses to JSON and back, exactly: the schema follows from the type annotations.

Numbers survive bit for bit. JSON knows no NaN and no infinity: NaN is written as ``null`` and infinity
as ``1e999``, which every reader turns back into infinity.
"""

import dataclasses
import json
import math
import re
import types
import typing
from collections.abc import Callable, Mapping
from enum import Enum, IntEnum
from typing import Any

import numpy as np

_SHAPES: dict[str, tuple[int, ...]] = {
    "q_map_body": (4,),
    "covariance_pose": (6, 6),
    "covariance_velocity": (3, 3),
    "path_map": (-1, 3),
    "covariance": (6, 6),
}
_VECTOR = (3,)
_INTEGER_LIMIT = 2**63
_NOT_JSON = re.compile(r'"(?:[^"\\]|\\.)*"|-?Infinity|NaN')
_VALID = {"NaN": "null", "Infinity": "1e999", "-Infinity": "-1e999"}

_Convert = Callable[[Any], Any]


def _dumps(value: object) -> str:
    text = _ENCODER.encode(value)
    if "NaN" in text or "Infinity" in text:
        text = _NOT_JSON.sub(lambda match: _VALID.get(match[0], match[0]), text)
    return text


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a {type(value).__name__} has no place in a log message")


_ENCODER = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, default=_plain)


def _checked(kind: type) -> _Convert:
    def convert(value: object) -> object:
        if type(value) is not kind:
            raise ValueError(f"expected {kind.__name__}, found {type(value).__name__}")
        if type(value) is int and not -_INTEGER_LIMIT <= value < _INTEGER_LIMIT:
            raise ValueError("an integer beyond 64 bits")
        return value

    return convert


def _float_from(value: object) -> float:
    if value is None:
        return math.nan
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise ValueError(f"expected a number, found {type(value).__name__}")
    return float(value)


def _nan_restored(value: Any) -> Any:
    if value is None:
        return math.nan
    if isinstance(value, list):
        return [_nan_restored(item) for item in value]
    if isinstance(value, dict):
        return {key: _nan_restored(item) for key, item in value.items()}
    return value


def _mapping_from(value: object) -> object:
    if not isinstance(value, dict):
        raise ValueError(f"expected an object, found {type(value).__name__}")
    return _nan_restored(value)


def _array_from(shape: tuple[int, ...]) -> _Convert:
    def convert(value: object) -> object:
        return np.array(value, dtype=np.float64).reshape(shape)

    return convert


def _array_schema(dimensions: int) -> dict[str, object]:
    items: dict[str, object] = {"type": "array", "items": {"type": ["number", "null"]}}
    return items if dimensions == 1 else {"type": "array", "items": items}


def _unchanged(value: Any) -> Any:
    return value


def _converters(name: str, kind: Any) -> tuple[_Convert, _Convert, dict[str, object]]:
    """Return (to JSON, from JSON, JSON schema) of one field."""
    origin = typing.get_origin(kind)
    if origin is np.ndarray:
        shape = _SHAPES.get(name, _VECTOR)
        return (lambda value: value.tolist()), _array_from(shape), _array_schema(len(shape))
    if origin in (dict, Mapping):
        return dict, _mapping_from, {"type": "object"}
    if origin is tuple:
        return _converters_of_rows(typing.get_args(kind)[0])
    if isinstance(kind, types.UnionType) or not isinstance(kind, type):
        raise TypeError(f"field {name}: {kind} cannot be logged")
    if issubclass(kind, IntEnum):
        names = {member.name.lower(): member for member in kind}
        return (lambda value: value.name.lower()), names.__getitem__, {"type": "string", "enum": [*names]}
    if issubclass(kind, Enum):
        values = [member.value for member in kind]
        return (lambda value: value.value), kind, {"type": "string", "enum": values}
    if kind is float:
        return float, _float_from, {"type": ["number", "null"]}
    json_name = {bool: "boolean", int: "integer", str: "string"}[kind]
    return (int if kind is int else _unchanged), _checked(kind), {"type": json_name}


def _converters_of_rows(kind: type) -> tuple[_Convert, _Convert, dict[str, object]]:
    """Return (to JSON, from JSON, JSON schema) of a tuple of one dataclass."""
    codec = JsonCodec(kind)

    def rows_from(value: object) -> object:
        if not isinstance(value, list):
            raise ValueError(f"expected a list, found {type(value).__name__}")
        return tuple(codec.from_plain(row) for row in value)

    def rows_to(value: Any) -> object:
        return [codec.to_plain(row) for row in value]

    return rows_to, rows_from, {"type": "array", "items": codec.schema_of_fields()}


class JsonCodec:
    """Turns messages of one dataclass into JSON bytes and back."""

    def __init__(self, message_type: type) -> None:
        """Prepare for `message_type`.

        Raises:
            TypeError: if it is no dataclass or one of its fields cannot be logged.
        """
        if not dataclasses.is_dataclass(message_type):
            raise TypeError(f"{message_type.__name__} is not a dataclass")
        self._type: Callable[..., object] = message_type
        hints = typing.get_type_hints(message_type)
        self._fields = [
            (field.name, *_converters(field.name, hints[field.name]))
            for field in dataclasses.fields(message_type)
        ]

    def schema(self, title: str) -> bytes:
        """Return the JSON schema of the message, as UTF-8 text."""
        document = {"title": title, **self.schema_of_fields()}
        return json.dumps(document, separators=(",", ":")).encode()

    def schema_of_fields(self) -> dict[str, object]:
        """Return the JSON schema without a title."""
        properties = {name: schema for name, _, _, schema in self._fields}
        return {"type": "object", "properties": properties, "required": [*properties]}

    def encode(self, message: object) -> bytes:
        """Return the message as UTF-8 JSON."""
        return _dumps(self.to_plain(message)).encode()

    def to_plain(self, message: object) -> dict[str, object]:
        """Return the message as values that JSON knows."""
        return {name: to(getattr(message, name)) for name, to, _, _ in self._fields}

    def decode(self, data: bytes) -> object:
        """Return the message.

        Raises:
            ValueError: if the bytes are not such a message.
        """
        try:
            return self.from_plain(json.loads(data))
        except (KeyError, TypeError, OverflowError, RecursionError) as error:
            raise ValueError(f"not such a message: {error!r}") from error

    def from_plain(self, document: Any) -> object:
        """Return the message from values of JSON; raises what such values can raise."""
        return self._type(**{name: back(document[name]) for name, _, back, _ in self._fields})
