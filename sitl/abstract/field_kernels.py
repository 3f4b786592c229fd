"""The flight plane of a known world: which columns are blocked at the height of flight, and where in them."""

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import portable, portable_inlined
from companion.messages import FloatArray
from sitl.abstract.grid_kernels import IndexArray
from sitl.worlds.clearance_kernels import distance_to_primitive
from sitl.worlds.raycast_kernels import BOX, CYLINDER, SPHERE

_LAYER_M = 0.25
_UPRIGHT = 1.0 - 1e-9
_TINY_M = 1e-3


@portable_inlined
def _band_distance(kind: int, row: FloatArray, x: float, y: float, low: float, high: float) -> float:
    """Return the least signed distance to a primitive over a vertical line, m."""
    if kind == SPHERE:
        return distance_to_primitive(kind, row, x, y, min(max(row[2], low), high))
    if kind == BOX or (kind == CYLINDER and abs(row[5]) >= _UPRIGHT):
        end = row[2] + row[5] * row[6] if kind == CYLINDER else row[2]
        return distance_to_primitive(kind, row, x, y, min(max(0.5 * (row[2] + end), low), high))
    layers = math.ceil((high - low) / _LAYER_M)
    best = math.inf
    for layer in range(layers + 1):
        best = min(best, distance_to_primitive(kind, row, x, y, low + (high - low) * layer / layers))
    return best


@portable(
    "void(int32[::1], float64[:,::1], float64[:,::1], float64, float64, float64, float64, float64,"
    " uint8[:,::1], float32[:,:,::1])"
)
def block_columns(
    kinds: IndexArray,
    rows: FloatArray,
    discs: FloatArray,
    low: float,
    high: float,
    x0: float,
    y0: float,
    cell: float,
    blocked: NDArray[np.uint8],
    surface: NDArray[np.float32],
) -> None:
    """Mark the columns that an obstacle fills between two heights.

    Args:
        kinds: (m,) kind of each primitive.
        rows: (m, 8) its shape.
        discs: (m, 3) its enclosing vertical cylinder.
        low: lowest height that matters, m.
        high: highest such height.
        x0: corner of the square.
        y0: likewise.
        cell: size of a column, m.
        blocked: (n, n) changed in place.
        surface: (n, n, 2) changed in place: offset from a blocked column's centre to the surface next to it.
    """
    n = blocked.shape[0]
    for k in range(kinds.shape[0]):
        reach = discs[k, 2] + cell
        i_low, i_high = (discs[k, 0] - reach - x0) / cell, (discs[k, 0] + reach - x0) / cell
        j_low, j_high = (discs[k, 1] - reach - y0) / cell, (discs[k, 1] + reach - y0) / cell
        for i in range(max(int(max(i_low, 0.0)), 0), int(min(max(i_high + 1.0, 0.0), float(n)))):
            for j in range(max(int(max(j_low, 0.0)), 0), int(min(max(j_high + 1.0, 0.0), float(n)))):
                x, y = x0 + (i + 0.5) * cell, y0 + (j + 0.5) * cell
                d = _band_distance(kinds[k], rows[k], x, y, low, high)
                if d > 0.5 * cell:
                    continue
                blocked[i, j] = 1
                gx = (_band_distance(kinds[k], rows[k], x + _TINY_M, y, low, high) - d) / _TINY_M
                gy = (_band_distance(kinds[k], rows[k], x, y + _TINY_M, low, high) - d) / _TINY_M
                if abs(d) <= cell:
                    surface[i, j, 0] = -d * gx
                    surface[i, j, 1] = -d * gy
