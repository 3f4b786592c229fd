"""Crashes kept to be flown again from shortly before.

Source: the idea is from Z. Huang et al., "Collision avoidance and navigation for a quadrotor swarm using
end-to-end deep reinforcement learning", 2024.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sitl.abstract.settings import CONTROL_STEP_S
from sitl.training import batch_layout_kernels as at
from sitl.training.cohort import Cohort
from sitl.training.conditions import Conditions
from sitl.training.environment_settings import ReplaySettings


@dataclass(slots=True, eq=False)
class StoredCrash:
    """A trial some time before it went wrong.

    Attributes:
        scene: number of its scene in the bank.
        step: at which it was.
        conditions: under which it was flown.
        arrays: its state, in the order of `Cohort.stored`.
        uses: how often it may still be flown again.
    """

    scene: int
    step: int
    conditions: Conditions
    arrays: tuple[NDArray[Any], ...]
    uses: int


class CrashReplay:
    """Keeps the crashes of swarms of one size."""

    def __init__(self, settings: ReplaySettings) -> None:
        """Begin with none."""
        self._settings = settings
        self.stored: list[StoredCrash] = []

    def __len__(self) -> int:
        """Return how many are kept."""
        return len(self.stored)

    def state(self) -> list[dict[str, Any]]:
        """Return what is kept as plain values and arrays, for `restore`."""
        return [
            {
                "scene": crash.scene,
                "step": crash.step,
                "conditions": dataclasses.asdict(crash.conditions),
                "arrays": [array.copy() for array in crash.arrays],
                "uses": crash.uses,
            }
            for crash in self.stored
        ]

    def restore(self, state: list[dict[str, Any]]) -> None:
        """Keep what such a state says."""
        self.stored = [
            StoredCrash(
                scene=crash["scene"],
                step=crash["step"],
                conditions=Conditions(**crash["conditions"]).copied(),
                arrays=tuple(array.copy() for array in crash["arrays"]),
                uses=crash["uses"],
            )
            for crash in state
        ]

    def keep(self, cohort: Cohort, s: int, scene: int) -> None:
        """Keep what swarm `s`, whose trial has just gone wrong, was like some time before."""
        steps = cohort.snapshots[0][s]
        latest = cohort.places[s, at.STEP] - round(self._settings.before_s / CONTROL_STEP_S)
        usable = np.flatnonzero((steps >= 0) & (steps <= latest))
        if len(usable) == 0:
            return
        slot = int(usable[np.argmax(steps[usable])])
        parameters, quadrotor, limits = cohort.swarm[2:5]
        crash = StoredCrash(
            scene=scene,
            step=int(steps[slot]),
            conditions=Conditions(parameters[s].copy(), quadrotor[s].copy(), limits[s].copy()),
            arrays=tuple(array[s, slot].copy() for array in cohort.snapshots[1:]),
            uses=self._settings.uses,
        )
        self.stored.append(crash)
        if len(self.stored) > self._settings.kept:
            self.stored.pop(0)

    def take(self, rng: Generator) -> StoredCrash | None:
        """Return a crash to fly again, or None where a trial shall begin at a start.

        Args:
            rng: decides; it always gives two numbers.
        """
        chance, which = rng.random(2)
        if chance >= self._settings.share or not self.stored:
            return None
        index = int(which * len(self.stored))
        crash = self.stored[index]
        crash.uses -= 1
        if crash.uses <= 0:
            self.stored.pop(index)
        return crash


def begin_again(cohort: Cohort, s: int, crash: StoredCrash) -> None:
    """Put swarm `s` where a stored crash was some time before."""
    for target, source in zip(cohort.stored, crash.arrays, strict=True):
        target[s] = source
    cohort.places[s, at.STEP] = crash.step
