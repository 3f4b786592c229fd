"""Flights for worker processes, one of which is fatal."""

import os
import signal
from pathlib import Path

from sitl.campaign.tasks import SceneTask
from sitl.campaign.trials import fly_scenes
from sitl.swarm.record import TrialRecord


def fly_or_die(task: SceneTask, mark: str) -> list[TrialRecord]:
    """Fly a campaign's scenes, but die when the fifth is met for the first time."""
    if 5 in task.trials and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return fly_scenes(task)
