"""Filling an area with things that keep a guaranteed distance from each other and from places kept free."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.random import Generator

from companion.messages import FloatArray
from sitl.worlds.placing_kernels import KEPT_COLUMNS, place_rods

FreeDisc = tuple[float, float, float]
"""x, y and radius of an upright cylinder without end into which nothing may reach, m."""

_BATCH = 2048
_MOST = 100_000
_DEEP_M = 1e3


def fill(
    rng: Generator,
    numbers_each: int,
    rods_of: Callable[[FloatArray], FloatArray],
    *,
    free: Iterable[FreeDisc],
    gap_m: float,
    failures_until_full: int,
    most: int = _MOST,
) -> tuple[FloatArray, FloatArray]:
    """Place as many rods as chance finds room for.

    Candidates are drawn one after the other and kept if they keep every distance: Poisson-disk sampling by
    dart throwing, between surfaces and in three dimensions. The generator moves on by exactly the numbers
    of the candidates looked at.

    Args:
        rng: source of chance.
        numbers_each: random numbers (0 to 1) that describe one candidate.
        rods_of: turns numbers (n, numbers_each) into rods (n, 7): start, end and radius, m.
        free: places that stay free.
        gap_m: least distance between the surfaces of any two rods.
        failures_until_full: candidates refused in a row after which the area counts as full.
        most: stop at this many rods.

    Returns:
        Rods (m, 7) and the numbers (m, numbers_each) that describe them.
    """
    discs = list(free)
    kept = np.zeros((256, KEPT_COLUMNS))
    for row, (x, y, radius) in zip(kept, discs, strict=False):
        row[:] = x, y, -_DEEP_M, x, y, _DEEP_M, 0.0, radius, x, y, 0.0
    described: list[FloatArray] = []
    count, failures, last = len(discs), 0, len(discs) + most
    while failures < failures_until_full and count < last:
        before = rng.bit_generator.state
        numbers = rng.random((_BATCH, numbers_each))
        rods = np.ascontiguousarray(rods_of(numbers))
        done = 0
        while done < _BATCH and failures < failures_until_full and count < last:
            if count == len(kept):
                kept = np.concatenate([kept, np.zeros_like(kept)])
            room = kept[:last]
            chosen = np.empty(len(room), np.int64)
            first = count
            used, count, failures = place_rods(
                rods[done:], room, count, gap_m, failures, failures_until_full, chosen
            )
            described.append(numbers[done + chosen[first:count]])
            done += used
        if done < _BATCH:
            rng.bit_generator.state = before
            rng.random((done, numbers_each))
    numbers_kept = np.concatenate(described) if described else np.zeros((0, numbers_each))
    return kept[len(discs) : count, :7].copy(), numbers_kept
