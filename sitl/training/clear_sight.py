"""A teacher that sees better than its pupils: flock without noise, delay or misses, in the same swarms.

What a follower's sensors tell is late and noisy, and flock takes it as it is. A network that is told what
flock would have flown had it known the truth learns what the late and noisy usually means.

Source: the idea is from Chen et al., Learning by cheating, 2019.
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.messages import Float32Array, FloatArray
from sitl.abstract import layout_kernels as place
from sitl.training.clear_sight_kernels import look_again
from sitl.training.cohort import Cohort
from sitl.training.environment import SwarmBatch
from sitl.training.environment_results import Observation, StepResult

Arrays = tuple[NDArray[Any], ...]

_NOTHING = (
    place.GRID_DELAY, place.NEIGHBOUR_DELAY, place.EGO_DELAY, place.DROPOUT, place.DROPOUT_FAR,
    place.POSITION_SIGMA, place.POSITION_SIGMA_FAR, place.VELOCITY_SIGMA, place.VELOCITY_SIGMA_FAR,
    place.EGO_VELOCITY_SIGMA,
)  # fmt: skip
"""What there is none of where everything is seen as it is..."""
_ONE = (place.SCAN_STEPS, place.SIGHTINGS)
"""... and what there is no more of than one."""


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """The second look at a cohort.

    Attributes:
        cohort: at whom.
        parameters: (S, 47) those of its swarms, for one who sees everything as it is.
        candidates: (S, n, m) obstacles near each vehicle.
        counts: (S, n) how many.
        views: what is seen, and flock's memory.
        wanted: (S, n, 3) flock's commands.
        seeds: (S,) of the trials that are looked at.
    """

    cohort: Cohort
    parameters: FloatArray
    candidates: NDArray[np.int32]
    counts: NDArray[np.int64]
    views: Arrays
    wanted: FloatArray
    seeds: NDArray[np.uint64]

    @classmethod
    def at(cls, cohort: Cohort) -> "_Look":
        """Take the memory."""
        seeds, _, parameters, _, _, _, candidates, counts = cohort.swarm
        return cls(
            cohort=cohort,
            parameters=np.zeros_like(parameters),
            candidates=np.zeros_like(candidates),
            counts=np.zeros_like(counts),
            views=tuple(np.zeros_like(array) for array in cohort.views),
            wanted=np.zeros_like(cohort.acts[1]),
            seeds=np.zeros_like(seeds),
        )

    @property
    def swarm(self) -> Arrays:
        """Return what holds for each swarm, as the kernel reads it."""
        seeds, places, _, quadrotor, limits, goals, _, _ = self.cohort.swarm
        return seeds, places, self.parameters, quadrotor, limits, goals, self.candidates, self.counts

    def begin(self, all_of_them: bool) -> None:
        """Forget the trials that are over, and take the rules of those that have begun."""
        seeds, _, parameters, _, _, _, _, _ = self.cohort.swarm
        begun = np.ones(len(seeds), np.bool_) if all_of_them else seeds != self.seeds
        self.seeds[begun] = seeds[begun]
        self.parameters[begun] = parameters[begun]
        for index in _NOTHING:
            self.parameters[begun, index] = 0.0
        for index in _ONE:
            self.parameters[begun, index] = 1.0
        for array in self.views:
            array[begun] = 0
        self.views[3][begun] = np.inf


class ClearSight:
    """A batch of swarms whose reference is what flock would fly if it saw everything as it is.

    What can be seen at all stays as it is: range, field of view, and who hides whom. Everything else that is
    shown is the batch's own, flock's command by the follower's own sight included.
    """

    def __init__(self, batch: SwarmBatch, *, cohesion: float = 1.0, trust: float = 1.0) -> None:
        """Look at a batch of swarms.

        Args:
            batch: the swarms.
            cohesion: the teacher's, as a multiple of the pupils' flock.
            trust: share of the difference between teacher's and pupil's wishes that is taught.
        """
        self._batch = batch
        follower = batch.settings.follower
        flock = follower.flock.model_copy(update={"cohesion_per_s": cohesion * follower.flock.cohesion_per_s})
        self._law = follower.model_copy(update={"flock": flock}).packed("flock")
        self._trust = trust
        self._looks = [_Look.at(cohort) for cohort in batch.cohorts]
        self._reference: Float32Array = np.zeros((batch.streams, 3), np.float32)

    @property
    def streams(self) -> int:
        """How many followers there are."""
        return self._batch.streams

    def reset(self) -> Observation:
        """Begin every trial anew."""
        return self.look(self._batch.reset(), is_first=True)

    def step(self, velocity: Float32Array) -> StepResult:
        """Fly on; see `SwarmBatch.step`."""
        stepped = self._batch.step(velocity)
        return dataclasses.replace(stepped, observation=self.look(stepped.observation))

    def look(self, observation: Observation, *, is_first: bool = False) -> Observation:
        """Return the batch's newest observation with what its followers ought to want for a reference.

        Args:
            observation: the newest.
            is_first: all trials have begun anew, even those with the seed of the one before.
        """
        for look in self._looks:
            look.begin(is_first)
        self._batch.in_pieces(self._look, [0] * len(self._looks))
        return dataclasses.replace(observation, reference=self._reference)

    def _look(self, index: int, first: int, last: int) -> None:
        look, batch = self._looks[index], self._batch
        look_again(
            first, last, batch.sites, batch.rays, self._law, look.swarm, look.cohort.motion, look.views,
            self._trust, look.cohort.acts[0], look.wanted, batch.observation.reference, self._reference,
        )  # fmt: skip
