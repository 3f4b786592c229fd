"""The step of a batch of swarms on a graphics card: launches over the functions of `environment_kernels`.

A step is five launches, one after the other: `fly` (one thread per vehicle), `count` (one per swarm), `see`
(one per vehicle: by far the most work), `judge` (one per swarm) and `pay` (one per follower). Between two
launches everybody has finished, so no thread ever waits for another; within one no thread writes what another
reads. Neighbouring threads are vehicles of the same swarm: they read the same obstacles. Kernels use many
registers, so blocks are small.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numba import cuda, float64, uint8

from companion.compiled import for_cuda
from companion.messages import Float32Array, FloatArray
from sitl.training import batch_layout_kernels as at
from sitl.training.environment_kernels import (
    begin_one,
    end_of,
    fly_one,
    grid_of,
    motion_of,
    pay_one,
    see_one,
    take_sample,
    views_of,
    world_of,
)

Arrays = tuple[Any, ...]
Numbers = np.ndarray[tuple[int], np.dtype[np.int64]]

MOST_VEHICLES = 32
"""Largest swarm on a card, its leader included."""
_THREADS_PER_BLOCK = 64


def _begin(which: Numbers, bank: Arrays, swarm: Arrays, motion: Arrays) -> None:
    t, n = cuda.grid(1), motion[3].shape[1]
    if t < which.shape[0] * n:
        s = which[t // n]
        begin_one(s, t % n, world_of(s, bank, swarm), motion_of(s, motion), swarm)


def _fly(
    which: Numbers, contract: int, velocity: Float32Array, bank: Arrays, law: FloatArray, swarm: Arrays,
    motion: Arrays, views: Arrays, acts: Arrays,
) -> None:  # fmt: skip
    t, n = cuda.grid(1), motion[3].shape[1]
    if t < which.shape[0] * n:
        s = which[t // n]
        fly_one(
            s, t % n, contract, velocity, bank[3], world_of(s, bank, swarm), motion_of(s, motion),
            views_of(s, views), law, swarm, acts,
        )  # fmt: skip


def _count(which: Numbers, steps: int, swarm: Arrays, motion: Arrays, acts: Arrays) -> None:
    t = cuda.grid(1)
    if t < which.shape[0]:
        s = which[t]
        swarm[1][s, at.STEP] += steps
        take_sample(s, swarm, motion, acts)


def _see(
    which: Numbers, contract: int, showing: int, bank: Arrays, rays: Arrays, law: FloatArray, swarm: Arrays,
    motion: Arrays, views: Arrays, acts: Arrays, shown: Arrays, snapshots: Arrays,
) -> None:  # fmt: skip
    t, n = cuda.grid(1), motion[3].shape[1]
    if t < which.shape[0] * n:
        roles = cuda.local.array(MOST_VEHICLES, uint8)
        up = cuda.local.array(3, float64)
        s = which[t // n]
        see_one(
            s, t % n, contract, showing, world_of(s, bank, swarm), grid_of(s, rays, swarm),
            motion_of(s, motion), views_of(s, views), law, swarm, motion, views, acts, shown, snapshots,
            roles[:n], up,
        )  # fmt: skip


def _judge(which: Numbers, swarm: Arrays, motion: Arrays, views: Arrays, acts: Arrays) -> None:
    t = cuda.grid(1)
    if t < which.shape[0]:
        swarm[1][which[t], at.END] = end_of(which[t], swarm, motion, views, acts)


def _pay(
    which: Numbers, rays: Arrays, numbers: FloatArray, weights: FloatArray, swarm: Arrays, motion: Arrays,
    views: Arrays, acts: Arrays, paid: Arrays,
) -> None:  # fmt: skip
    t, followers = cuda.grid(1), motion[3].shape[1] - 1
    if t < which.shape[0] * followers:
        pay_one(
            which[t // followers], 1 + t % followers, rays, numbers, weights, swarm, motion, views, acts, paid
        )


def _scatter(which: Numbers, rows: Any, target: Any) -> None:
    t, width = cuda.grid(1), target.shape[1]
    if t < which.shape[0] * width:
        target[which[t // width], t % width] = rows[t // width, t % width]


@dataclass(frozen=True, slots=True)
class Launches:
    """The kernels; each is called with its number of threads, then its arguments."""

    begin: "Launch"
    fly: "Launch"
    count: "Launch"
    see: "Launch"
    judge: "Launch"
    pay: "Launch"
    scatter: "Launch"


class Launch:
    """One kernel that knows how to be launched."""

    def __init__(self, kernel: Any) -> None:
        """Take a kernel that has been compiled for the card."""
        self._kernel = kernel

    def __call__(self, threads: int, *arguments: Any) -> None:
        """Run it in so many threads; returns before they have finished."""
        per_block = min(threads, _THREADS_PER_BLOCK)
        self._kernel[(threads + per_block - 1) // per_block, per_block](*arguments)


@cache
def launches() -> Launches:
    """Build the kernels, which are compiled for the card when they are first launched."""
    sources = (_begin, _fly, _count, _see, _judge, _pay, _scatter)
    return Launches(*(Launch(for_cuda(source, entry=True)) for source in sources))
