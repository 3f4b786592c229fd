"""Signed distances from points to primitives (rows as in `sitl.worlds.raycast_kernels`), batched."""

import math

import numpy as np

from companion.compiled import portable, portable_inlined
from companion.messages import FloatArray
from sitl.worlds.casting_kernels import into_body
from sitl.worlds.raycast_kernels import BOX, CAPSULE, PLANE, SPHERE


@portable_inlined
def _outside(x: float, y: float) -> float:
    """Return the distance to a quadrant's corner region: positive outside, negative inside."""
    if x > 0.0 and y > 0.0:
        return math.sqrt(x * x + y * y)
    return max(x, y)


@portable_inlined
def distance_to_primitive(kind: int, row: FloatArray, px: float, py: float, pz: float) -> float:
    """Return the signed distance (negative inside) from a point to one primitive, metres."""
    if kind == PLANE:
        return pz - float(row[2])
    mx, my, mz = px - row[0], py - row[1], pz - row[2]
    if kind == SPHERE:
        return math.sqrt(mx * mx + my * my + mz * mz) - float(row[7])
    if kind == BOX:
        ex = abs(row[6] * mx + row[7] * my) - row[3]
        ey = abs(row[6] * my - row[7] * mx) - row[4]
        return _outside(_outside(ex, ey), abs(mz) - row[5])
    axial = mx * row[3] + my * row[4] + mz * row[5]
    foot = min(max(axial, 0.0), row[6]) if kind == CAPSULE else axial
    mx, my, mz = mx - foot * row[3], my - foot * row[4], mz - foot * row[5]
    radial = math.sqrt(mx * mx + my * my + mz * mz) - float(row[7])
    if kind == CAPSULE:
        return radial
    return _outside(radial, abs(axial - 0.5 * row[6]) - 0.5 * row[6])


@portable_inlined
def nearest_primitive(
    kinds: np.ndarray[tuple[int], np.dtype[np.int32]],
    rows: FloatArray,
    discs: FloatArray,
    bodies: np.ndarray[tuple[int, int], np.dtype[np.int32]],
    poses: FloatArray,
    px: float,
    py: float,
    pz: float,
) -> tuple[float, int]:
    """Return (signed distance, index) of the nearest primitive; (infinity, -1) in an empty world."""
    best, nearest = math.inf, -1
    for k in range(discs.shape[0]):
        x, y, bound = discs[k, 0] - px, discs[k, 1] - py, discs[k, 2] + max(best, 0.0)
        if best > 0.0 and x * x + y * y > bound * bound:
            continue  # its whole enclosing cylinder is farther away than the nearest so far
        distance = distance_to_primitive(kinds[k], rows[k], px, py, pz)
        if distance < best:
            best, nearest = distance, k
    for b in range(bodies.shape[0]):
        x, y, z = px - poses[b, 0], py - poses[b, 1], pz - poses[b, 2]
        bound = poses[b, 7] + max(best, 0.0)
        if best > 0.0 and x * x + y * y + z * z > bound * bound:
            continue
        x, y, z = into_body(poses[b], x, y, z)
        for part in range(bodies[b, 0], bodies[b, 1]):
            distance = distance_to_primitive(kinds[part], rows[part], x, y, z)
            if distance < best:
                best, nearest = distance, part
    return best, nearest


@portable(
    "void(float64[:, ::1], int32[::1], float64[:, ::1], float64[:, ::1], int32[:, ::1], float64[:, ::1], "
    "float64[::1], int32[::1])"
)
def measure_clearances(
    points: FloatArray,
    kinds: np.ndarray[tuple[int], np.dtype[np.int32]],
    rows: FloatArray,
    discs: FloatArray,
    bodies: np.ndarray[tuple[int, int], np.dtype[np.int32]],
    poses: FloatArray,
    distances: FloatArray,
    indices: np.ndarray[tuple[int], np.dtype[np.int32]],
) -> None:
    """Write the signed distance (n,) and index (n,) of the primitive nearest to each point (n, 3)."""
    for i in range(points.shape[0]):
        distances[i], indices[i] = nearest_primitive(
            kinds, rows, discs, bodies, poses, points[i, 0], points[i, 1], points[i, 2]
        )


@portable(
    "void(float64[:, ::1], float64[:, ::1], float64, float64, int32[::1], float64[:, ::1], "
    "float64[:, ::1], int32[:, ::1], float64[:, ::1], float64[::1])"
)
def find_contacts(
    starts: FloatArray,
    ends: FloatArray,
    radius: float,
    tolerance: float,
    kinds: np.ndarray[tuple[int], np.dtype[np.int32]],
    rows: FloatArray,
    discs: FloatArray,
    bodies: np.ndarray[tuple[int, int], np.dtype[np.int32]],
    poses: FloatArray,
    fractions: FloatArray,
) -> None:
    """Write the fraction (n,) of each segment at which a moving sphere first touches, infinity if never.

    The distance changes by at most one metre a metre, so stepping by the free distance skips no contact
    deeper than `tolerance`.
    """
    for i in range(starts.shape[0]):
        sx, sy, sz = starts[i, 0], starts[i, 1], starts[i, 2]
        dx, dy, dz = ends[i, 0] - sx, ends[i, 1] - sy, ends[i, 2] - sz
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        fractions[i] = math.inf
        travelled = 0.0
        while True:
            f = min(travelled / length, 1.0) if length > 0.0 else 0.0
            x, y, z = sx + f * dx, sy + f * dy, sz + f * dz
            free = nearest_primitive(kinds, rows, discs, bodies, poses, x, y, z)[0] - radius
            if free <= 0.0:
                fractions[i] = f
                break
            if travelled >= length:
                break
            travelled += max(free, tolerance)
