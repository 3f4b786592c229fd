"""Hot loops of registration: planes from the map, and their weighted normal equations."""

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import FloatArray
from companion.perception.odometry.plane_kernels import fit_plane
from companion.perception.odometry.voxel_kernels import FOUND_WIDTH, gather

PLANE_WIDTH = 8
"""Normal, offset, variance of the plane at the point, level (0 fine, 1 coarse, -1 none), when its place
in the map was first seen, and the weight that its residual received."""


@inlined
def _birth(found: FloatArray, count: int, born: NDArray[np.int64]) -> int:
    """Return when the block of the nearest point was first seen."""
    nearest = 0
    for i in range(1, count):
        if found[i, 4] < found[nearest, 4]:
            nearest = i
    return int(born[int(found[nearest, 5])])


@compiled(
    "int64(float64[:,::1], int64[::1], float64[::1],"
    " int64[::1], int32[::1], int64[::1], float32[:,:,::1], float64,"
    " int64[::1], int32[::1], int64[::1], float32[:,:,::1], float64, float64, boolean, float64[:,::1])"
)
def find_planes(
    points_imu: FloatArray,
    chosen: NDArray[np.int64],
    pose: FloatArray,
    fine_keys: NDArray[np.int64],
    fine_blocks: NDArray[np.int32],
    fine_born: NDArray[np.int64],
    fine_cells: NDArray[np.float32],
    fine_cell_m: float,
    coarse_keys: NDArray[np.int64],
    coarse_blocks: NDArray[np.int32],
    coarse_born: NDArray[np.int64],
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
        fine_born: when its blocks were first seen.
        fine_cells: its cells.
        fine_cell_m: edge of its cells.
        coarse_keys: table of the coarse map.
        coarse_blocks: its blocks.
        coarse_born: when its blocks were first seen.
        coarse_cells: its cells.
        coarse_cell_m: edge of its cells.
        thickness_m: largest standard deviation of map points from their plane.
        use_fine: whether to look into the fine map at all.
        planes: (>= m, 8) receives normal n and offset d (n . p_map + d = 0), the plane's variance, the
            level it came from (0 fine, 1 coarse, -1 none), and when the block of its nearest point was
            first seen.

    Returns:
        The number of planes found.
    """
    found = np.zeros((27, FOUND_WIDTH))
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
            plane[6] = _birth(found, count, fine_born)
        else:
            radius = 1.5 * coarse_cell_m
            count = gather(coarse_keys, coarse_blocks, coarse_cells, coarse_cell_m, radius, x, y, z, found)
            if count >= 5 and fit_plane(found, count, radius, eigen, plane) and plane[5] < thickness_m**2:
                level = 1
                plane[6] = _birth(found, count, coarse_born)
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
        planes: (>= m, 8) as from `find_planes`; receives each residual's weight, 0 where it was not used.
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
        planes[m, 7] = 0.0
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
        planes[m, 7] = weight
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


@compiled(
    "void(float64[:,::1], int64[::1], float64[:,::1], float64[::1], int64[::1], int64, float64[:,:,::1],"
    " float64[::1])"
)
def share_by_birth(
    points_imu: FloatArray,
    chosen: NDArray[np.int64],
    planes: FloatArray,
    pose: FloatArray,
    starts: NDArray[np.int64],
    count: int,
    information: FloatArray,
    weights: FloatArray,
) -> None:
    """Split the information of the residuals by when their planes were first seen.

    Args:
        points_imu: (n, 3) metres.
        chosen: (m,) indices into `points_imu`.
        planes: (>= m, 8) as `accumulate` left them.
        pose: (>= 12,) p_map, then R_map_imu by rows.
        starts: (>= count,) first birth of each period, ascending; all births lie after the first.
        count: number of periods.
        information: (>= count, 6, 6) receives H' W H of each period.
        weights: (>= count,) receives the sum of weights of each period.
    """
    information[:count] = 0.0
    weights[:count] = 0.0
    h = np.zeros(6)
    for m in range(chosen.shape[0]):
        weight = planes[m, 7]
        if weight == 0.0:
            continue
        low, high = 0, count
        while high - low > 1:
            middle = (low + high) >> 1
            if starts[middle] <= planes[m, 6]:
                low = middle
            else:
                high = middle
        i = chosen[m]
        x, y, z = points_imu[i, 0], points_imu[i, 1], points_imu[i, 2]
        nx, ny, nz = planes[m, 0], planes[m, 1], planes[m, 2]
        bx = pose[3] * nx + pose[6] * ny + pose[9] * nz
        by = pose[4] * nx + pose[7] * ny + pose[10] * nz
        bz = pose[5] * nx + pose[8] * ny + pose[11] * nz
        h[0], h[1], h[2] = nx, ny, nz
        h[3], h[4], h[5] = y * bz - z * by, z * bx - x * bz, x * by - y * bx
        part = information[low]
        for r in range(6):
            weighted = weight * h[r]
            for c in range(r + 1):
                part[r, c] += weighted * h[c]
        weights[low] += weight
    for k in range(count):
        for r in range(6):
            for c in range(r):
                information[k, c, r] = information[k, r, c]
