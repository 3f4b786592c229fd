"""Asking the autopilot for a flight mode, without ever fighting whoever else changes it."""

from dataclasses import dataclass

from companion.drivers.px4_commands import DO_SET_MODE, NAV_LAND, Commands, CommandState, parameters
from companion.drivers.px4_modes import BASE_MODE_ARMED, BASE_MODE_CUSTOM, main_and_sub
from companion.messages import VehicleMode


@dataclass(frozen=True, slots=True)
class ModeRequestStatus:
    """The latest mode that was asked for, and what became of it.

    Attributes:
        mode: the mode, or None if none was ever asked for.
        state: where the request stands, or None.
        result: MAV_RESULT of the answer, or None.
    """

    mode: VehicleMode | None = None
    state: CommandState | None = None
    result: int | None = None


class ModeRequests:
    """At most one request at a time; the latest replaces the one before."""

    def __init__(self, commands: Commands) -> None:
        """Send by way of `commands`."""
        self._commands = commands
        self._asked: VehicleMode | None = None
        self._number = DO_SET_MODE
        self._changes_before = 0

    def begin(self, mode: VehicleMode, *, armed: bool, mode_changes: int) -> None:
        """Ask for a mode, now that so many mode changes have been seen.

        Raises:
            ValueError: for an unknown mode.
        """
        main, sub = main_and_sub(mode)
        self.withdraw()
        if mode is VehicleMode.LAND:
            self._number = NAV_LAND
            values = parameters(0.0, 0.0, 0.0)
        else:
            self._number = DO_SET_MODE
            base_mode = BASE_MODE_CUSTOM | (BASE_MODE_ARMED if armed else 0)
            values = parameters(float(base_mode), float(main), float(sub), rest=0.0)
        self._asked = mode
        self._changes_before = mode_changes
        self._commands.replace_current(self._number, values)

    def observe(self, mode: VehicleMode, mode_changes: int) -> None:
        """End a pending request when the mode has changed since.

        If it is the one asked for, only the acknowledgement was lost. If not, somebody else has chosen,
        and a repetition would take the vehicle away from them.
        """
        if self._asked is None or mode_changes == self._changes_before:
            return
        reached = mode is self._asked
        self._commands.conclude(self._number, CommandState.ACCEPTED if reached else CommandState.WITHDRAWN)

    def withdraw(self) -> None:
        """Do not repeat a request that has not been answered yet."""
        self._commands.conclude(self._number, CommandState.WITHDRAWN)

    @property
    def status(self) -> ModeRequestStatus:
        """The latest request and its outcome."""
        if self._asked is None:
            return ModeRequestStatus()
        command = self._commands.find(self._number)
        if command is None:
            return ModeRequestStatus(self._asked, CommandState.PENDING)
        return ModeRequestStatus(self._asked, command.state, command.result)
