"""Clearance fields of known discs, without a LiDAR in between."""

from itertools import pairwise

import numpy as np

from companion.control.leader.obstacle_map import ClearanceField
from companion.messages import FloatArray

CELL = 0.2
SIDE = 128


def field_of(discs: FloatArray, radius: float) -> ClearanceField:
    """A field round the origin whose distances are those to discs (n, 2) of one radius."""
    first = np.array([-SIDE // 2, -SIDE // 2, 0], np.int64)
    axis = (first[0] + np.arange(SIDE) + 0.5) * CELL
    x, y = np.meshgrid(axis, axis, indexing="ij")
    distance = np.full((SIDE, SIDE), 3.0)
    for disc in discs:
        distance = np.minimum(distance, np.maximum(np.hypot(x - disc[0], y - disc[1]) - radius, 0.0))
    return ClearanceField(
        corner_map=np.asarray(first[:2] * CELL, np.float64),
        cell_m=CELL,
        distance=distance.astype(np.float32),
        blocked=(distance < 0.5 * CELL).astype(np.uint8),
        surface=np.zeros((SIDE, SIDE, 2), np.float32),
        first=first,
    )


def wall(*corners: tuple[float, float]) -> FloatArray:
    """Discs every 0.2 m along a polyline."""
    pieces = []
    for start, end in pairwise(corners):
        a, b = np.array(start), np.array(end)
        count = int(np.hypot(*(b - a)) / 0.2) + 1
        pieces.append(a + np.linspace(0.0, 1.0, count + 1)[:, None] * (b - a))
    return np.concatenate(pieces)
