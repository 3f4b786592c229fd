"""Checked access to the fields of a received message: what a peer wrote is never trusted."""

import math

from companion.errors import ProtocolError
from companion.messages import MavlinkMessage

# Beyond this no quantity of a small vehicle makes sense, and float32 is still far from overflowing.
LARGEST_REAL = 1e9


def integer(message: MavlinkMessage, name: str, low: int, high: int) -> int:
    """Return an integer field within [low, high].

    Raises:
        ProtocolError: if it is missing, not an integer or out of range.
    """
    value = message.fields.get(name)
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ProtocolError(f"{message.name}.{name} is {value!r}, not an integer from {low} to {high}")
    return value


def real(message: MavlinkMessage, name: str) -> float:
    """Return a finite real field.

    Raises:
        ProtocolError: if it is missing, not a number, not finite or absurdly large.
    """
    return _finite(message.fields.get(name), message, name)


def reals(message: MavlinkMessage, names: tuple[str, ...]) -> list[float]:
    """Return several finite real fields; raises ProtocolError like `real`."""
    return [_finite(message.fields.get(name), message, name) for name in names]


def first_or_nan(message: MavlinkMessage, name: str) -> float:
    """Return the first value of an array field, which may be unknown (NaN).

    Raises:
        ProtocolError: if it is missing, empty, not a number or infinite.
    """
    value = message.fields.get(name)
    if not isinstance(value, list) or not value:
        raise ProtocolError(f"{message.name}.{name} is not an array")
    return _finite_or_nan(value[0], message, name)


def real_or_nan(message: MavlinkMessage, name: str) -> float:
    """Return a real field that may be unknown (NaN).

    Raises:
        ProtocolError: if it is missing, not a number or infinite.
    """
    return _finite_or_nan(message.fields.get(name), message, name)


def text(message: MavlinkMessage, name: str, max_length: int) -> str:
    """Return a text field, its unprintable characters replaced.

    Raises:
        ProtocolError: if it is missing or longer than `max_length` characters.
    """
    value = message.fields.get(name)
    if not isinstance(value, str) or len(value) > max_length:
        raise ProtocolError(f"{message.name}.{name} is not a text of at most {max_length} characters")
    return "".join(character if character.isprintable() else "?" for character in value)


def _finite_or_nan(value: object, message: MavlinkMessage, name: str) -> float:
    if isinstance(value, float) and math.isnan(value):
        return value
    return _finite(value, message, name)


def _finite(value: object, message: MavlinkMessage, name: str) -> float:
    if isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST_REAL:
        return float(value)
    raise ProtocolError(f"{message.name}.{name} is {value!r}, not a usable number")
