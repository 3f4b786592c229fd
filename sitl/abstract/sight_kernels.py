"""Who sees whom, and what each knows of the others.

Scalar arithmetic only, in the common subset of compilers for processors and graphics cards.
"""

import math

from companion.compiled import portable, portable_inlined
from companion.messages import FloatArray
from sitl.abstract.grid_kernels import IndexArray
from sitl.worlds.raycast_kernels import ray_primitive, ray_sphere

_SIGHT_RAYS = 5
_SAME_PLACE_M = 1e-6


@portable_inlined
def up_of(q: FloatArray) -> tuple[float, float, float]:
    """Return the body z axis of an attitude (w, x, y, z)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)


@portable_inlined
def yaw_of(q: FloatArray) -> float:
    """Return the heading of an attitude (w, x, y, z), rad."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@portable_inlined
def _passes_near(
    disc: FloatArray, ox: float, oy: float, ex: float, ey: float, length: float, margin: float
) -> bool:
    """Whether a vertical cylinder comes within `margin` of a level line from o along the unit vector e."""
    x, y = disc[0] - ox, disc[1] - oy
    along = min(max(x * ex + y * ey, 0.0), length)
    x, y = x - along * ex, y - along * ey
    reach = disc[2] + margin
    return bool(x * x + y * y <= reach * reach)


@portable(
    "boolean(int64, int64, float64[:,::1], int32[::1], float64[:,::1], float64[:,::1], int32[::1], int64,"
    " float64, float64, float64, float64, int64)"
)
def sees(
    i: int,
    j: int,
    states: FloatArray,
    kinds: IndexArray,
    rows: FloatArray,
    discs: FloatArray,
    candidates: IndexArray,
    count: int,
    max_range: float,
    sine_lowest: float,
    sine_highest: float,
    body_radius: float,
    free_rays: int,
) -> bool:
    """Whether vehicle i can see vehicle j.

    Args:
        i: who looks.
        j: at whom.
        states: (n, 10) position (3), velocity (3), attitude (4) of all, world.
        kinds: (m,) kind of each primitive.
        rows: (m, 8) its shape.
        discs: (m, 3) its enclosing vertical cylinder.
        candidates: primitives that may be near i, the first `count` of them.
        count: how many.
        max_range: of sight, m.
        sine_lowest: sine of the lowest elevation, in the body's own axes, at which anything is seen.
        sine_highest: likewise the highest.
        body_radius: of the ball that stands for a vehicle, m.
        free_rays: of five rays, to the centre and to four points of the rim, so many must be free.
    """
    ox, oy, oz = states[i, 0], states[i, 1], states[i, 2]
    dx, dy, dz = states[j, 0] - ox, states[j, 1] - oy, states[j, 2] - oz
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if distance > max_range or distance < _SAME_PLACE_M:
        return False
    ux, uy, uz = up_of(states[i, 6:10])
    sine = (dx * ux + dy * uy + dz * uz) / distance
    if sine < sine_lowest or sine > sine_highest:
        return False
    flat = math.sqrt(dx * dx + dy * dy)
    ex, ey = (dx / flat, dy / flat) if flat > _SAME_PLACE_M else (1.0, 0.0)
    cosine, rise = flat / distance, dz / distance
    blocked = 0
    for ray in range(_SIGHT_RAYS):
        # Centre, left, right, above and below of the disc that faces the observer.
        side = body_radius if ray == 1 else (-body_radius if ray == 2 else 0.0)
        lift = body_radius if ray == 3 else (-body_radius if ray == 4 else 0.0)
        rx = dx - side * ey - lift * rise * ex
        ry = dy + side * ex - lift * rise * ey
        rz = dz + lift * cosine
        length = math.sqrt(rx * rx + ry * ry + rz * rz)
        rx, ry, rz = rx / length, ry / length, rz / length
        free = True
        for slot in range(count):
            k = candidates[slot]
            if _passes_near(discs[k], ox, oy, ex, ey, flat, body_radius) and (
                ray_primitive(kinds[k], rows[k], ox, oy, oz, rx, ry, rz) < length
            ):
                free = False
                break
        for k in range(states.shape[0]):
            if free and k != i and k != j:
                mx, my, mz = ox - states[k, 0], oy - states[k, 1], oz - states[k, 2]
                free = ray_sphere(mx, my, mz, rx, ry, rz, body_radius) >= length
        blocked += 0 if free else 1
        if blocked > _SIGHT_RAYS - free_rays:
            return False
        if ray + 1 - blocked >= free_rays:
            return True
    return False
