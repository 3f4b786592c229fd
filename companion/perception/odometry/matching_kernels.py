"""Hot loops of registration: planes from the map, and their weighted normal equations."""

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import FloatArray
from companion.perception.odometry.voxel_kernels import gather

PLANE_WIDTH = 6  # normal, offset, variance of the plane at the point, level (0 fine, 1 coarse, -1 none)


@inlined
def smallest_eigenvector(
    xx: float, xy: float, xz: float, yy: float, yz: float, zz: float, result: FloatArray
) -> None:
    """Decompose a symmetric 3x3 matrix.

    Source: O. Smith, "Eigenvalues of a symmetric 3 x 3 matrix", CACM 4(4), 1961.

    Args:
        xx: entry (0, 0).
        xy: entry (0, 1).
        xz: entry (0, 2).
        yy: entry (1, 1).
        yz: entry (1, 2).
        zz: entry (2, 2).
        result: (6,) receives the unit eigenvector of the smallest eigenvalue, then the eigenvalues
            ascending; a zero vector where the smallest is not unique.
    """
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    p2 = (a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0
    p = np.sqrt(p2)
    result[0], result[1], result[2] = 0.0, 0.0, 0.0
    result[3], result[4], result[5] = mean, mean, mean
    if not p > 1e-12:
        return
    determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    cosine = min(1.0, max(-1.0, determinant / (2.0 * p * p2)))
    angle = np.arccos(cosine) / 3.0
    high = mean + 2.0 * p * np.cos(angle)
    low = mean + 2.0 * p * np.cos(angle + 2.0943951023931953)
    result[3], result[4], result[5] = low, 3.0 * mean - high - low, high
    # Columns of (A - low I) span the other two eigenvectors: their cross products give the third.
    a, b, c = xx - low, yy - low, zz - low
    x0, y0, z0 = xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy
    x1, y1, z1 = xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz
    x2, y2, z2 = b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz
    n0, n1, n2 = x0 * x0 + y0 * y0 + z0 * z0, x1 * x1 + y1 * y1 + z1 * z1, x2 * x2 + y2 * y2 + z2 * z2
    if n0 >= n1 and n0 >= n2:
        x, y, z, square = x0, y0, z0, n0
    elif n1 >= n2:
        x, y, z, square = x1, y1, z1, n1
    else:
        x, y, z, square = x2, y2, z2, n2
    if square > 0.0:
        scale = 1.0 / np.sqrt(square)
        result[0], result[1], result[2] = x * scale, y * scale, z * scale


@inlined
def fit_plane(found: FloatArray, count: int, radius_m: float, eigen: FloatArray, plane: FloatArray) -> bool:
    """Fit a plane to fused points around the origin, nearer and better settled ones counting more.

    Args:
        found: (>= count, 5) offsets, numbers of points and squared distances.
        count: how many.
        radius_m: distance at which a point's weight reaches zero.
        eigen: (6,) scratch.
        plane: (6,) receives normal, its product with the centroid's offset, and in place 4 the
            variance of the plane at the origin.

    Returns:
        Whether the points determine a plane.
    """
    inverse = 1.0 / (radius_m * radius_m)
    total, squares = 0.0, 0.0
    cx, cy, cz = 0.0, 0.0, 0.0
    for i in range(count):
        weight = (1.0 - found[i, 4] * inverse) * found[i, 3] / (found[i, 3] + 4.0)
        found[i, 3] = weight
        total += weight
        squares += weight * weight
        cx += weight * found[i, 0]
        cy += weight * found[i, 1]
        cz += weight * found[i, 2]
    if not total > 1e-6:
        return False
    cx, cy, cz = cx / total, cy / total, cz / total
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        dx, dy, dz = found[i, 0] - cx, found[i, 1] - cy, found[i, 2] - cz
        weight = found[i, 3] / total
        xx += weight * dx * dx
        xy += weight * dx * dy
        xz += weight * dx * dz
        yy += weight * dy * dy
        yz += weight * dy * dz
        zz += weight * dz * dz
    smallest_eigenvector(xx, xy, xz, yy, yz, zz, eigen)
    low, middle, high = max(eigen[3], 0.0), eigen[4], eigen[5]
    # A line, or a blob, is no plane.
    if middle < 0.08 * high or low > 0.2 * middle:
        return False
    nx, ny, nz = eigen[0], eigen[1], eigen[2]
    effective = total * total / squares
    distance = nx * cx + ny * cy + nz * cz
    lever = cx * cx + cy * cy + cz * cz - distance * distance
    plane[0], plane[1], plane[2], plane[3] = nx, ny, nz, -distance
    plane[4] = low * (1.0 + lever / middle) * (1.0 / max(effective - 2.0, 1.0))
    plane[5] = low
    return True


@compiled(
    "int64(float64[:,::1], int64[::1], float64[::1], int64[::1], int32[::1], float32[:,:,::1], float64,"
    " int64[::1], int32[::1], float32[:,:,::1], float64, float64, boolean, float64[:,::1])"
)
def find_planes(
    points_imu: FloatArray,
    chosen: NDArray[np.int64],
    pose: FloatArray,
    fine_keys: NDArray[np.int64],
    fine_blocks: NDArray[np.int32],
    fine_cells: NDArray[np.float32],
    fine_cell_m: float,
    coarse_keys: NDArray[np.int64],
    coarse_blocks: NDArray[np.int32],
    coarse_cells: NDArray[np.float32],
    coarse_cell_m: float,
    thickness_m: float,
    use_fine: bool,
    planes: FloatArray,
) -> int:
    """Find for each chosen point the plane of the map around it, in the fine map or else the coarse.

    Args:
        points_imu: (n, 3) metres.
        chosen: (m,) indices into `points_imu`.
        pose: (>= 12,) p_map, then R_map_imu by rows.
        fine_keys: table of the fine map, see `voxel_kernels.insert`.
        fine_blocks: its blocks.
        fine_cells: its cells.
        fine_cell_m: edge of its cells.
        coarse_keys: table of the coarse map.
        coarse_blocks: its blocks.
        coarse_cells: its cells.
        coarse_cell_m: edge of its cells.
        thickness_m: largest standard deviation of map points from their plane.
        use_fine: whether to look into the fine map at all.
        planes: (>= m, 6) receives normal n and offset d (n . p_map + d = 0), the plane's variance,
            and the level it came from: 0 fine, 1 coarse, -1 none.

    Returns:
        The number of planes found.
    """
    found = np.zeros((27, 5))
    eigen = np.zeros(6)
    total = 0
    for m in range(chosen.shape[0]):
        i = chosen[m]
        px, py, pz = points_imu[i, 0], points_imu[i, 1], points_imu[i, 2]
        x = pose[0] + pose[3] * px + pose[4] * py + pose[5] * pz
        y = pose[1] + pose[6] * px + pose[7] * py + pose[8] * pz
        z = pose[2] + pose[9] * px + pose[10] * py + pose[11] * pz
        plane = planes[m]
        level = -1
        radius = 1.5 * fine_cell_m
        count = 0
        if use_fine:
            count = gather(fine_keys, fine_blocks, fine_cells, fine_cell_m, radius, x, y, z, found)
        if count >= 5 and fit_plane(found, count, radius, eigen, plane) and plane[5] < thickness_m**2:
            level = 0
        else:
            radius = 1.5 * coarse_cell_m
            count = gather(coarse_keys, coarse_blocks, coarse_cells, coarse_cell_m, radius, x, y, z, found)
            if count >= 5 and fit_plane(found, count, radius, eigen, plane) and plane[5] < thickness_m**2:
                level = 1
        plane[5] = level
        if level >= 0:
            plane[3] -= plane[0] * x + plane[1] * y + plane[2] * z
            total += 1
    return total


@compiled(
    "int64(float64[:,::1], int64[::1], float64[:,::1], float64[::1], float64[:,::1], float64, float64,"
    " float64, float64[:,::1], float64[::1], float64[::1])"
)
def accumulate(
    points_imu: FloatArray,
    chosen: NDArray[np.int64],
    planes: FloatArray,
    pose: FloatArray,
    pose_covariance: FloatArray,
    range_variance: float,
    angle_variance: float,
    map_variance: float,
    information: FloatArray,
    gradient: FloatArray,
    statistics: FloatArray,
) -> int:
    """Sum the weighted normal equations of the point-to-plane residuals for (p, theta).

    The residual is n . (R x + p) + d with derivatives n and x cross R' n. Source: W. Xu et al.,
    "FAST-LIO2", 2022, equations 12-14. Residuals beyond three standard deviations of what state and
    measurement allow are left out, the others weighted after Cauchy.

    Args:
        points_imu: (n, 3) metres.
        chosen: (m,) indices into `points_imu`.
        planes: (>= m, 6) as from `find_planes`.
        pose: (>= 12,) p_map, then R_map_imu by rows.
        pose_covariance: (6, 6) of the prediction, for the gate.
        range_variance: m^2.
        angle_variance: rad^2.
        map_variance: m^2.
        information: (6, 6) receives H' W H.
        gradient: (6,) receives -H' W r.
        statistics: (4,) receives the weighted sum of squared residuals, the sum of weights, the sum of
            squared lever arms |x cross R' n|^2 times weight, and the sum of normalised squares.

    Returns:
        The number of residuals used.
    """
    information[:, :] = 0.0
    gradient[:] = 0.0
    statistics[:] = 0.0
    h = np.zeros(6)
    used = 0
    for m in range(chosen.shape[0]):
        if planes[m, 5] < 0.0:
            continue
        i = chosen[m]
        x, y, z = points_imu[i, 0], points_imu[i, 1], points_imu[i, 2]
        nx, ny, nz = planes[m, 0], planes[m, 1], planes[m, 2]
        residual = planes[m, 3]
        residual += nx * (pose[0] + pose[3] * x + pose[4] * y + pose[5] * z)
        residual += ny * (pose[1] + pose[6] * x + pose[7] * y + pose[8] * z)
        residual += nz * (pose[2] + pose[9] * x + pose[10] * y + pose[11] * z)
        bx = pose[3] * nx + pose[6] * ny + pose[9] * nz
        by = pose[4] * nx + pose[7] * ny + pose[10] * nz
        bz = pose[5] * nx + pose[8] * ny + pose[11] * nz
        h[0], h[1], h[2] = nx, ny, nz
        h[3], h[4], h[5] = y * bz - z * by, z * bx - x * bz, x * by - y * bx
        square = x * x + y * y + z * z
        along = bx * x + by * y + bz * z
        cosine2 = along * along / max(square, 1e-6)
        variance = range_variance * cosine2 + angle_variance * (square - along * along)
        variance += map_variance + planes[m, 4]
        allowed = variance
        for r in range(6):
            for c in range(6):
                allowed += h[r] * pose_covariance[r, c] * h[c]
        if residual * residual > 9.0 * allowed:
            continue
        normalised = residual * residual / variance
        weight = 1.0 / (variance * (1.0 + normalised / 4.0))
        for r in range(6):
            weighted = weight * h[r]
            gradient[r] -= weighted * residual
            for c in range(r + 1):
                information[r, c] += weighted * h[c]
        statistics[0] += weight * residual * residual
        statistics[1] += weight
        statistics[2] += weight * (h[3] * h[3] + h[4] * h[4] + h[5] * h[5])
        statistics[3] += normalised
        used += 1
    for r in range(6):
        for c in range(r):
            information[c, r] = information[r, c]
    return used
