"""Hot loop of the obstacle grid: which cell a point falls into, and the nearest point of each cell."""

import numpy as np

from companion.compiled import compiled
from companion.messages import FloatArray, PointArray


@compiled(
    "int64(float32[:,::1], int32[::1], float64[::1], float64, float64[::1], float64[:,::1], float64,"
    " float64[:,::1])"
)
def nearest_ranges(
    points_map: PointArray,
    ages_ns: np.ndarray,
    p_map: FloatArray,
    yaw: float,
    limits: FloatArray,
    known: FloatArray,
    known_radius_m: float,
    ranges: FloatArray,
) -> int:
    """Find the nearest point in every cell of a grid of azimuth and elevation.

    Args:
        points_map: (n, 3) metres; points that are not finite are passed over.
        ages_ns: (n,) how long before the scan's end each point was measured.
        p_map: (3,) centre of the grid.
        yaw: heading of the grid's first azimuth, rad.
        limits: (5,) nearest and farthest range m, lowest height over the map's origin m, lowest and
            highest elevation rad.
        known: (m, 6) positions and velocities of bodies whose points are left out, at the scan's end.
        known_radius_m: how far from such a position a point still belongs to the body.
        ranges: (azimuths, elevations) receives the nearest range, infinity where nothing is.

    Returns:
        The number of points that fell into a cell.
    """
    azimuths, elevations = ranges.shape
    ranges[:, :] = np.inf
    near_square, far_square = limits[0] * limits[0], limits[1] * limits[1]
    cos_yaw, sin_yaw = np.cos(yaw), np.sin(yaw)
    per_azimuth = azimuths / (2.0 * np.pi)
    per_elevation = elevations / (limits[4] - limits[3])
    known_square = known_radius_m * known_radius_m
    used = 0
    for i in range(points_map.shape[0]):
        px, py, pz = (
            np.float64(points_map[i, 0]),
            np.float64(points_map[i, 1]),
            np.float64(points_map[i, 2]),
        )
        dx, dy, dz = px - p_map[0], py - p_map[1], pz - p_map[2]
        square = dx * dx + dy * dy + dz * dz
        # A comparison with NaN is false, so points that are not finite fall out here.
        if not (near_square <= square <= far_square and pz >= limits[2]):
            continue
        belongs = False
        age_s = ages_ns[i] * 1e-9
        for k in range(known.shape[0]):
            kx = px - known[k, 0] + known[k, 3] * age_s
            ky = py - known[k, 1] + known[k, 4] * age_s
            kz = pz - known[k, 2] + known[k, 5] * age_s
            if kx * kx + ky * ky + kz * kz <= known_square:
                belongs = True
                break
        if belongs:
            continue
        row = np.int64(np.floor((np.arctan2(dz, np.sqrt(dx * dx + dy * dy)) - limits[3]) * per_elevation))
        if row < 0 or row >= elevations:
            continue
        forward = cos_yaw * dx + sin_yaw * dy
        left = cos_yaw * dy - sin_yaw * dx
        angle = np.arctan2(left, forward)
        column = np.int64(np.floor(angle * per_azimuth)) % azimuths
        distance = np.sqrt(square)
        if distance < ranges[column, row]:
            ranges[column, row] = distance
        used += 1
    return used
