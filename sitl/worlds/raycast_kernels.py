"""Rays against single primitives: distances, normals and the sectors in which a thing can be seen.

A primitive is a kind and one row of eight numbers (see `sitl.worlds.primitives`):

====  ========  ==================================================================
kind  name      row
====  ========  ==================================================================
0     plane     0, 0, height, 0, 0, 0, 0, 0
1     sphere    centre (3), 0, 0, 0, 0, radius
2     cylinder  centre of one cap (3), unit axis (3), length, radius
3     capsule   centre of one end (3), unit axis (3), length, radius
4     box       centre (3), half extents (3), cosine and sine of its yaw
====  ========  ==================================================================

The scalar functions use only what the CPU and CUDA targets of Numba share. Distances along a ray are
in metres (directions are unit vectors); infinity means no hit. Surfaces are hit from both sides.
"""

import math

from companion.compiled import portable_inlined
from companion.messages import FloatArray

PLANE = 0
SPHERE = 1
CYLINDER = 2
CAPSULE = 3
BOX = 4

NEAREST_HIT_M = 1e-6
_PARALLEL = 1e-12
SECTORS = 256


@portable_inlined
def _first_of(t_near: float, t_far: float) -> float:
    """Return the smaller of two ordered distances that lies in front of the ray's origin."""
    if t_near > NEAREST_HIT_M:
        return t_near
    if t_far > NEAREST_HIT_M:
        return t_far
    return math.inf


@portable_inlined
def ray_plane(oz: float, dz: float, height: float) -> float:
    """Return the distance to a horizontal plane."""
    if abs(dz) < _PARALLEL:
        return math.inf
    t = (height - oz) / dz
    return t if t > NEAREST_HIT_M else math.inf


@portable_inlined
def ray_sphere(mx: float, my: float, mz: float, dx: float, dy: float, dz: float, radius: float) -> float:
    """Return the distance to a sphere; m is the ray's origin seen from the centre."""
    half_b = mx * dx + my * dy + mz * dz
    c = mx * mx + my * my + mz * mz - radius * radius
    if c > 0.0 and half_b > 0.0:
        return math.inf
    discriminant = half_b * half_b - c
    if discriminant < 0.0:
        return math.inf
    root = math.sqrt(discriminant)
    return _first_of(-half_b - root, -half_b + root)


@portable_inlined
def _sphere_beyond(
    mx: float, my: float, mz: float, dx: float, dy: float, dz: float, md: float, dd: float, radius: float
) -> float:
    """Return the distance to the half of a sphere where the axial coordinate md + t dd is positive."""
    half_b = mx * dx + my * dy + mz * dz
    discriminant = half_b * half_b - (mx * mx + my * my + mz * mz - radius * radius)
    if discriminant < 0.0:
        return math.inf
    root = math.sqrt(discriminant)
    t = -half_b - root
    if t > NEAREST_HIT_M and md + t * dd > 0.0:
        return t
    t = -half_b + root
    if t > NEAREST_HIT_M and md + t * dd > 0.0:
        return t
    return math.inf


@portable_inlined
def ray_rod(
    mx: float, my: float, mz: float, dx: float, dy: float, dz: float,
    ux: float, uy: float, uz: float, length: float, radius: float, rounded: bool,
) -> float:  # fmt: skip
    """Return the distance to a cylinder with flat caps or, if `rounded`, to a capsule.

    m is the ray's origin seen from the centre of the first end; u the unit axis towards the other end.
    """
    md = mx * ux + my * uy + mz * uz
    dd = dx * ux + dy * uy + dz * uz
    mm = mx * mx + my * my + mz * mz
    mdir = mx * dx + my * dy + mz * dz
    a = 1.0 - dd * dd
    half_b = mdir - md * dd
    c = mm - md * md - radius * radius
    if c > 0.0 and half_b >= 0.0:
        return math.inf  # outside the endless cylinder and not approaching its axis
    best = math.inf
    if a > _PARALLEL:
        discriminant = half_b * half_b - a * c
        if discriminant < 0.0:
            return math.inf
        root = math.sqrt(discriminant)
        t = (-half_b - root) / a
        axial = md + t * dd
        if t > NEAREST_HIT_M and axial >= 0.0 and axial <= length:
            best = t
        else:
            t = (-half_b + root) / a
            axial = md + t * dd
            if t > NEAREST_HIT_M and axial >= 0.0 and axial <= length:
                best = t
    elif c > 0.0:
        return math.inf
    if rounded:
        best = min(best, _sphere_beyond(mx, my, mz, dx, dy, dz, -md, -dd, radius))
        qx, qy, qz = mx - length * ux, my - length * uy, mz - length * uz
        return min(best, _sphere_beyond(qx, qy, qz, dx, dy, dz, md - length, dd, radius))
    if abs(dd) > _PARALLEL:
        t = -md / dd
        if t > NEAREST_HIT_M and t < best and mm + t * (2.0 * mdir + t) <= radius * radius:
            best = t
        t = (length - md) / dd
        square = mm + t * (2.0 * mdir + t) - length * length
        if t > NEAREST_HIT_M and t < best and square <= radius * radius:
            best = t
    return best


@portable_inlined
def ray_box(
    mx: float, my: float, mz: float, dx: float, dy: float, dz: float,
    hx: float, hy: float, hz: float, cos_yaw: float, sin_yaw: float,
) -> float:  # fmt: skip
    """Return the distance to a box turned about the vertical; m is the ray's origin seen from its centre."""
    px, py = cos_yaw * mx + sin_yaw * my, cos_yaw * my - sin_yaw * mx
    ex, ey = cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx
    t_near, t_far = -math.inf, math.inf
    if abs(ex) < _PARALLEL:
        if abs(px) > hx:
            return math.inf
    else:
        t_low, t_high = (-hx - px) / ex, (hx - px) / ex
        t_near, t_far = max(t_near, min(t_low, t_high)), min(t_far, max(t_low, t_high))
    if abs(ey) < _PARALLEL:
        if abs(py) > hy:
            return math.inf
    else:
        t_low, t_high = (-hy - py) / ey, (hy - py) / ey
        t_near, t_far = max(t_near, min(t_low, t_high)), min(t_far, max(t_low, t_high))
    if abs(dz) < _PARALLEL:
        if abs(mz) > hz:
            return math.inf
    else:
        t_low, t_high = (-hz - mz) / dz, (hz - mz) / dz
        t_near, t_far = max(t_near, min(t_low, t_high)), min(t_far, max(t_low, t_high))
    if t_near > t_far:
        return math.inf
    return _first_of(t_near, t_far)


@portable_inlined
def ray_primitive(
    kind: int, row: FloatArray, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> float:
    """Return the distance along a ray to one primitive."""
    if kind == PLANE:
        return ray_plane(oz, dz, row[2])
    mx, my, mz = ox - row[0], oy - row[1], oz - row[2]
    if kind == SPHERE:
        return ray_sphere(mx, my, mz, dx, dy, dz, row[7])
    if kind == BOX:
        return ray_box(mx, my, mz, dx, dy, dz, row[3], row[4], row[5], row[6], row[7])
    rounded = kind == CAPSULE
    return ray_rod(mx, my, mz, dx, dy, dz, row[3], row[4], row[5], row[6], row[7], rounded)


@portable_inlined
def outward_normal(kind: int, row: FloatArray, px: float, py: float, pz: float) -> tuple[float, float, float]:
    """Return the unit normal at a point on a primitive's surface."""
    if kind == PLANE:
        return 0.0, 0.0, 1.0
    mx, my, mz = px - row[0], py - row[1], pz - row[2]
    if kind == BOX:
        cos_yaw, sin_yaw = row[6], row[7]
        bx, by = cos_yaw * mx + sin_yaw * my, cos_yaw * my - sin_yaw * mx
        ex, ey, ez = abs(bx) - row[3], abs(by) - row[4], abs(mz) - row[5]
        if ez >= ex and ez >= ey:
            return 0.0, 0.0, math.copysign(1.0, mz)
        if ex >= ey:
            sign = math.copysign(1.0, bx)
            return sign * cos_yaw, sign * sin_yaw, 0.0
        sign = math.copysign(1.0, by)
        return -sign * sin_yaw, sign * cos_yaw, 0.0
    if kind != SPHERE:
        ux, uy, uz, length = row[3], row[4], row[5], row[6]
        axial = mx * ux + my * uy + mz * uz
        foot = min(max(axial, 0.0), length) if kind == CAPSULE else axial
        mx, my, mz = mx - foot * ux, my - foot * uy, mz - foot * uz
        if kind == CYLINDER:
            to_side = abs(math.sqrt(mx * mx + my * my + mz * mz) - row[7])
            if abs(axial) < to_side:
                return -ux, -uy, -uz
            if abs(axial - length) < to_side:
                return ux, uy, uz
    scale = 1.0 / max(math.sqrt(mx * mx + my * my + mz * mz), 1e-30)
    return mx * scale, my * scale, mz * scale


@portable_inlined
def sector_of(x: float, y: float) -> int:
    """Return the horizontal sector (0 to 255) of a direction; monotone in azimuth, without trigonometry."""
    size = abs(x) + abs(y)
    if size == 0.0:
        return 0
    turn = x / size
    quarter = 1.0 - turn if y >= 0.0 else 3.0 + turn  # 0 at +x, 1 at +y, 2 at -x, 3 at -y
    return int(quarter * (0.25 * SECTORS)) & (SECTORS - 1)


@portable_inlined
def sector_span(x: float, y: float, distance: float, radius: float) -> tuple[int, int]:
    """Return (first, number) of the sectors from which a disc at (x, y) can be seen."""
    if not distance > radius:
        return 0, SECTORS
    sine = radius / distance
    cosine = math.sqrt(1.0 - sine * sine)
    first = sector_of(x * cosine + y * sine, y * cosine - x * sine)
    last = sector_of(x * cosine - y * sine, y * cosine + x * sine)
    return first, ((last - first) & (SECTORS - 1)) + 1
