"""Work for worker processes, importable by them."""

import os
import signal
from pathlib import Path

from sitl.campaign.tasks import SceneTask
from sitl.campaign.trials import fly_scenes
from sitl.swarm.record import TrialRecord


def double(number: int) -> int:
    return 2 * number


def die_once(chore: tuple[int, str]) -> tuple[int, int]:
    """Kill the own process when the fifth chore is met for the first time."""
    number, mark = chore
    if number == 5 and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number, os.getpid()


def fly_or_die(task: SceneTask, mark: str) -> list[TrialRecord]:
    """Fly a campaign's scenes, but die when the fifth is met for the first time."""
    if 5 in task.trials and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return fly_scenes(task)


def die(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number
