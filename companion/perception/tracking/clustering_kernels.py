"""Hot loops of clustering: density clusters on a sorted grid, and what there is to know of each one."""

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import FloatArray

_OFFSET = 1 << 20
_BITS = 21

# Columns of a cluster's summary.
COUNT = 0
FRESH = 1
BRIGHT = 2
FRESH_BRIGHT = 3
SUM = slice(4, 7)  # of moved points
FRESH_SUM = slice(7, 10)  # of points as measured
FRESH_AGE = 10
LOW = slice(11, 14)
HIGH = slice(14, 17)
FRESH_MOVED_SUM = slice(17, 20)
FRESH_BRIGHT_SUM = slice(20, 23)  # of moved points
SUMMARY_WIDTH = 23


@inlined
def _first_at_least(keys: NDArray[np.int64], wanted: int) -> int:
    low, high = 0, keys.shape[0]
    while low < high:
        middle = (low + high) >> 1
        if keys[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low


@inlined
def _root(parents: NDArray[np.int32], i: int) -> int:
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@compiled("int64(float64[:, ::1], float64[::1], int64, int32[::1])")
def density_clusters(
    points: FloatArray, epsilons: FloatArray, core_points: int, labels: NDArray[np.int32]
) -> int:
    """Group points by density; two are neighbours when nearer than the mean of their epsilons.

    A point with at least `core_points` neighbours, itself included, is a core; cores that are neighbours
    share a cluster; any other point joins the cluster of its nearest neighbouring core.
    Source: M. Ester et al., "A density-based algorithm for discovering clusters", 1996.

    Args:
        points: (n, 3) metres, within +-1,000,000 of the largest epsilon from the origin.
        epsilons: (n,) metres, positive.
        core_points: see above.
        labels: (n,) out: number of the cluster, in order of first points, or -1.

    Returns:
        The number of clusters.
    """
    n = points.shape[0]
    if n == 0:
        return 0
    cell = 0.0
    for i in range(n):
        cell = max(cell, epsilons[i])
    keys = np.empty(n, np.int64)
    for i in range(n):
        ix = int(np.floor(points[i, 0] / cell)) + _OFFSET
        iy = int(np.floor(points[i, 1] / cell)) + _OFFSET
        iz = int(np.floor(points[i, 2] / cell)) + _OFFSET
        keys[i] = (ix << (2 * _BITS)) | (iy << _BITS) | iz
    order = np.argsort(keys, kind="mergesort")
    ordered = keys[order]
    # Neighbours of a cell lie in nine runs of the sorted points: z is the fastest coordinate.
    first, last = np.empty((n, 9), np.int32), np.empty((n, 9), np.int32)
    for a in range(n):
        if a > 0 and ordered[a] == ordered[a - 1]:
            for run in range(9):
                first[a, run], last[a, run] = first[a - 1, run], last[a - 1, run]
            continue
        for run in range(9):
            dx, dy = run // 3 - 1, run % 3 - 1
            base = ordered[a] + (dx << (2 * _BITS)) + (dy << _BITS)
            first[a, run] = _first_at_least(ordered, base - 1)
            last[a, run] = _first_at_least(ordered, base + 2)
    core = np.zeros(n, np.uint8)
    for a in range(n):
        i = order[a]
        count = 0
        for run in range(9):
            for b in range(first[a, run], last[a, run]):
                j = order[b]
                reach = 0.5 * (epsilons[i] + epsilons[j])
                x, y, z = (
                    points[i, 0] - points[j, 0],
                    points[i, 1] - points[j, 1],
                    points[i, 2] - points[j, 2],
                )
                if x * x + y * y + z * z <= reach * reach:
                    count += 1
                    if count >= core_points:
                        break
            if count >= core_points:
                break
        core[i] = count >= core_points
    parents = np.empty(n, np.int32)
    for i in range(n):
        parents[i] = i
    nearest = np.full(n, -1, np.int32)
    for a in range(n):
        i = order[a]
        best = np.inf
        for run in range(9):
            for b in range(first[a, run], last[a, run]):
                j = order[b]
                if not core[j] or (core[i] and b <= a):
                    continue
                reach = 0.5 * (epsilons[i] + epsilons[j])
                x, y, z = (
                    points[i, 0] - points[j, 0],
                    points[i, 1] - points[j, 1],
                    points[i, 2] - points[j, 2],
                )
                square = x * x + y * y + z * z
                if square > reach * reach:
                    continue
                if core[i]:
                    ri, rj = _root(parents, i), _root(parents, j)
                    if ri != rj:
                        parents[max(ri, rj)] = min(ri, rj)
                elif square < best:
                    best = square
                    nearest[i] = j
    number = 0
    names = np.full(n, -1, np.int32)
    for i in range(n):
        root = i if core[i] else int(nearest[i])
        if root < 0:
            labels[i] = -1
            continue
        root = _root(parents, root)
        if names[root] < 0:
            names[root] = number
            number += 1
        labels[i] = names[root]
    return number


@compiled(
    "void(int32[::1], float64[:, ::1], float64[:, ::1], float64[::1], uint8[::1], uint8[::1],"
    " float64[:, ::1])"
)
def summarise(
    labels: NDArray[np.int32],
    measured: FloatArray,
    moved: FloatArray,
    ages_s: FloatArray,
    fresh: NDArray[np.uint8],
    bright: NDArray[np.uint8],
    summary: FloatArray,
) -> None:
    """Add up what each cluster consists of.

    Args:
        labels: (n,) cluster of each point, negative for none.
        measured: (n, 3) points where they were measured.
        moved: (n, 3) the same points where they are expected now.
        ages_s: (n,) how long ago they were measured.
        fresh: (n,) 1 for points of the newest scan.
        bright: (n,) 1 for bright points.
        summary: (k, SUMMARY_WIDTH) out, one row a cluster.
    """
    for k in range(summary.shape[0]):
        for c in range(SUMMARY_WIDTH):
            summary[k, c] = np.inf if 11 <= c < 14 else -np.inf if 14 <= c < 17 else 0.0
    for i in range(labels.shape[0]):
        k = labels[i]
        if k < 0:
            continue
        summary[k, 0] += 1.0
        summary[k, 2] += bright[i]
        for c in range(3):
            summary[k, 4 + c] += moved[i, c]
            summary[k, 11 + c] = min(summary[k, 11 + c], moved[i, c])
            summary[k, 14 + c] = max(summary[k, 14 + c], moved[i, c])
        if fresh[i]:
            summary[k, 1] += 1.0
            summary[k, 3] += bright[i]
            summary[k, 10] += ages_s[i]
            for c in range(3):
                summary[k, 7 + c] += measured[i, c]
                summary[k, 17 + c] += moved[i, c]
                summary[k, 20 + c] += bright[i] * moved[i, c]
