"""How fast something moves, from the points of one stack alone.

What passes nearby at several metres a second leaves a streak that is longer than any UAV; the times at
which its points were measured tell the streak from a long thing.
"""

import math
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
    counts = np.bincount(labels[labels >= 0], minlength=1)
    done = np.unique(labels[of_settled & (labels >= 0)])
    moved = points.moved_map
    velocities: Velocities = {}
    for label in np.setdiff1d(np.flatnonzero(counts >= _LEAST_POINTS), done):
        inside = np.flatnonzero(labels == label)
        ages = points.ages_s[inside]
        late = ages - ages.mean()
        square = float(late @ late)
        sigma = _SCATTER_M / math.sqrt(max(square, 1e-9))
        velocity = -(late @ points.measured_map[inside]) / max(square, 1e-9)
        if _LEAST_SIGMAS * sigma < float(np.linalg.norm(velocity)) < _FASTEST:
            if not velocities:
                moved = moved.copy()
            moved[inside] = points.measured_map[inside] + ages[:, None] * velocity
            velocities[int(label)] = velocity, sigma
    return replace(points, moved_map=moved), velocities
