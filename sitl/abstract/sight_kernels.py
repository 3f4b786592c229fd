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
_WELL_CLEAR = 4.1


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
    # One bit for each ray that is blocked; each thing is looked at once, and most are nowhere near.
    blocked, most_blocked = 0, _SIGHT_RAYS - free_rays
    for slot in range(count + states.shape[0]):
        k = candidates[slot] if slot < count else slot - count
        if slot < count:
            if not _passes_near(discs[k], ox, oy, ex, ey, flat, body_radius):
                continue
        else:
            # No ray is farther than a body's radius from the line between the two.
            x, y, z = states[k, 0] - ox, states[k, 1] - oy, states[k, 2] - oz
            along = min(max((x * dx + y * dy + z * dz) / distance, 0.0), distance) / distance
            x, y, z = x - along * dx, y - along * dy, z - along * dz
            if x * x + y * y + z * z > _WELL_CLEAR * body_radius * body_radius:
                continue
            if k == i:
                continue
            if k == j:
                continue
        for ray in range(_SIGHT_RAYS):
            if blocked & (1 << ray):
                continue
            # Centre, left, right, above and below of the disc that faces the observer.
            side = body_radius if ray == 1 else (-body_radius if ray == 2 else 0.0)
            lift = body_radius if ray == 3 else (-body_radius if ray == 4 else 0.0)
            rx = dx - side * ey - lift * rise * ex
            ry = dy + side * ex - lift * rise * ey
            rz = dz + lift * cosine
            length = math.sqrt(rx * rx + ry * ry + rz * rz)
            rx, ry, rz = rx / length, ry / length, rz / length
            if slot < count:
                t = ray_primitive(kinds[k], rows[k], ox, oy, oz, rx, ry, rz)
            else:
                t = ray_sphere(
                    ox - states[k, 0], oy - states[k, 1], oz - states[k, 2], rx, ry, rz, body_radius
                )
            if t < length:
                blocked |= 1 << ray
                most_blocked -= 1
                if most_blocked < 0:
                    return False
    return True
