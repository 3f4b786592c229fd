"""Which cluster belongs to which track."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from companion.messages import FloatArray

_NEVER = 1e9


def gated_costs(
    states: FloatArray,
    covariances: FloatArray,
    measured_map: FloatArray,
    noises: FloatArray,
    ages_s: FloatArray,
    gate: float,
) -> FloatArray:
    """Return the cost (t, c) of every pair of track and measurement; infinite outside the gate.

    The cost is the negative log-likelihood of the measurement, up to constants: the squared Mahalanobis
    distance plus the log-determinant of its covariance, so that a vague track does not win by being
    vague.

    Args:
        states: (t, 6) positions and velocities now.
        covariances: (t, 6, 6).
        measured_map: (c, 3) positions measured `ages_s` ago.
        noises: (c, 3, 3) their covariances.
        ages_s: (c,) seconds.
        gate: largest squared Mahalanobis distance.
    """
    costs = np.full((len(states), len(measured_map)), np.inf)
    if costs.size == 0:
        return costs
    # The trace bounds the largest eigenvalue, so this test lets every pair within the gate pass.
    spread = np.trace(covariances[:, :3, :3], axis1=1, axis2=2)
    spread_v = np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2)
    reach = np.sqrt(
        gate
        * (
            2.0 * (spread[:, None] + spread_v[:, None] * ages_s**2)
            + np.trace(noises, axis1=1, axis2=2)[None, :]
        )
    )
    off = measured_map[None, :, :] - states[:, None, :3] + states[:, None, 3:] * ages_s[None, :, None]
    tracks, clusters = np.nonzero(np.einsum("tci,tci->tc", off, off) <= reach**2)
    age = ages_s[clusters, None, None]
    P = covariances[tracks]
    S = P[:, :3, :3] - age * (P[:, :3, 3:] + P[:, 3:, :3]) + age**2 * P[:, 3:, 3:] + noises[clusters]
    y = off[tracks, clusters]
    square = np.einsum("ni,ni->n", y, np.linalg.solve(S, y[:, :, None])[:, :, 0])
    cost = square + np.log(np.linalg.det(S))
    costs[tracks, clusters] = np.where(square <= gate, cost, np.inf)
    return costs


def global_pairs(costs: FloatArray) -> list[tuple[int, int]]:
    """Return the pairs (row, column) with as many pairs as possible at the least total cost."""
    if costs.size == 0:
        return []
    finite = np.isfinite(costs)
    rows, columns = linear_sum_assignment(np.where(finite, costs, _NEVER))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if finite[i, j]]


def greedy_pairs(distances_m: FloatArray, limit_m: float) -> list[tuple[int, int]]:
    """Return pairs (row, column) of distances (t, c): always the nearest that is left, up to a limit."""
    pairs: list[tuple[int, int]] = []
    order: NDArray[np.intp] = np.argsort(distances_m, axis=None, kind="stable")
    rows, columns = set(range(distances_m.shape[0])), set(range(distances_m.shape[1]))
    for flat in order:
        i, j = divmod(int(flat), distances_m.shape[1])
        if distances_m[i, j] > limit_m or not rows:
            break
        if i in rows and j in columns:
            rows.remove(i)
            columns.remove(j)
            pairs.append((i, j))
    return pairs
