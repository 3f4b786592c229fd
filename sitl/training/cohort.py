"""Swarms of one size: the memory of a batch, and how a trial of one of them begins."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from companion.control.followers.layout_kernels import (
    AZIMUTHS,
    EGO_SIZE,
    ELEVATIONS,
    FLOCK_MEMORY_SIZE,
    NEIGHBOUR_SIZE,
)
from companion.messages import FloatArray
from sitl.abstract import layout_kernels as place
from sitl.abstract.grid_kernels import N_LIMITS
from sitl.abstract.judging_kernels import FLYING, N_SUMS
from sitl.abstract.leader_kernels import LEADER_WIDTH
from sitl.abstract.perception_kernels import TRACK_WIDTH
from sitl.abstract.settings import CONTROL_STEP_S
from sitl.dynamics import GRAVITY
from sitl.dynamics_kernels import MEMORY_WIDTH, MOTION_WIDTH, N_PARAMETERS, THRUST, P, Q
from sitl.training import batch_layout_kernels as at
from sitl.training.conditions import Conditions
from sitl.training.environment_settings import EnvironmentSettings
from sitl.training.randomisation import HISTORY_ROWS
from sitl.training.reward_layout_kernels import N_TERMS
from sitl.training.scene_bank import Scene

Arrays = tuple[NDArray[Any], ...]

_STATE_WIDTH = 10


@dataclass(frozen=True, slots=True, eq=False)
class Cohort:
    """Swarms of one size; the groups of arrays are those of `batch_layout_kernels`.

    Attributes:
        vehicles: in each swarm, the leader included.
        numbers: (S,) numbers of the swarms in the whole environment.
    """

    vehicles: int
    numbers: NDArray[np.int64]
    swarm: Arrays
    motion: Arrays
    views: Arrays
    acts: Arrays
    snapshots: Arrays

    @classmethod
    def room(
        cls,
        settings: EnvironmentSettings,
        vehicles: int,
        numbers: NDArray[np.int64],
        first_streams: NDArray[np.int64],
        most_primitives: int,
    ) -> "Cohort":
        """Take the memory.

        Args:
            settings: of the environment.
            vehicles: in each swarm.
            numbers: (S,) numbers of the swarms.
            first_streams: (S,) stream of the first follower of each.
            most_primitives: of any scene.
        """
        count, n = len(numbers), vehicles
        slots = math.ceil(settings.replay.before_s / CONTROL_STEP_S / at.SNAPSHOT_STEPS) + 2
        places = np.zeros((count, at.N_PLACES), np.int64)
        places[:, at.FIRST_STREAM] = first_streams
        history = (HISTORY_ROWS, n, _STATE_WIDTH)
        commands = (HISTORY_ROWS, n, 3)
        return cls(
            vehicles=n,
            numbers=numbers,
            swarm=(
                np.zeros(count, np.uint64),
                places,
                np.zeros((count, at.N_PARAMETERS)),
                np.zeros((count, N_PARAMETERS)),
                np.zeros((count, N_LIMITS)),
                np.zeros((count, 3)),
                np.zeros((count, n, max(most_primitives, 1)), np.int32),
                np.zeros((count, n), np.int64),
            ),
            motion=(
                np.zeros((count, *history)),
                np.zeros((count, *commands)),
                np.zeros((count, n, 3)),
                np.zeros((count, n, MOTION_WIDTH)),
                np.zeros((count, n, MEMORY_WIDTH)),
                np.zeros((count, n, 5)),
                np.zeros((count, n, 3)),
                np.zeros((count, n)),
                np.zeros((count, n), np.uint8),
            ),
            views=(
                np.zeros((count, n, n, TRACK_WIDTH)),
                np.zeros((count, n, EGO_SIZE)),
                np.zeros((count, n, settings.observable_neighbours, NEIGHBOUR_SIZE)),
                np.zeros((count, n, AZIMUTHS, ELEVATIONS)),
                np.zeros((count, n, FLOCK_MEMORY_SIZE)),
                np.zeros((count, n), np.uint8),
                np.zeros((count, 3)),
            ),
            acts=(
                np.zeros((count, n, 3)),
                np.zeros((count, n, 3)),
                np.zeros((count, n, 3)),
                np.zeros((count, N_SUMS)),
                np.full((count, 2), -1, np.int64),
                np.zeros((count, LEADER_WIDTH)),
                np.zeros((count, n, N_TERMS)),
                np.zeros((count, n, N_TERMS)),
                np.zeros((count, n)),
            ),
            snapshots=(
                np.full((count, slots), -1, np.int64),
                np.zeros((count, slots, *history)),
                np.zeros((count, slots, *commands)),
                np.zeros((count, slots, n, 3)),
                np.zeros((count, slots, n, MOTION_WIDTH)),
                np.zeros((count, slots, n, MEMORY_WIDTH)),
                np.zeros((count, slots, n, n, TRACK_WIDTH)),
                np.zeros((count, slots, n, EGO_SIZE)),
                np.zeros((count, slots, n, FLOCK_MEMORY_SIZE)),
            ),
        )

    def __len__(self) -> int:
        """Return the number of swarms."""
        return len(self.numbers)

    @property
    def places(self) -> NDArray[np.int64]:
        """Whole numbers of each swarm (S, 8), see `batch_layout_kernels`."""
        return self.swarm[1]

    @property
    def stored(self) -> Arrays:
        """The arrays of which a snapshot is made, in its order."""
        return (*self.motion[:5], self.views[0], self.views[1], self.views[4])

    def set_rules(self, s: int, scene: Scene, conditions: Conditions, seed: int, last_step: int) -> None:
        """Tell swarm `s` where it flies, under which conditions, and for how long."""
        seeds, places, parameters, quadrotor, limits, goals, _, _ = self.swarm
        seeds[s] = seed
        places[s, at.FIRST_PRIMITIVE], places[s, at.END_PRIMITIVE] = scene.obstacles
        places[s, at.FIRST_FLIGHT], places[s, at.END_FLIGHT] = scene.flight
        places[s, at.LAST_STEP] = last_step
        places[s, at.END] = FLYING
        parameters[s] = conditions.parameters
        parameters[s, place.TIMEOUT] = scene.timeout_s
        quadrotor[s] = conditions.quadrotor
        limits[s] = conditions.limits
        goals[s] = scene.goal
        sums, concerned, leader, earned, totals, returns = self.acts[3:]
        for array in (sums, leader, earned, totals, returns):
            array[s] = 0.0
        concerned[s] = -1
        self.snapshots[0][s] = -1

    def start(
        self, s: int, scene: Scene, leader: FloatArray, settings: EnvironmentSettings, rng: Generator
    ) -> None:
        """Put swarm `s` at a start of its scene, everybody hovering.

        Args:
            s: which.
            scene: where.
            leader: (10,) the leader's first state.
            settings: how far followers begin from the middles of their cells.
            rng: draws cells, places and headings.
        """
        for group in (self.motion, self.views):
            for array in group:
                array[s] = 0
        self.places[s, at.STEP] = 0
        followers = self.vehicles - 1
        rules = settings.swarm
        cells = scene.cells[rng.permutation(len(scene.cells))[:followers]]
        state = self.motion[3][s]
        state[0, P : P + 3] = leader[:3]
        state[0, Q : Q + 4] = leader[6:]
        state[1:, P : P + 2] = cells + rng.uniform(-rules.jitter_m, rules.jitter_m, (followers, 2))
        low, high = rules.termination.altitude_m
        rises = rng.uniform(-rules.height_jitter_m, rules.height_jitter_m, followers)
        state[1:, P + 2] = np.clip(scene.height + rises, low + 0.2, high - 0.2)
        half = 0.5 * rng.uniform(-math.pi, math.pi, followers)
        state[1:, Q], state[1:, Q + 3] = np.cos(half), np.sin(half)
        state[:, THRUST] = GRAVITY
        self.motion[7][s] = math.inf
        self.views[3][s] = math.inf
