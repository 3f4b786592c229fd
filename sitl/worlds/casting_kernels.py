"""Nearest hits of many rays in a world of fixed primitives and moving bodies, with culling.

A body is a run of primitives in its own frame with a pose and an enclosing sphere. Rays that meet the
sphere are taken into the body's frame, so its parts tilt with it at no cost and are never rewritten.

A pose is a row of eight numbers: position (3), attitude quaternion (4), radius of the enclosing sphere.
"""

import math

import numpy as np

from companion.compiled import compiled, inlined
from companion.messages import FloatArray
from sitl.worlds.raycast_kernels import SECTORS, outward_normal, ray_primitive, sector_of, sector_span

RAYS_PER_BATCH = 1024
_CULLING_MARGIN_M = 1e-6


@inlined
def into_body(pose: FloatArray, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a world vector in the axes of a body."""
    w, a, b, c = pose[3], -pose[4], -pose[5], -pose[6]
    tx, ty, tz = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    return x + w * tx + b * tz - c * ty, y + w * ty + c * tx - a * tz, z + w * tz + a * ty - b * tx


@inlined
def misses_sphere(
    mx: float, my: float, mz: float, dx: float, dy: float, dz: float, radius: float, nearest: float
) -> bool:
    """Return whether a ray misses a sphere or meets it farther away than `nearest`; m as for `ray_sphere`."""
    c = mx * mx + my * my + mz * mz - radius * radius
    if c <= 0.0:
        return False
    half_b = mx * dx + my * dy + mz * dz
    discriminant = half_b * half_b - c
    return half_b > 0.0 or discriminant < 0.0 or -half_b - math.sqrt(discriminant) > nearest


@inlined
def cast_at_body(
    pose: FloatArray,
    first: int,
    end: int,
    kinds: np.ndarray[tuple[int], np.dtype[np.int32]],
    rows: FloatArray,
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, nearest: float,
) -> tuple[float, int, float]:  # fmt: skip
    """Return (range, part, cosine of incidence) of a hit nearer than `nearest`; the part is -1 if none."""
    mx, my, mz = ox - pose[0], oy - pose[1], oz - pose[2]
    if misses_sphere(mx, my, mz, dx, dy, dz, pose[7], nearest):
        return nearest, -1, 0.0
    px, py, pz = into_body(pose, mx, my, mz)
    ex, ey, ez = into_body(pose, dx, dy, dz)
    hit = -1
    for part in range(first, end):
        t = ray_primitive(kinds[part], rows[part], px, py, pz, ex, ey, ez)
        if t < nearest:
            nearest, hit = t, part
    if hit < 0:
        return nearest, -1, 0.0
    nx, ny, nz = outward_normal(
        kinds[hit], rows[hit], px + nearest * ex, py + nearest * ey, pz + nearest * ez
    )
    return nearest, hit, min(abs(nx * ex + ny * ey + nz * ez), 1.0)


@compiled("void(int64[::1], float64[:, ::1], float64[::1], float64[::1], float64[::1], float64[:, ::1])")
def turn_rods(
    numbers: np.ndarray[tuple[int], np.dtype[np.int64]],
    hubs: FloatArray,
    half_lengths: FloatArray,
    cosines: FloatArray,
    sines: FloatArray,
    rows: FloatArray,
) -> None:
    """Turn level rods about their middles.

    Args:
        numbers: (s,) of the rods.
        hubs: (s, 3) their middles.
        half_lengths: (s,) half of their lengths, m.
        cosines: (s,) of their headings.
        sines: (s,) of their headings.
        rows: (m, 8) of all primitives, changed in place.
    """
    for i in range(numbers.shape[0]):
        row, half = rows[numbers[i]], half_lengths[i]
        row[0], row[1], row[2] = hubs[i, 0] - half * cosines[i], hubs[i, 1] - half * sines[i], hubs[i, 2]
        row[3], row[4], row[5] = cosines[i], sines[i], 0.0


@inlined
def list_candidates(
    origins: FloatArray, start: int, end: int, discs: FloatArray, poses: FloatArray, max_range: float
) -> tuple[
    FloatArray, np.ndarray[tuple[int], np.dtype[np.int64]], np.ndarray[tuple[int], np.dtype[np.int32]]
]:
    """Return what rays from `origins[start:end]` can meet, by horizontal sector, nearest first.

    Returns:
        (things,) least horizontal distance of each fixed primitive and body; (SECTORS + 1,) where each
        sector's candidates begin; the candidates' numbers.
    """
    n_fixed = discs.shape[0]
    n_things = n_fixed + poses.shape[0]
    gaps = np.empty(n_things)
    firsts = np.empty(n_things, np.int64)
    spans = np.empty(n_things, np.int64)
    low_x, high_x = origins[start, 0], origins[start, 0]
    low_y, high_y = origins[start, 1], origins[start, 1]
    for i in range(start + 1, end):
        low_x, high_x = min(low_x, origins[i, 0]), max(high_x, origins[i, 0])
        low_y, high_y = min(low_y, origins[i, 1]), max(high_y, origins[i, 1])
    centre_x, centre_y = 0.5 * (low_x + high_x), 0.5 * (low_y + high_y)
    spread = 0.5 * math.hypot(high_x - low_x, high_y - low_y) + _CULLING_MARGIN_M

    offsets = np.zeros(SECTORS + 1, np.int64)
    for k in range(n_things):
        if k < n_fixed:
            x, y, radius = discs[k, 0], discs[k, 1], discs[k, 2]
        else:
            x, y, radius = poses[k - n_fixed, 0], poses[k - n_fixed, 1], poses[k - n_fixed, 7]
        x, y, radius = x - centre_x, y - centre_y, radius + spread
        distance = math.hypot(x, y)
        gaps[k] = max(distance - radius, 0.0)
        spans[k] = 0
        if gaps[k] <= max_range:
            firsts[k], spans[k] = sector_span(x, y, distance, radius)
        for sector in range(firsts[k], firsts[k] + spans[k]):
            offsets[(sector & (SECTORS - 1)) + 1] += 1
    for sector in range(SECTORS):
        offsets[sector + 1] += offsets[sector]
    candidates = np.empty(offsets[SECTORS], np.int32)
    filled = offsets[:SECTORS].copy()
    for k in np.argsort(gaps):
        for sector in range(firsts[k], firsts[k] + spans[k]):
            candidates[filled[sector & (SECTORS - 1)]] = k
            filled[sector & (SECTORS - 1)] += 1
    return gaps, offsets, candidates


@inlined
def nearest_hit(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float,
    gaps: FloatArray,
    offsets: np.ndarray[tuple[int], np.dtype[np.int64]],
    candidates: np.ndarray[tuple[int], np.dtype[np.int32]],
    n_fixed: int,
    kinds: np.ndarray[tuple[int], np.dtype[np.int32]],
    rows: FloatArray,
    bodies: np.ndarray[tuple[int, int], np.dtype[np.int32]],
    poses: FloatArray,
    max_range: float,
) -> tuple[float, int, float]:  # fmt: skip
    """Return (range, primitive, cosine of incidence) of one ray's nearest hit; infinity, -1, 0 if none."""
    horizontal = math.sqrt(dx * dx + dy * dy)
    best, reach, hit, cosine = max_range, max_range * horizontal, -1, 0.0
    sector = sector_of(dx, dy)
    for slot in range(offsets[sector], offsets[sector + 1]):
        k = candidates[slot]
        if gaps[k] > reach:
            break
        if k < n_fixed:
            t = ray_primitive(kinds[k], rows[k], ox, oy, oz, dx, dy, dz)
            if t < best:
                best, reach, hit = t, t * horizontal, k
        else:
            b = k - n_fixed
            t, part, c = cast_at_body(
                poses[b], bodies[b, 0], bodies[b, 1], kinds, rows, ox, oy, oz, dx, dy, dz, best
            )
            if part >= 0:
                best, reach, hit, cosine = t, t * horizontal, part, c
    if hit < 0:
        return math.inf, -1, 0.0
    if hit < n_fixed:
        nx, ny, nz = outward_normal(kinds[hit], rows[hit], ox + best * dx, oy + best * dy, oz + best * dz)
        cosine = min(abs(nx * dx + ny * dy + nz * dz), 1.0)
    return best, hit, cosine


@compiled(
    "void(float64[:, ::1], float64[:, ::1], int32[::1], float64[:, ::1], float64[:, ::1], int32[:, ::1], "
    "float64[:, ::1], float64, float64[::1], int32[::1], float64[::1])"
)
def cast_rays(
    origins: FloatArray,
    directions: FloatArray,
    kinds: np.ndarray[tuple[int], np.dtype[np.int32]],
    rows: FloatArray,
    discs: FloatArray,
    bodies: np.ndarray[tuple[int, int], np.dtype[np.int32]],
    poses: FloatArray,
    max_range: float,
    ranges: FloatArray,
    indices: np.ndarray[tuple[int], np.dtype[np.int32]],
    cosines: FloatArray,
) -> None:
    """Find the nearest hit of each ray (world frame).

    Rays that follow each other should start near each other: candidates are listed by horizontal
    sector once per 1024 rays, as seen from the middle of their origins. Scattered origins stay
    correct but are slow.

    Args:
        origins: (n, 3) metres.
        directions: (n, 3) unit vectors.
        kinds: (m,) kind of each primitive, the bodies' parts last.
        rows: (m, 8) its shape; of a body's part in the body's frame.
        discs: (f, 3) x, y and radius of a vertical cylinder around each of the f fixed primitives
            (radius may be infinite).
        bodies: (b, 2) first part of each body and one past its last.
        poses: (b, 8) where they are.
        max_range: hits farther away are ignored, metres.
        ranges: (n,) out, metres; infinity without a hit.
        indices: (n,) out, primitive hit, -1 without a hit.
        cosines: (n,) out, absolute cosine of the angle of incidence, 0 without a hit.
    """
    for start in range(0, origins.shape[0], RAYS_PER_BATCH):
        end = min(start + RAYS_PER_BATCH, origins.shape[0])
        gaps, offsets, candidates = list_candidates(origins, start, end, discs, poses, max_range)
        for i in range(start, end):
            ranges[i], indices[i], cosines[i] = nearest_hit(
                origins[i, 0], origins[i, 1], origins[i, 2],
                directions[i, 0], directions[i, 1], directions[i, 2],
                gaps, offsets, candidates, discs.shape[0], kinds, rows, bodies, poses, max_range,
            )  # fmt: skip
