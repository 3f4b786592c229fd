"""What an environment of swarms gives back: observations, rewards and how trials went."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.control.observation import CONTRACTS
from companion.messages import Float32Array
from sitl.training.privileged_kernels import PRIVILEGED_SIZE
from sitl.training.reward_settings import TERMS

Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """What every follower is shown; one row a stream, float32, overwritten by the next step.

    Attributes:
        ego: (K, E) own state, as the contract says; so are the next three.
        neighbours: (K, rows, columns) the others.
        grid: (K, 2, 72, 12) obstacles in sight.
        memory: (K, 72) obstacles remembered; (K, 0) where the contract has none.
        privileged: (K, P) the truth, for critics only; see `privileged_kernels`.
        reference: (K, 3) what the law `flock` would fly now, heading frame, m/s: a teacher's answer.
    """

    ego: Float32Array
    neighbours: Float32Array
    grid: Float32Array
    memory: Float32Array
    privileged: Float32Array
    reference: Float32Array

    @classmethod
    def room(cls, contract: str, streams: int) -> "Observation":
        """Take the memory for so many streams.

        Raises:
            KeyError: if there is no such contract.
        """
        shapes = CONTRACTS[contract]
        return cls(
            ego=np.zeros((streams, *shapes.ego), np.float32),
            neighbours=np.zeros((streams, *shapes.neighbours), np.float32),
            grid=np.zeros((streams, *shapes.grid), np.float32),
            memory=np.zeros((streams, *shapes.memory), np.float32),
            privileged=np.zeros((streams, PRIVILEGED_SIZE), np.float32),
            reference=np.zeros((streams, 3), np.float32),
        )


@dataclass(frozen=True, slots=True, eq=False)
class EpisodeSummary:
    """How one swarm's trial went.

    Attributes:
        swarm: number of the swarm.
        followers: how many.
        world: where.
        behaviour: how the leader flew.
        perception: name of the known perception from which its conditions were drawn.
        replayed: it began shortly before a stored crash.
        end: how it ended, see `sitl.swarm.record.End`; `timeout` also where it was cut off.
        ended_by: numbers of the vehicles concerned, 0 is the leader.
        steps: control steps flown.
        total: mean over the followers of the sum of their rewards.
        terms: (R,) mean over followers and steps of every term without its weight, see `TERMS`.
        flock_radius_m: FR of the flight.
        minimum_separation_m: MS of it.
        alignment: AL of it; NaN if nobody moved.
    """

    swarm: int
    followers: int
    world: str
    behaviour: str
    perception: str
    replayed: bool
    end: str
    ended_by: tuple[int, ...]
    steps: int
    total: float
    terms: NDArray[np.float64]
    flock_radius_m: float
    minimum_separation_m: float
    alignment: float


@dataclass(frozen=True, slots=True, eq=False)
class StepResult:
    """What came of one step; the arrays are overwritten by the next.

    Attributes:
        observation: of the new state; where a trial has ended, the first of the next trial.
        terms: (K, R) every term of the reward without its weight, see `TERMS`.
        reward: (K,) their weighted sum.
        terminated: (K,) the stream's life is over: it took part in a collision, or it is lost.
        truncated: (K,) its trial has ended without its doing; what would have followed has a value.
        finished: the trials that have ended.
    """

    observation: Observation
    terms: Float32Array
    reward: Float32Array
    terminated: Flags
    truncated: Flags
    finished: list[EpisodeSummary]

    @classmethod
    def room(cls, observation: Observation, streams: int) -> "StepResult":
        """Take the memory for so many streams."""
        return cls(
            observation=observation,
            terms=np.zeros((streams, len(TERMS)), np.float32),
            reward=np.zeros(streams, np.float32),
            terminated=np.zeros(streams, np.bool_),
            truncated=np.zeros(streams, np.bool_),
            finished=[],
        )


State = dict[str, Any]
"""Everything an environment needs to go on exactly as it would have: arrays and plain values by name."""
