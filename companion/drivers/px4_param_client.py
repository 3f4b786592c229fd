"""Reading and writing the autopilot's parameters, one bounded conversation at a time.

PX4 sends an integer's four bytes in the place of the float. A value is written only when asked to, and
counts as written only when it has been read back equal.
"""

import math
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum

from companion.clock import seconds_to_ns
from companion.drivers.mavlink_fields import integer, text
from companion.errors import ProtocolError
from companion.messages import MavlinkMessage

TYPE_INT32 = 6
TYPE_REAL32 = 9
MAX_NAME = 16
_RETRY_NS = seconds_to_ns(0.5)
_MAX_TRIES = 4
_WINDOW = 4
_AUTOPILOT_COMPONENT = 1

ParameterValue = int | float


class ParameterState(Enum):
    """Where one parameter stands."""

    READING = "reading"
    WRITING = "writing"
    READING_BACK = "reading_back"
    READ = "read"
    WRITTEN = "written"
    MISSING = "missing"
    """The autopilot does not answer for it: this firmware has no such parameter, or the link is bad."""
    NOT_APPLIED = "not_applied"
    """Read back, it differs from what was written."""


_OPEN = (ParameterState.READING, ParameterState.WRITING, ParameterState.READING_BACK)


@dataclass(frozen=True, slots=True)
class ParameterEntry:
    """One parameter of the conversation.

    Attributes:
        name: PX4's name.
        state: where it stands.
        value: as last read; None if it never was.
        wanted: the value to write, or None.
    """

    name: str
    state: ParameterState
    value: ParameterValue | None = None
    wanted: ParameterValue | None = None
    tries: int = 0
    due_ns: int = 0


def float_of(value: ParameterValue) -> float:
    """Return the float that carries a value; an integer's bytes are kept.

    Raises:
        ValueError: if it does not fit 32 bits, or is an integer whose bytes are no finite float.
    """
    if isinstance(value, int):
        try:
            carrier = float(struct.unpack("<f", struct.pack("<i", value))[0])
        except struct.error:
            raise ValueError(f"{value} does not fit 32 bits") from None
    else:
        carrier = value
    if not math.isfinite(carrier):
        raise ValueError(f"{value} cannot be carried by a finite float")
    return carrier


def value_of(carrier: float, kind: int) -> ParameterValue:
    """Return the value of a PARAM_VALUE of a MAV_PARAM_TYPE.

    Raises:
        ProtocolError: if the type is not one that PX4 uses, or the value is not readable.
    """
    if not math.isfinite(carrier):
        raise ProtocolError("a parameter's value is not a finite float")
    if kind == TYPE_REAL32:
        return carrier
    if kind == TYPE_INT32:
        try:
            return int(struct.unpack("<i", struct.pack("<f", carrier))[0])
        except OverflowError:
            raise ProtocolError("a parameter's value is no float32") from None
    raise ProtocolError(f"a parameter of type {kind} is not PX4's")


class ParameterClient:
    """Reads and writes parameters; a few are asked for at a time, each at most four times."""

    def __init__(self, system_id: int) -> None:
        """Address the autopilot of this system id."""
        self._system_id = system_id
        self._entries: dict[str, ParameterEntry] = {}

    def read(self, names: Iterable[str]) -> None:
        """Begin to read parameters; requests go out with `poll`."""
        for name in names:
            self._entries[_checked(name)] = ParameterEntry(name, ParameterState.READING)

    def write(self, values: Mapping[str, ParameterValue]) -> None:
        """Begin to write parameters and to read them back.

        An integer parameter must be given as `int`, a real one as `float`: PX4 takes no other type.

        Raises:
            ValueError: if a name is too long or a value cannot be carried.
        """
        for name, value in values.items():
            float_of(value)
            self._entries[_checked(name)] = ParameterEntry(name, ParameterState.WRITING, wanted=value)

    def clear(self) -> None:
        """Forget everything."""
        self._entries.clear()

    @property
    def done(self) -> bool:
        """Nothing is under way."""
        return not any(entry.state in _OPEN for entry in self._entries.values())

    @property
    def entries(self) -> dict[str, ParameterEntry]:
        """Every parameter of the conversation, by name."""
        return dict(self._entries)

    def values(self) -> dict[str, ParameterValue]:
        """Return the values that are known, by name."""
        return {name: entry.value for name, entry in self._entries.items() if entry.value is not None}

    def poll(self, t_ns: int) -> list[tuple[str, dict[str, object]]]:
        """Return (message name, fields) of the requests to send at `t_ns`."""
        messages: list[tuple[str, dict[str, object]]] = []
        in_window = [entry for entry in self._entries.values() if entry.state in _OPEN][:_WINDOW]
        for entry in in_window:
            if t_ns < entry.due_ns:
                continue
            if entry.tries >= _MAX_TRIES:
                self._entries[entry.name] = replace(entry, state=ParameterState.MISSING)
                continue
            messages.append(self._request(entry))
            self._entries[entry.name] = replace(entry, tries=entry.tries + 1, due_ns=t_ns + _RETRY_NS)
        return messages

    def receive(self, message: MavlinkMessage, t_ns: int) -> None:
        """Take a PARAM_VALUE received at `t_ns`.

        Raises:
            ProtocolError: if it is unusable.
        """
        entry = self._entries.get(text(message, "param_id", MAX_NAME))
        if entry is None:
            return
        carrier = message.fields.get("param_value")
        if not isinstance(carrier, (int, float)):
            raise ProtocolError("a parameter's value is not a number")
        value = value_of(float(carrier), integer(message, "param_type", 0, 0xFF))
        if entry.state is ParameterState.WRITING:
            # The echo of a write is not proof: the autopilot may have clipped or refused it.
            self._entries[entry.name] = replace(
                entry, state=ParameterState.READING_BACK, value=value, tries=0, due_ns=t_ns
            )
        elif entry.state is ParameterState.READING_BACK:
            applied = entry.wanted is not None and same(value, entry.wanted)
            state = ParameterState.WRITTEN if applied else ParameterState.NOT_APPLIED
            self._entries[entry.name] = replace(entry, state=state, value=value)
        else:
            self._entries[entry.name] = replace(entry, state=ParameterState.READ, value=value)

    def _request(self, entry: ParameterEntry) -> tuple[str, dict[str, object]]:
        fields: dict[str, object] = {
            "target_system": self._system_id,
            "target_component": _AUTOPILOT_COMPONENT,
            "param_id": entry.name,
        }
        if entry.state is ParameterState.WRITING and entry.wanted is not None:
            kind = TYPE_INT32 if isinstance(entry.wanted, int) else TYPE_REAL32
            return "PARAM_SET", {**fields, "param_value": float_of(entry.wanted), "param_type": kind}
        return "PARAM_REQUEST_READ", {**fields, "param_index": -1}


def same(found: ParameterValue, wanted: ParameterValue) -> bool:
    """Tell whether two values are equal in float32."""
    return math.isclose(found, wanted, rel_tol=1e-6, abs_tol=1e-9)


def _checked(name: str) -> str:
    if not 0 < len(name) <= MAX_NAME:
        raise ValueError(f"{name!r} is no parameter name of at most {MAX_NAME} characters")
    return name
