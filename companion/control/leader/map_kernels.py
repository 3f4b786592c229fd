"""Kernels of the obstacle map: hits and free rays of one scan, evidence, blocked columns, distances.

The map is a window of columns of voxels whose storage wraps around: voxel (i, j, k), counted in whole
voxels from the map's origin, lives at (i mod n, j mod n, k mod m). `first` holds the lowest voxel
inside the window; n and m are powers of two, so the remainder is a bit mask.
"""

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import FloatArray, PointArray

EVIDENCE_PER_HIT = 10
EVIDENCE_PER_PASS = 4
HITS_COUNTED_PER_SCAN = 3
EVIDENCE_OCCUPIED = 20
EVIDENCE_SUPPORTED = 40
_RAY_STOPS_SHORT_M = 0.3
_MAX_COORDINATE_M = 1e6
_LOWEST_SINE = math.sin(math.radians(-7.0))
_HIGHEST_SINE = math.sin(math.radians(52.0))

EvidenceArray = NDArray[np.int16]
ScanArray = NDArray[np.int8]
IndexArray = NDArray[np.int64]
FieldArray = NDArray[np.float32]
BlockedArray = NDArray[np.uint8]


@compiled("void(int16[:,:,::1], float32[:,:,::1], int64[::1], int64[::1])")
def slide_window(
    evidence: EvidenceArray, surface: FieldArray, first_old: IndexArray, first_new: IndexArray
) -> None:
    """Forget every voxel that belongs to the new window and was not part of the old one."""
    n = evidence.shape[0]
    m = evidence.shape[2]
    for i in range(first_new[0], first_new[0] + n):
        inside_i = first_old[0] <= i < first_old[0] + n
        for j in range(first_new[1], first_new[1] + n):
            ii = i & (n - 1)
            jj = j & (n - 1)
            if inside_i and first_old[1] <= j < first_old[1] + n:
                for k in range(first_new[2], first_new[2] + m):
                    if k < first_old[2] or k >= first_old[2] + m:
                        evidence[ii, jj, k & (m - 1)] = 0
            else:
                evidence[ii, jj, :] = 0
                surface[ii, jj, :] = 0.0


@compiled(
    "void(float32[:,::1], float64[::1], int64[::1], float64, float64, float64, float64, float64,"
    " int8[:,:,::1], float32[:,:,::1])"
)
def mark_hits(
    points_map: PointArray,
    p_map: FloatArray,
    first: IndexArray,
    cell: float,
    layer: float,
    reach: float,
    self_radius: float,
    floor_z: float,
    hits: ScanArray,
    sums: FieldArray,
) -> None:
    """Count one scan's returns per voxel (at most three) and sum their place within each column.

    Args:
        points_map: (n, 3) returns; those not finite are passed over.
        p_map: where the sensor was.
        first: lowest voxel of the window.
        cell: horizontal voxel size, m.
        layer: vertical voxel size, m.
        reach: greatest horizontal distance of a hit, m.
        self_radius: returns nearer than this are the vehicle itself, m.
        floor_z: returns lower than this are ground, m.
        hits: (n, n, m), zeroed on entry by the caller.
        sums: (n, n, 3), zeroed likewise: offsets from the column's centre (x, y) and the count.
    """
    n = hits.shape[0]
    m = hits.shape[2]
    for index in range(points_map.shape[0]):
        x = float(points_map[index, 0])
        y = float(points_map[index, 1])
        z = float(points_map[index, 2])
        dx = x - p_map[0]
        dy = y - p_map[1]
        dz = z - p_map[2]
        # Written so that a comparison with NaN drops the point.
        if not (dx * dx + dy * dy <= reach * reach and floor_z <= z <= _MAX_COORDINATE_M):
            continue
        if dx * dx + dy * dy + dz * dz < self_radius * self_radius:
            continue
        i = math.floor(x / cell)
        j = math.floor(y / cell)
        k = math.floor(z / layer)
        if k < first[2] or k >= first[2] + m:
            continue
        if i < first[0] or i >= first[0] + n or j < first[1] or j >= first[1] + n:
            continue
        ii = i & (n - 1)
        jj = j & (n - 1)
        kk = k & (m - 1)
        if hits[ii, jj, kk] < HITS_COUNTED_PER_SCAN:
            hits[ii, jj, kk] += 1
        sums[ii, jj, 0] += x - (i + 0.5) * cell
        sums[ii, jj, 1] += y - (j + 0.5) * cell
        sums[ii, jj, 2] += 1.0


@inlined
def _direction_bin(
    dx: float, dy: float, dz: float, length: float, rows: int, columns: int
) -> tuple[int, int]:
    """Return the row (elevation) and column (azimuth) of a direction, row -1 outside the image.

    Rows are even in the sine of the elevation, columns in dy / (|dx| + |dy|), which grows with the azimuth
    and needs no arc tangent.
    """
    row = math.floor((dz / length - _LOWEST_SINE) / (_HIGHEST_SINE - _LOWEST_SINE) * rows)
    if row < 0 or row >= rows:
        return -1, 0
    share = dy / max(abs(dx) + abs(dy), 1e-9)
    if dx < 0.0:
        turn = 2.0 - share
    elif dy < 0.0:
        turn = 4.0 + share
    else:
        turn = share
    return row, min(int(turn / 4.0 * columns), columns - 1)


@compiled("void(float32[:,::1], float64[::1], float64, float32[:,::1])")
def draw_ranges(points_map: PointArray, p_map: FloatArray, self_radius: float, image: FieldArray) -> None:
    """Draw the nearest return per direction.

    Args:
        points_map: (n, 3) returns, ground included; those not finite are passed over.
        p_map: where the sensor was.
        self_radius: returns nearer than this are the vehicle itself, m.
        image: (rows, columns) result, m; inf without return. Rows span the sensor's field of view.
    """
    rows = image.shape[0]
    columns = image.shape[1]
    image[:] = np.inf
    for index in range(points_map.shape[0]):
        dx = float(points_map[index, 0]) - p_map[0]
        dy = float(points_map[index, 1]) - p_map[1]
        dz = float(points_map[index, 2]) - p_map[2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if not (self_radius < length < _MAX_COORDINATE_M):
            continue
        row, column = _direction_bin(dx, dy, dz, length, rows, columns)
        if row >= 0 and length < image[row, column]:
            image[row, column] = length


@compiled(
    "void(int16[:,:,::1], int8[:,:,::1], float32[:,::1], float64[::1], int64[::1], float64, float64, int64)"
)
def update_evidence(
    evidence: EvidenceArray,
    hits: ScanArray,
    image: FieldArray,
    p_map: FloatArray,
    first: IndexArray,
    cell: float,
    layer: float,
    ceiling: int,
) -> None:
    """Raise the evidence of hit voxels, lower that of voxels that were looked through.

    A voxel whose direction returned only from farther away loses evidence fast; one in whose direction
    nothing returned at all fades; one that is hidden, or outside the field of view, is remembered. Evidence
    too weak to count always fades.

    Args:
        evidence: (n, n, m), changed in place.
        hits: (n, n, m) this scan's hits.
        image: nearest return per direction, from `draw_ranges`.
        p_map: where the sensor was.
        first: lowest voxel of the window.
        cell: horizontal voxel size, m.
        layer: vertical voxel size, m.
        ceiling: greatest evidence.
    """
    n = evidence.shape[0]
    m = evidence.shape[2]
    for ii in range(n):
        dx = (first[0] + ((ii - first[0]) & (n - 1)) + 0.5) * cell - p_map[0]
        for jj in range(n):
            dy = (first[1] + ((jj - first[1]) & (n - 1)) + 0.5) * cell - p_map[1]
            for kk in range(m):
                seen = int(hits[ii, jj, kk])
                if seen > 0:
                    evidence[ii, jj, kk] = min(evidence[ii, jj, kk] + EVIDENCE_PER_HIT * seen, ceiling)
                    continue
                present = int(evidence[ii, jj, kk])
                if present == 0:
                    continue
                dz = (first[2] + ((kk - first[2]) & (m - 1)) + 0.5) * layer - p_map[2]
                length = math.sqrt(dx * dx + dy * dy + dz * dz)
                row, column = _direction_bin(dx, dy, dz, length, image.shape[0], image.shape[1])
                loss = 1 if present < EVIDENCE_OCCUPIED else 0
                if row >= 0:
                    nearest = image[row, column]
                    if nearest == math.inf:
                        loss = 1
                    elif nearest > length + _RAY_STOPS_SHORT_M:
                        loss = EVIDENCE_PER_PASS
                evidence[ii, jj, kk] = max(present - loss, 0)


@compiled("void(float32[:,:,::1], float32[:,:,::1])")
def update_surface(surface: FieldArray, sums: FieldArray) -> None:
    """Take each hit column's mean place from this scan: whole if from three returns, else half."""
    for i in range(surface.shape[0]):
        for j in range(surface.shape[1]):
            count = sums[i, j, 2]
            if count > 0.0:
                weight = np.float32(1.0) if count >= 3.0 else np.float32(0.5)
                for axis in range(2):
                    mean = sums[i, j, axis] / count
                    surface[i, j, axis] += weight * (mean - surface[i, j, axis])


@compiled("void(int16[:,:,::1], float64[::1], int64[::1], float64, float64, float64)")
def forget_ball(
    evidence: EvidenceArray, p_map: FloatArray, first: IndexArray, cell: float, layer: float, radius: float
) -> None:
    """Clear the voxels whose centre is nearer to `p_map` than `radius`: the vehicle is there."""
    n = evidence.shape[0]
    m = evidence.shape[2]
    reach_cells = int(radius / cell) + 1
    reach_layers = int(radius / layer) + 1
    centre_i = math.floor(p_map[0] / cell)
    centre_j = math.floor(p_map[1] / cell)
    centre_k = math.floor(p_map[2] / layer)
    for i in range(centre_i - reach_cells, centre_i + reach_cells + 1):
        for j in range(centre_j - reach_cells, centre_j + reach_cells + 1):
            for k in range(centre_k - reach_layers, centre_k + reach_layers + 1):
                dx = (i + 0.5) * cell - p_map[0]
                dy = (j + 0.5) * cell - p_map[1]
                dz = (k + 0.5) * layer - p_map[2]
                if dx * dx + dy * dy + dz * dz < radius * radius and 0 <= k - first[2] < m:
                    evidence[i & (n - 1), j & (n - 1), k & (m - 1)] = 0


@compiled("void(int16[:,:,::1], int64[::1], int64, int64, uint8[:,::1])")
def block_columns(
    evidence: EvidenceArray, first: IndexArray, k_low: int, k_high: int, blocked: BlockedArray
) -> None:
    """Mark columns with an occupied, supported voxel between two layers (inclusive).

    A voxel counts when its own evidence is that of two returns and the 3 x 3 x 3 around it hold that of
    four, so that a lone spurious return blocks nothing. `blocked` is in window order: (0, 0) is `first`.
    """
    n = evidence.shape[0]
    m = evidence.shape[2]
    low = max(k_low, first[2])
    high = min(k_high, first[2] + m - 1)
    for i in range(n):
        for j in range(n):
            ii = (first[0] + i) & (n - 1)
            jj = (first[1] + j) & (n - 1)
            found = False
            for k in range(low, high + 1):
                if evidence[ii, jj, k & (m - 1)] < EVIDENCE_OCCUPIED:
                    continue
                support = 0
                for a in range(max(i - 1, 0), min(i + 2, n)):
                    for b in range(max(j - 1, 0), min(j + 2, n)):
                        for c in range(max(k - 1, first[2]), min(k + 2, first[2] + m)):
                            support += evidence[
                                (first[0] + a) & (n - 1), (first[1] + b) & (n - 1), c & (m - 1)
                            ]
                if support >= EVIDENCE_SUPPORTED:
                    found = True
                    break
            blocked[i, j] = 1 if found else 0


@compiled("void(uint8[:,::1], float64, int64, int32[:,::1], float32[:,::1])")
def measure_distances(
    blocked: BlockedArray, cell: float, cap_cells: int, rows: NDArray[np.int32], distance: FieldArray
) -> None:
    """Distance from every cell's centre to the nearest blocked centre, exact up to `cap_cells` cells.

    Args:
        blocked: (n, n) columns.
        cell: cell size, m.
        cap_cells: distances are cut at this many cells.
        rows: (n, n) scratch: squared distance along a row.
        distance: (n, n) result, m.
    """
    n = blocked.shape[0]
    cap_squared = np.int32(cap_cells * cap_cells)
    for i in range(n):
        last = -cap_cells
        for j in range(n):
            if blocked[i, j]:
                last = j
            gap = min(j - last, cap_cells)
            rows[i, j] = gap * gap
        last = n + cap_cells
        for j in range(n - 1, -1, -1):
            if blocked[i, j]:
                last = j
            gap = min(last - j, cap_cells)
            rows[i, j] = min(rows[i, j], np.int32(gap * gap))
    best = np.empty(n, np.int32)
    for i in range(n):
        best[:] = cap_squared
        for a in range(max(i - cap_cells + 1, 0), min(i + cap_cells, n)):
            offset = np.int32((a - i) * (a - i))
            for j in range(n):
                best[j] = min(best[j], rows[a, j] + offset)
        for j in range(n):
            distance[i, j] = np.float32(math.sqrt(best[j]) * cell)
