"""What a learned follower is given to see: contracts between those who train a model and those who fly it."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from companion.control.followers.layout_kernels import AZIMUTHS, ELEVATIONS
from companion.control.observation_kernels import (
    BEST,
    BEST_EGO,
    BEST_MEMORY,
    BEST_ROW,
    BEST_ROWS,
    GRID_CHANNELS,
    PAPER,
    PAPER_EGO,
    PAPER_ROW,
    PAPER_ROWS,
)
from companion.messages import Float32Array

OUTPUT = "velocity"
"""Name of a model's only output: (batch, 3) m/s in the heading frame, before limits."""


@dataclass(frozen=True, slots=True)
class Contract:
    """Which inputs a model has, and what they mean.

    Attributes:
        name: with the version of its meaning; whoever changes the meaning changes the name.
        number: for `observation_kernels.describe`.
        ego: shape of the own state.
        neighbours: shape of the others.
        grid: shape of the obstacle grid.
        memory: shape of what is remembered of obstacles; (0,) if the model has no such input.
        law: which law must run beside the model, None if any may. What the model says keeps to what that law
            allows.
    """

    name: str
    number: int
    ego: tuple[int]
    neighbours: tuple[int, int]
    grid: tuple[int, int, int]
    memory: tuple[int]
    law: str | None

    @property
    def keeping(self) -> int:
        """For `overrule`: 1 if the law's limits hold for what the model says, 0 if not."""
        return 0 if self.law is None else 1

    @property
    def inputs(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the model's inputs, in order, without the batch."""
        shapes: dict[str, tuple[int, ...]] = {
            "ego": self.ego,
            "neighbours": self.neighbours,
            "grid": self.grid,
        }
        if self.memory[0]:
            shapes["memory"] = self.memory
        return shapes


_GRID = (GRID_CHANNELS, AZIMUTHS, ELEVATIONS)

CONTRACTS: Mapping[str, Contract] = MappingProxyType(
    {
        contract.name: contract
        for contract in (
            Contract("paper-1", PAPER, (PAPER_EGO,), (PAPER_ROWS, PAPER_ROW), _GRID, (0,), None),
            Contract("best-2", BEST, (BEST_EGO,), (BEST_ROWS, BEST_ROW), _GRID, (BEST_MEMORY,), "flock"),
        )
    }
)
"""Every contract there is, by name."""


class Observation:
    """Room for the observations of several followers, (batch, ...) float32, made once and overwritten.

    Attributes:
        contract: what the arrays mean.
        ego: own state.
        neighbours: the others.
        grid: obstacles in sight.
        memory: obstacles remembered; of size 0 where the contract has none.
    """

    __slots__ = ("contract", "ego", "grid", "memory", "neighbours")

    def __init__(self, contract: Contract, batch: int = 1) -> None:
        """Take the memory for `batch` followers."""
        self.contract = contract
        self.ego: Float32Array = np.zeros((batch, *contract.ego), np.float32)
        self.neighbours: Float32Array = np.zeros((batch, *contract.neighbours), np.float32)
        self.grid: Float32Array = np.zeros((batch, *contract.grid), np.float32)
        self.memory: Float32Array = np.zeros((batch, *contract.memory), np.float32)

    @property
    def inputs(self) -> dict[str, Float32Array]:
        """The same arrays under the names of the model's inputs."""
        arrays = {"ego": self.ego, "neighbours": self.neighbours, "grid": self.grid}
        if self.contract.memory[0]:
            arrays["memory"] = self.memory
        return arrays
