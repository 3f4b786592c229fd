"""Abstract swarms whose followers fly by a learned policy beside their law."""

import itertools
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from companion.control.observation import Contract, Observation
from companion.messages import Float32Array
from sitl.abstract.policy_kernels import describe_swarm, overrule_swarm
from sitl.abstract.trial import AbstractTrial

POLICY = "policy"
"""Name of the method that is no law."""


class Policy(Protocol):
    """Turns observations into velocities; equal observations give equal velocities."""

    @property
    def contract(self) -> Contract:
        """What it wants to see."""
        ...

    def velocities(self, observation: Observation) -> Float32Array:
        """Return (batch, 3) velocities in the heading frame, m/s, before limits."""
        ...


class PolicyStep:
    """One step of several trials that are flown side by side, each for itself.

    Attributes:
        observation: of all followers of all trials; those of ended trials stay as they were.
        fallen: how often a follower flew by its law because the policy's velocity was not finite.
    """

    def __init__(self, contract: Contract, trials: Sequence[AbstractTrial]) -> None:
        """Make room for the observations of all followers, trial by trial."""
        self._trials = tuple(trials)
        counts = [trial.followers for trial in self._trials]
        bounds = np.concatenate([[0], np.cumsum(counts)])
        self._rows = [slice(int(a), int(b)) for a, b in itertools.pairwise(bounds)]
        self.observation = Observation(contract, int(bounds[-1]))
        self.fallen = 0

    def begin(self) -> None:
        """Let everybody perceive, and write the observations."""
        seen = self.observation
        for trial, rows in zip(self._trials, self._rows, strict=True):
            if trial.is_over:
                continue
            trial.begin_step()
            describe_swarm(
                seen.contract.number, trial.views, trial.motion[3], trial.law, trial.flown, trial.wanted,
                seen.ego[rows], seen.neighbours[rows], seen.grid[rows], seen.memory[rows],
            )  # fmt: skip

    def finish(self, velocities: Float32Array) -> None:
        """Fly on with a policy's velocities (batch, 3), heading frame, m/s."""
        contract = self.observation.contract.number
        for trial, rows in zip(self._trials, self._rows, strict=True):
            if trial.is_over:
                continue
            self.fallen += overrule_swarm(
                contract, trial.views, trial.law, trial.flown, velocities[rows], trial.wanted
            )  # fmt: skip
            trial.finish_step()
