"""Message fields to and from the JSON that MAVSDK's MavlinkDirect speaks.

JSON knows no NaN: MAVSDK writes and reads `null` in its place, for infinities too.
"""

import json
import math

from companion.errors import ProtocolError

# The largest message holds 249 numbers of at most 20 characters.
_MAX_CHARACTERS = 16_384
_NOT_FIELDS = ("message_id", "message_name")


def fields_to_json(fields: dict[str, object]) -> str:
    """Return the fields as JSON text; numbers that are not finite become null."""
    try:
        return json.dumps(fields, allow_nan=False)
    except ValueError:
        return json.dumps({name: _without_nan(value) for name, value in fields.items()}, allow_nan=False)


def fields_from_json(text: str) -> dict[str, object]:
    """Return the fields of a received message; null becomes NaN.

    Raises:
        ProtocolError: if the text is not the JSON object of a message.
    """
    if len(text) > _MAX_CHARACTERS:
        raise ProtocolError(f"a message of {len(text)} characters is too long")
    try:
        decoded = json.loads(text)
    except (ValueError, RecursionError):
        raise ProtocolError("a message is not JSON") from None
    if not isinstance(decoded, dict):
        raise ProtocolError("a message is not a JSON object")
    return {name: _with_nan(value) for name, value in decoded.items() if name not in _NOT_FIELDS}


def _without_nan(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, (list, tuple)):
        return [_without_nan(item) for item in value]
    return value


def _with_nan(value: object) -> object:
    if value is None:
        return math.nan
    if isinstance(value, list):
        return [math.nan if item is None else item for item in value]
    return value
