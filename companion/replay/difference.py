"""Where two messages of one kind differ first."""

import dataclasses
import json
from collections.abc import Mapping
from enum import Enum

import numpy as np

_SHOWN_CHARACTERS = 60


@dataclasses.dataclass(frozen=True, slots=True)
class Difference:
    """One value that came out differently.

    Attributes:
        t_ns: host time at which the message was handled in the recorded flight.
        field: which value, such as ``v_map[0]``; empty if the whole message is missing or extra.
        recorded, replayed: both values as text, empty where there is none.
    """

    t_ns: int
    field: str
    recorded: str
    replayed: str


def first_difference(t_ns: int, recorded: object, replayed: object) -> Difference:
    """Return the first value in which two messages differ, in the order of their fields."""
    found = _compare("", _plain(recorded), _plain(replayed))
    field, before, after = found or ("", recorded, replayed)
    return Difference(t_ns, field, _shown(before), _shown(after))


def only_one(t_ns: int, *, recorded: object = None, replayed: object = None) -> Difference:
    """Return the difference between a message and none."""
    return Difference(
        t_ns,
        "",
        "" if recorded is None else _shown(_plain(recorded)),
        "" if replayed is None else _shown(_plain(replayed)),
    )


def _compare(path: str, before: object, after: object) -> tuple[str, object, object] | None:
    if isinstance(before, dict) and isinstance(after, dict):
        for key in [*before, *(key for key in after if key not in before)]:
            inner = f"{path}.{key}" if path else str(key)
            found = _compare(inner, before.get(key), after.get(key))
            if found is not None:
                return found
        return None
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for index, (one, other) in enumerate(zip(before, after, strict=True)):
            found = _compare(f"{path}[{index}]", one, other)
            if found is not None:
                return found
        return None
    return None if _text(before) == _text(after) and type(before) is type(after) else (path, before, after)


def _plain(value: object) -> object:
    """Return a message as dictionaries, lists and scalars."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Enum):
        return value.value if isinstance(value.value, str) else value.name.lower()
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _text(value: object) -> str:
    # Tells 0.0 from -0.0, and finds NaN equal to NaN.
    return repr(value)


def _shown(value: object) -> str:
    if isinstance(value, list) and len(value) > 8:
        return f"{len(value)} values"
    text = value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)
    text = " ".join(text.split())
    return text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 3] + "..."
