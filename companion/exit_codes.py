"""How the command line tells scripts and systemd what went wrong (the numbers of sysexits.h)."""

from enum import IntEnum


class ExitCode(IntEnum):
    """Exit status of every command."""

    OK = 0
    NO_GO = 3
    """A preflight check failed, or the running companion refused a request."""

    DIFFERENT = 4
    """A replay did not give what was recorded, though configuration and version are the same."""

    USAGE = 64
    """The command line is wrong."""

    DATA = 65
    """A log or another input cannot be understood."""

    NO_INPUT = 66
    """A file named on the command line does not exist."""

    UNAVAILABLE = 69
    """A peer (LiDAR, autopilot, running companion) does not answer."""

    INTERNAL = 70
    """The program is wrong; a traceback says where."""

    CANNOT_CREATE = 73
    """An output cannot be created."""

    IO = 74
    """Reading or writing failed."""

    TEMPORARY = 75
    """Something else is in the way for now, such as a second instance."""

    CONFIG = 78
    """The profile, or the model that it names, is wrong; starting again would not help."""

    INTERRUPTED = 130
    """Stopped from the keyboard."""
