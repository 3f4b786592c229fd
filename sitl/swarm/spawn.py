"""Where a swarm hovers when its trial begins: cells of a grid, who stands where, and which way they look."""

import math

import numpy as np
from numpy.random import Generator

from companion.messages import FloatArray
from sitl.swarm.settings import ROOM_TO_LIMITS_M, SwarmSettings
from sitl.worlds.primitives import World

_LEAST_SIDE = 3
_ROOM_M = 0.5
"""A cell nearer to a surface than this is not used."""


def cells(vehicles: int, spacing_m: float) -> FloatArray:
    """Return the middles (k, 2) of a square grid of cells about the origin, at least one a vehicle, m."""
    side = max(_LEAST_SIDE, math.ceil(math.sqrt(vehicles)))
    offsets = spacing_m * (np.arange(side) - 0.5 * (side - 1))
    return np.stack([axis.ravel() for axis in np.meshgrid(offsets, offsets, indexing="ij")], axis=1)


def spawn(
    settings: SwarmSettings, world: World, spawn_world: FloatArray, rng: Generator
) -> tuple[FloatArray, FloatArray]:
    """Place the vehicles of a swarm.

    Args:
        settings: of the swarm.
        world: what they must not stand in.
        spawn_world: (2,) middle of the cells, m.
        rng: draws cells, jitter, heights and headings.

    Returns:
        Places (n, 3) m and headings (n,) rad; number 0 is the leader, which stands in any of the cells.

    Raises:
        ValueError: if obstacles leave too few cells free.
    """
    number = settings.followers + 1
    grid = cells(number, settings.spacing_m) + spawn_world
    height = rng.uniform(*settings.cruise_height_m)
    order = rng.permutation(len(grid))
    jitter = rng.uniform(-settings.jitter_m, settings.jitter_m, (len(grid), 2))
    rises = rng.uniform(-settings.height_jitter_m, settings.height_jitter_m, len(grid))
    yaws = rng.uniform(-math.pi, math.pi, number)
    low, high = settings.termination.altitude_m
    places = np.column_stack([grid + jitter, height + rises])[order]
    places[:, 2] = np.clip(places[:, 2], low + ROOM_TO_LIMITS_M, high - ROOM_TO_LIMITS_M)
    obstacles = world.obstacles()
    if len(obstacles):
        places = places[obstacles.clearance(places) >= _ROOM_M]
    if len(places) < number:
        raise ValueError(f"obstacles leave {len(places)} places free at the start, {number} are needed")
    places = places[:number]
    places[0, 2] = height
    return places, yaws
