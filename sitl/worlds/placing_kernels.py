"""Random placing of things that must keep a distance: dart throwing, with rods of any direction.

A rod is a segment with a radius: an upright pillar, a leaning trunk; a ball is a rod without length.
"""

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import FloatArray

KEPT_COLUMNS = 11
_POINT_M2 = 1e-18
_PARALLEL = 1e-12


@inlined
def segment_distance(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    cx: float, cy: float, cz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """Return the distance between the segments a-b and c-d, m; either may be a point."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = dx - cx, dy - cy, dz - cz
    wx, wy, wz = ax - cx, ay - cy, az - cz
    uu, vv, uv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz
    uw, vw = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    s, t = 0.0, 0.0
    if uu > _POINT_M2:
        determinant = uu * vv - uv * uv
        if vv > _POINT_M2 and determinant > _PARALLEL * uu * vv:
            s = min(max((uv * vw - vv * uw) / determinant, 0.0), 1.0)
        elif vv <= _POINT_M2:
            s = min(max(-uw / uu, 0.0), 1.0)
    if vv > _POINT_M2:
        t = (s * uv + vw) / vv
        if t < 0.0 or t > 1.0:
            t = min(max(t, 0.0), 1.0)
            if uu > _POINT_M2:
                s = min(max((t * uv - uw) / uu, 0.0), 1.0)
    gx, gy, gz = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return math.sqrt(gx * gx + gy * gy + gz * gz)


@compiled("UniTuple(int64, 3)(float64[:, ::1], float64[:, ::1], int64, float64, int64, int64, int64[::1])")
def place_rods(
    candidates: FloatArray,
    kept: FloatArray,
    count: int,
    gap: float,
    failures: int,
    failures_allowed: int,
    chosen: NDArray[np.int64],
) -> tuple[int, int, int]:
    """Keep the candidates that keep their distance from all kept before.

    Args:
        candidates: (n, 7) start, end and radius of each.
        kept: (m, 11) start, end, radius, distance that others must keep from its surface, and x, y and
            radius of an upright cylinder around it; more are written after the first `count`.
        count: rows of `kept` in use.
        gap: distance that must be kept from those kept here.
        failures: candidates refused in a row so far.
        failures_allowed: at this many, placing ends.
        chosen: (m,) out, number of the candidate of each row of `kept` written here.

    Returns:
        Candidates looked at, rows of `kept` in use, candidates refused in a row. Placing stops early when
        `kept` is full.
    """
    used = 0
    while used < candidates.shape[0] and failures < failures_allowed and count < kept.shape[0]:
        rod = candidates[used]
        x, y = 0.5 * (rod[0] + rod[3]), 0.5 * (rod[1] + rod[4])
        reach = 0.5 * math.hypot(rod[3] - rod[0], rod[4] - rod[1]) + rod[6]
        free = True
        for k in range(count):
            other = kept[k]
            ex, ey, bound = other[8] - x, other[9] - y, other[10] + other[7] + reach
            if ex * ex + ey * ey >= bound * bound:
                continue
            distance = segment_distance(
                rod[0], rod[1], rod[2], rod[3], rod[4], rod[5],
                other[0], other[1], other[2], other[3], other[4], other[5],
            )  # fmt: skip
            if distance < other[6] + other[7] + rod[6]:
                free = False
                break
        if free:
            for column in range(7):
                kept[count, column] = rod[column]
            kept[count, 7], kept[count, 8], kept[count, 9], kept[count, 10] = gap, x, y, reach
            chosen[count] = used
            count, failures = count + 1, 0
        else:
            failures += 1
        used += 1
    return used, count, failures
