"""Work for worker processes, importable by them in little time."""

import os
import signal
from pathlib import Path


def double(number: int) -> int:
    return 2 * number


def die_once(chore: tuple[int, str]) -> tuple[int, int]:
    """Kill the own process when the fifth chore is met for the first time."""
    number, mark = chore
    if number == 5 and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number, os.getpid()


def die(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number
