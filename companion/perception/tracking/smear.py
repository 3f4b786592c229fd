"""How fast something moves, from the points of one stack alone.

What passes nearby at several metres a second leaves a streak that is longer than any UAV; the times at
which its points were measured tell the streak from a long thing.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray
from companion.perception.tracking.clustering import FilteredPoints

_LEAST_POINTS = 10
_SCATTER_M = 0.1  # of points about the middle of a body, on an axis
_LEAST_SIGMAS = 5.0
_FASTEST = 12.0

Velocities = dict[int, tuple[FloatArray, float]]
"""Velocity (3,) of some clusters, m/s, and its standard deviation on each axis."""


def straighten(
    labels: NDArray[np.int32], points: FilteredPoints, settled: NDArray[np.bool_]
) -> tuple[FilteredPoints, Velocities]:
    """Return the points with those of moving bodies moved to now, and how fast those bodies are.

    Args:
        labels: (n,) cluster of each point, -1 for none.
        points: what was clustered.
        settled: (t,) tracks whose velocity is known better than by this.
    """
    of_settled = (points.owners >= 0) & (points.owners < points.tracks)
    of_settled[of_settled] = settled[points.owners[of_settled]]
    wanted = labels >= 0
    counts = np.bincount(labels[wanted], minlength=1)
    unknown = counts >= _LEAST_POINTS
    unknown[labels[of_settled & wanted]] = False
    inside = np.flatnonzero(wanted & unknown[labels])
    names, ages, measured = labels[inside], points.ages_s[inside], points.measured_map[inside]
    late = ages - (np.bincount(names, ages, len(counts)) / np.maximum(counts, 1))[names]
    square = np.maximum(np.bincount(names, late**2, len(counts)), 1e-9)
    sums = [np.bincount(names, late * measured[:, axis], len(counts)) for axis in range(3)]
    velocities = -np.column_stack(sums) / square[:, None]
    sigmas = _SCATTER_M / np.sqrt(square)
    speeds = np.linalg.norm(velocities, axis=1)
    streaks = unknown & (speeds > _LEAST_SIGMAS * sigmas) & (speeds < _FASTEST)
    if not streaks.any():
        return points, {}
    moving = streaks[names]
    moved = points.moved_map.copy()
    moved[inside[moving]] = measured[moving] + ages[moving, None] * velocities[names[moving]]
    known: Velocities = {
        int(name): (velocities[name], float(sigmas[name])) for name in np.flatnonzero(streaks)
    }
    return replace(points, moved_map=moved), known
