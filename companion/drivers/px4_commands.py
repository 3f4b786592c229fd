"""Commands to the autopilot: sent, repeated a bounded number of times, and their outcome.

One command of a kind is under way at a time, because an acknowledgement names only the command's number.
"""

import math
from dataclasses import dataclass, replace
from enum import Enum

from companion.clock import seconds_to_ns
from companion.drivers.mavlink_fields import integer
from companion.messages import MavlinkMessage

SET_MESSAGE_INTERVAL = 511
DO_SET_MODE = 176
NAV_LAND = 21
USER_1 = 31010

ACCEPTED = 0
TEMPORARILY_REJECTED = 1
DENIED = 2
UNSUPPORTED = 3
FAILED = 4
IN_PROGRESS = 5
CANCELLED = 6

RETRY_NS = seconds_to_ns(0.5)
MAX_TRIES = 4
_IN_PROGRESS_NS = seconds_to_ns(5.0)
_MAX_WAITING = 32

Parameters = tuple[float, float, float, float, float, float, float]


class CommandState(Enum):
    """Where a command stands."""

    PENDING = "pending"
    ACCEPTED = "accepted"
    DENIED = "denied"
    TIMED_OUT = "timed_out"
    WITHDRAWN = "withdrawn"
    """Given up on purpose before it was answered."""


@dataclass(frozen=True, slots=True)
class Command:
    """One command and its outcome.

    Attributes:
        number: MAV_CMD.
        parameters: its seven parameters; NaN leaves one to the autopilot.
        state: where it stands.
        result: MAV_RESULT of the acknowledgement, or None.
        tries: how often it was sent.
    """

    number: int
    parameters: Parameters
    state: CommandState = CommandState.PENDING
    result: int | None = None
    tries: int = 0
    due_ns: int = 0


def parameters(*values: float, rest: float = math.nan) -> Parameters:
    """Return seven command parameters, those not given filled with `rest`."""
    p1, p2, p3, p4, p5, p6, p7 = (*values, *([rest] * (7 - len(values))))
    return p1, p2, p3, p4, p5, p6, p7


class Commands:
    """Every command under way, by number; further ones of the same number wait."""

    def __init__(self) -> None:
        """Begin with none."""
        self._current: dict[int, Command] = {}
        self._waiting: list[Command] = []
        self.denied = 0
        """Commands that the autopilot refused."""
        self.timed_out = 0
        """Commands that were never acknowledged."""

    def find(self, number: int) -> Command | None:
        """Return the latest command of a number that has begun."""
        return self._current.get(number)

    def begin(self, number: int, values: Parameters) -> None:
        """Queue a command; it goes out with the next `poll`."""
        if len(self._waiting) < _MAX_WAITING:
            self._waiting.append(Command(number, values))

    def replace_current(self, number: int, values: Parameters) -> None:
        """Give up whatever of this number is under way and begin this one with the next `poll`."""
        self._current.pop(number, None)
        self._waiting = [command for command in self._waiting if command.number != number]
        self.begin(number, values)

    def conclude(self, number: int, state: CommandState) -> None:
        """End a pending command of this number without an acknowledgement."""
        pending = [command for command in self._waiting if command.number == number]
        self._waiting = [command for command in self._waiting if command.number != number]
        command = self._current.get(number)
        if command is not None and command.state is CommandState.PENDING:
            self._current[number] = replace(command, state=state)
        elif pending:
            self._current[number] = replace(pending[-1], state=state)

    def clear(self) -> None:
        """End everything, because the autopilot has gone or started anew."""
        for number in {*self._current, *(command.number for command in self._waiting)}:
            self.conclude(number, CommandState.WITHDRAWN)

    def poll(self, t_ns: int) -> list[dict[str, object]]:
        """Return the fields, save the target, of every COMMAND_LONG to send now."""
        for command in list(self._waiting):
            current = self._current.get(command.number)
            if current is None or current.state is not CommandState.PENDING:
                self._current[command.number] = replace(command, due_ns=t_ns)
                self._waiting.remove(command)
        due: list[dict[str, object]] = []
        for number, command in self._current.items():
            if command.state is not CommandState.PENDING or t_ns < command.due_ns:
                continue
            if command.tries >= MAX_TRIES or command.result == IN_PROGRESS:
                self.timed_out += 1
                self._current[number] = replace(command, state=CommandState.TIMED_OUT)
                continue
            due.append(_fields(command))
            self._current[number] = replace(command, tries=command.tries + 1, due_ns=t_ns + RETRY_NS)
        return due

    def receive(self, message: MavlinkMessage, t_ns: int) -> Command | None:
        """Take a COMMAND_ACK.

        Returns:
            The command that it ended, or None.

        Raises:
            ProtocolError: if its fields are out of range.
        """
        number = integer(message, "command", 0, 0xFFFF)
        result = integer(message, "result", 0, 0xFF)
        command = self._current.get(number)
        if command is None or command.state is not CommandState.PENDING or command.tries == 0:
            return None
        if result == IN_PROGRESS:
            self._current[number] = replace(command, result=result, due_ns=t_ns + _IN_PROGRESS_NS)
            return None
        state = CommandState.ACCEPTED if result == ACCEPTED else CommandState.DENIED
        self.denied += state is CommandState.DENIED
        ended = replace(command, state=state, result=result)
        self._current[number] = ended
        return ended


def _fields(command: Command) -> dict[str, object]:
    fields: dict[str, object] = {"command": command.number, "confirmation": command.tries}
    for index, value in enumerate(command.parameters, start=1):
        fields[f"param{index}"] = value
    return fields
