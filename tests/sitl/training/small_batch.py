"""A small environment that several tests fly."""

from functools import cache
from typing import Any

import numpy as np

from companion.messages import Float32Array
from sitl.swarm.settings import SwarmSettings
from sitl.training.environment import EnvironmentSettings, SceneBank, StepResult, SwarmBatch

SHORT = SwarmSettings(goal_distance_m=8.0)
MIXED = EnvironmentSettings(
    swarms=4,
    followers=[2, 4],
    worlds={"pillars_5m": 1.0, "forest": 1.0},
    behaviours={"straight": 1.0, "hover": 1.0},
    perceptions={"paper": 1.0, "measured": 1.0},
    scenes=4,
    swarm=SHORT,
    stagger_s=0.0,
)
OPEN = EnvironmentSettings(
    swarms=1, followers=[4], worlds={"none": 1.0}, scenes=2, swarm=SHORT, stagger_s=0.0
)


@cache
def mixed_bank() -> SceneBank:
    """Build the scenes of `MIXED` once for all tests."""
    return SceneBank.build(MIXED)


@cache
def open_bank() -> SceneBank:
    """Build the scenes of `OPEN` once for all tests."""
    return SceneBank.build(OPEN)


def mixed_batch(seed: int = 1, workers: int = 1, **changes: Any) -> SwarmBatch:
    """Return an environment of several sizes, worlds and perceptions."""
    settings = MIXED.model_copy(update=changes)
    return SwarmBatch(settings, "best-2", seed, workers, bank=mixed_bank())


def open_batch(seed: int = 1, contract: str = "best-2", **changes: Any) -> SwarmBatch:
    """Return an environment with one swarm of four followers without obstacles."""
    return SwarmBatch(OPEN.model_copy(update=changes), contract, seed, bank=open_bank())


def flown(batch: SwarmBatch, steps: int, velocity: Float32Array | None = None) -> StepResult:
    """Fly some steps with a velocity (K, 3), with the law's own without; return the last result."""
    for _ in range(steps):
        result = batch.step(batch.observation.reference.copy() if velocity is None else velocity)
    return result


def copied(result: StepResult) -> list[np.ndarray]:
    """Return copies of all arrays of a result."""
    seen = result.observation
    arrays = (
        seen.ego, seen.neighbours, seen.grid, seen.memory, seen.privileged, seen.reference, result.terms,
        result.reward, result.terminated, result.truncated,
    )  # fmt: skip
    return [array.copy() for array in arrays]
