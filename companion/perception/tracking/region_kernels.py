"""Hot loops over all points near the sensor: which lie at a track, and what surrounds it.

Both first mark the cells of a coarse grid around the sensor that any track may reach; points elsewhere,
nearly all of them, cost one look-up. A track is a body that moves evenly: `age` seconds ago it was at
its centre minus its velocity times `age`.
"""

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import FloatArray, PointArray

GRID = 64
CELL_M = 0.75

# Columns of the surroundings of a body.
BODY = 0
BELOW = 1
ABOVE = 2
BESIDE = 3
SURROUNDINGS_WIDTH = 4


@inlined
def _mark(
    grid: NDArray[np.uint8],
    origin: FloatArray,
    centres: FloatArray,
    velocities: FloatArray,
    radii: FloatArray,
    max_age_s: float,
    value: int,
) -> None:
    """Set the cells that the bodies reach within `max_age_s`."""
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(centres.shape[0]):
        for c in range(3):
            now = centres[k, c] - origin[c]
            then = now - velocities[k, c] * max_age_s
            below = (min(now, then) - radii[k]) / CELL_M + 0.5 * GRID
            above = (max(now, then) + radii[k]) / CELL_M + 0.5 * GRID
            low[c] = int(min(max(math.floor(below), 0.0), GRID))
            high[c] = int(min(max(math.floor(above), -1.0), GRID - 1.0))
        for ix in range(low[0], high[0] + 1):
            for iy in range(low[1], high[1] + 1):
                for iz in range(low[2], high[2] + 1):
                    grid[ix, iy, iz] = value


@inlined
def _marked(grid: NDArray[np.uint8], origin: FloatArray, x: float, y: float, z: float) -> bool:
    ix = math.floor((x - origin[0]) / CELL_M + 0.5 * GRID)
    iy = math.floor((y - origin[1]) / CELL_M + 0.5 * GRID)
    iz = math.floor((z - origin[2]) / CELL_M + 0.5 * GRID)
    inside = 0 <= ix < GRID and 0 <= iy < GRID and 0 <= iz < GRID
    return bool(inside and grid[ix, iy, iz] != 0)


@compiled(
    "void(float32[:, ::1], float64[::1], float64[::1], float64[:, ::1], float64[:, ::1], float64[::1],"
    " uint8[:, :, ::1], int32[::1])"
)
def claim(
    points: PointArray,
    ages_s: FloatArray,
    origin: FloatArray,
    centres: FloatArray,
    velocities: FloatArray,
    radii: FloatArray,
    grid: NDArray[np.uint8],
    owners: NDArray[np.int32],
) -> None:
    """Give each point to the nearest body within its radius.

    Args:
        points: (n, 3) metres.
        ages_s: (n,) how long ago they were measured.
        origin: (3,) centre of the grid: the sensor.
        centres: (k, 3) of the bodies now.
        velocities: (k, 3) m/s.
        radii: (k,) metres.
        grid: (GRID, GRID, GRID) zeros, left as zeros.
        owners: (n,) out: index of the body, or -1.
    """
    oldest = 0.0
    for i in range(ages_s.shape[0]):
        oldest = max(oldest, ages_s[i])
    _mark(grid, origin, centres, velocities, radii, oldest, 1)
    for i in range(points.shape[0]):
        owners[i] = -1
        px, py, pz = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        if not _marked(grid, origin, px, py, pz):
            continue
        best = math.inf
        for k in range(centres.shape[0]):
            x = px - centres[k, 0] + velocities[k, 0] * ages_s[i]
            y = py - centres[k, 1] + velocities[k, 1] * ages_s[i]
            z = pz - centres[k, 2] + velocities[k, 2] * ages_s[i]
            square = x * x + y * y + z * z
            if square <= radii[k] * radii[k] and square < best:
                best = square
                owners[i] = k
    _mark(grid, origin, centres, velocities, radii, oldest, 0)


@compiled(
    "void(float32[:, ::1], float64[::1], int32[::1], float64[::1], float64[:, ::1], float64[:, ::1],"
    " int32[::1], float64, float64, float64, float64, uint8[::1], uint8[:, :, ::1], float64[:, ::1])"
)
def survey(
    points: PointArray,
    ages_s: FloatArray,
    owners: NDArray[np.int32],
    origin: FloatArray,
    centres: FloatArray,
    velocities: FloatArray,
    names: NDArray[np.int32],
    half_width_m: float,
    half_height_m: float,
    reach_m: float,
    beside_m: float,
    proven: NDArray[np.uint8],
    grid: NDArray[np.uint8],
    counts: FloatArray,
) -> None:
    """Count the points on and around each body; those of other proven bodies do not count.

    The body is an upright cylinder. Below and above it lies the same cylinder carried on by `reach_m`;
    beside it, the ring that is `beside_m` wider, as high as the body.

    Args:
        points: (n, 3) metres.
        ages_s: (n,) how long ago they were measured.
        owners: (n,) track each one lies at, or -1.
        origin: (3,) centre of the grid: the sensor.
        centres: (k, 3) of the bodies now.
        velocities: (k, 3) m/s.
        names: (k,) track that each body belongs to, or -1.
        half_width_m: radius of the cylinder, with some margin.
        half_height_m: half its height, with some margin.
        reach_m: see above.
        beside_m: see above.
        proven: (t,) 1 for tracks known to be UAVs.
        grid: (GRID, GRID, GRID) zeros, left as zeros.
        counts: (k, SURROUNDINGS_WIDTH) out.
    """
    counts[:] = 0.0
    oldest = 0.0
    for i in range(ages_s.shape[0]):
        oldest = max(oldest, ages_s[i])
    outer = half_width_m + beside_m
    radii = np.full(centres.shape[0], math.hypot(outer, half_height_m + reach_m))
    _mark(grid, origin, centres, velocities, radii, oldest, 1)
    for i in range(points.shape[0]):
        px, py, pz = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        if not _marked(grid, origin, px, py, pz):
            continue
        owner = owners[i]
        for k in range(centres.shape[0]):
            if owner >= 0 and owner != names[k] and proven[owner]:
                continue
            x = px - centres[k, 0] + velocities[k, 0] * ages_s[i]
            y = py - centres[k, 1] + velocities[k, 1] * ages_s[i]
            z = pz - centres[k, 2] + velocities[k, 2] * ages_s[i]
            flat = x * x + y * y
            if flat > outer * outer or abs(z) > half_height_m + reach_m:
                continue
            if flat <= half_width_m * half_width_m:
                counts[k, 0 if abs(z) <= half_height_m else 1 if z < 0.0 else 2] += 1.0
            elif abs(z) <= half_height_m:
                counts[k, 3] += 1.0
    _mark(grid, origin, centres, velocities, radii, oldest, 0)


@compiled("void(float32[:, ::1], float64[::1], float64[:, ::1], float64, float64, float64[::1])")
def shade(
    points: PointArray,
    origin: FloatArray,
    centres: FloatArray,
    half_width_m: float,
    gap_m: float,
    counts: FloatArray,
) -> None:
    """Count the points that stand before each body, or beside its outline, nearer to the sensor.

    Args:
        points: (n, 3) metres.
        origin: (3,) the sensor.
        centres: (k, 3) of the bodies.
        half_width_m: radius of the cone around a body, at its distance.
        gap_m: how much nearer a point must be.
        counts: (k,) out.
    """
    counts[:] = 0.0
    k_max = centres.shape[0]
    ux, uy, uz, far = np.empty(k_max), np.empty(k_max), np.empty(k_max), np.empty(k_max)
    for k in range(k_max):
        x, y, z = centres[k, 0] - origin[0], centres[k, 1] - origin[1], centres[k, 2] - origin[2]
        far[k] = max(math.sqrt(x * x + y * y + z * z), 1e-6)
        ux[k], uy[k], uz[k] = x / far[k], y / far[k], z / far[k]
    for i in range(points.shape[0]):
        x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        square = x * x + y * y + z * z
        for k in range(k_max):
            along = x * ux[k] + y * uy[k] + z * uz[k]
            if along <= 0.0 or along >= far[k] - gap_m:
                continue
            reach = half_width_m * along / far[k]
            if square - along * along < reach * reach:
                counts[k] += 1.0
