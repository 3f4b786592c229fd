"""What flock would do if it saw everything as it is: a second look at swarms that fly by their own sight."""

from typing import Any

from companion.compiled import portable
from companion.control.followers.laws_kernels import steer_flock
from companion.control.followers.layout_kernels import PREVIOUS
from companion.messages import Float32Array, FloatArray
from sitl.abstract import layout_kernels as place
from sitl.abstract.swarm_kernels import perceive_one
from sitl.training import batch_layout_kernels as at
from sitl.training.environment_kernels import grid_of, motion_of, views_of, world_of

Arrays = tuple[Any, ...]

_NEAR_M, _FREE_M = 0.8, 1.8
"""Whoever is this near to a surface keeps to what he wants himself, whoever is so far is taught all there is:
of two ways past an obstacle either is good, and what lies between them is not."""


@portable(
    f"void(int64, int64, {at.BANK}, {at.RAYS}, float64[::1], {at.SWARM}, {at.MOTION}, {at.VIEWS},"
    " float64, float64[:,:,::1], float64[:,:,::1], float32[:,::1], float32[:,::1])"
)
def look_again(
    first: int,
    last: int,
    bank: Arrays,
    rays: Arrays,
    law: FloatArray,
    swarm: Arrays,
    motion: Arrays,
    views: Arrays,
    trust: float,
    flown: FloatArray,
    wanted: FloatArray,
    pupil: Float32Array,
    reference: Float32Array,
) -> None:
    """Ask flock what it would fly where some swarms are now; for the arrays see `batch_layout_kernels`.

    Args:
        first: number of the first swarm.
        last: one more than that of the last.
        bank: obstacles and leaders' flights of all scenes.
        rays: tables of the grid.
        law: parameters of `flock`.
        swarm: what holds for each swarm, with the second look's own parameters and candidates.
        motion: how its vehicles move; only looked at.
        views: the second look's own.
        trust: share of the difference to what the pupil wants that is taught far from all surfaces.
        flown: (S, n, 3) the command that each vehicle flies, map.
        wanted: (S, n, 3) scratch.
        pupil: (K, 3) what flock wants by the follower's own sight, heading frame, m/s.
        reference: (K, 3) out, what it ought to want, likewise.
    """
    for s in range(first, last):
        seeds, places, parameters = swarm[0], swarm[1], swarm[2]
        world, moving = world_of(s, bank, swarm), motion_of(s, motion)
        own, grid = views_of(s, views), grid_of(s, rays, swarm)
        step = places[s, at.STEP]
        is_new_grid = step % int(parameters[s, place.SCAN_STEPS]) == 0
        for i in range(1, motion[3].shape[1]):
            perceive_one(seeds[s], step, i, world, grid, moving, own, parameters[s], own[5], own[6])
            ego, neighbours, ranges, memory = own[1], own[2], own[3], own[4]
            for axis in range(3):
                memory[i, PREVIOUS + axis] = flown[s, i, axis]
            steer_flock(ego[i], neighbours[i], ranges[i], memory[i], law, wanted[s, i], is_new_grid)
            k = places[s, at.FIRST_STREAM] + i - 1
            share = trust * min(max((moving[7][i] - _NEAR_M) / (_FREE_M - _NEAR_M), 0.0), 1.0)
            for axis in range(3):
                reference[k, axis] = pupil[k, axis] + share * (wanted[s, i, axis] - pupil[k, axis])
