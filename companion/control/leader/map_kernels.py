"""Kernels of the obstacle map: hits and free rays of one scan, evidence, blocked columns, distances.

The map is a window of columns of voxels whose storage wraps around: voxel (i, j, k), counted in whole
voxels from the map's origin, lives at (i mod n, j mod n, k mod m). `first` holds the lowest voxel
inside the window; n and m are powers of two, so the remainder is a bit mask.
"""

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.messages import FloatArray, PointArray

EVIDENCE_PER_HIT = 10
EVIDENCE_PER_PASS = 4
HITS_COUNTED_PER_SCAN = 3
EVIDENCE_OCCUPIED = 20
EVIDENCE_SUPPORTED = 40
_RAY_STOPS_SHORT_M = 0.3
_MAX_COORDINATE_M = 1e6
_FIXED_ONE = 2.0**32

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


@compiled(
    "void(float32[:,::1], int64, int64, float64[::1], int64[::1], float64, float64, float64, float64,"
    " int8[:,:,::1])"
)
def mark_passes(
    points_map: PointArray,
    start: int,
    stride: int,
    p_map: FloatArray,
    first: IndexArray,
    cell: float,
    layer: float,
    reach: float,
    self_radius: float,
    hits: ScanArray,
) -> None:
    """Set voxels that a ray of this scan crossed, and no return hit, to -1.

    Rays are sampled once per voxel size, in fixed point with 32 binary places. A ray ends 0.3 m before its
    return: the last voxels may hold the same surface.

    Args:
        points_map: (n, 3) returns; only every `stride`-th from `start` on is used.
        start: the first of them.
        stride: their spacing.
        p_map: where the sensor was; at least `reach` inside the window.
        first: lowest voxel of the window.
        cell: horizontal voxel size, m.
        layer: vertical voxel size, m.
        reach: horizontal length of a ray at most, m.
        self_radius: shorter rays are the vehicle itself, m.
        hits: (n, n, m) the scan's hits, changed in place.
    """
    n = hits.shape[0]
    m = hits.shape[2]
    flat = hits.reshape(hits.size)
    mask = np.uint64(n - 1)
    layer_mask = np.uint64(m - 1)
    width = np.uint64(n)
    height = np.uint64(m)
    places = np.uint64(32)
    step = min(cell, layer)
    top = (first[2] + m) * layer
    bottom = first[2] * layer
    for index in range(start, points_map.shape[0], stride):
        dx = float(points_map[index, 0]) - p_map[0]
        dy = float(points_map[index, 1]) - p_map[1]
        dz = float(points_map[index, 2]) - p_map[2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if not (self_radius < length < _MAX_COORDINATE_M):
            continue
        limit = length - _RAY_STOPS_SHORT_M
        horizontal = math.sqrt(dx * dx + dy * dy) / length
        if limit * horizontal > reach:
            limit = reach / horizontal
        rise = dz / length
        if rise > 0.0:
            limit = min(limit, (top - p_map[2]) / rise - step)
        elif rise < 0.0:
            limit = min(limit, (bottom - p_map[2]) / rise - step)
        scale = step / length * _FIXED_ONE
        step_x = np.uint64(np.int64(dx / cell * scale))
        step_y = np.uint64(np.int64(dy / cell * scale))
        step_z = np.uint64(np.int64(dz / layer * scale))
        u = np.uint64(np.int64(p_map[0] / cell * _FIXED_ONE))
        v = np.uint64(np.int64(p_map[1] / cell * _FIXED_ONE))
        w = np.uint64(np.int64(p_map[2] / layer * _FIXED_ONE))
        for _ in range(int(limit / step)):
            # Unsigned sums wrap round like the storage does, negative coordinates included.
            u += step_x
            v += step_y
            w += step_z
            voxel = (((u >> places) & mask) * width + ((v >> places) & mask)) * height + (
                (w >> places) & layer_mask
            )
            if flat[voxel] == 0:
                flat[voxel] = -1


@compiled("void(int16[:,:,::1], int8[:,:,::1], int64)")
def update_evidence(evidence: EvidenceArray, hits: ScanArray, ceiling: int) -> None:
    """Raise the evidence of hit voxels, lower that of crossed ones, let the rest fade by one."""
    flat = evidence.reshape(evidence.size)
    flat_hits = hits.reshape(hits.size)
    top = np.int16(ceiling)
    for index in range(flat.size):
        seen = np.int16(flat_hits[index])
        if seen > 0:
            flat[index] = min(np.int16(flat[index] + np.int16(EVIDENCE_PER_HIT) * seen), top)
        else:
            loss = np.int16(1) - seen * np.int16(EVIDENCE_PER_PASS - 1)
            flat[index] = max(np.int16(flat[index] - loss), np.int16(0))


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
