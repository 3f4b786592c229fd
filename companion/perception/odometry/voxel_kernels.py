"""Hot loops of the voxel map: a bounded hash of blocks of 2 x 2 x 2 cells, one fused point a cell.

A cell keeps the mean of the points that fell into it and their number. Blocks live in a pool; an
open-addressing table with linear probing maps a block's packed integer coordinates to its place in the
pool. All coordinates must lie within +-1,000,000 cells of the origin.

`control` holds the pool's bookkeeping: 0 number of free blocks, 1 hand of the sweep, 2 blocks evicted.
"""

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import FloatArray

EMPTY = -1
FOUND_WIDTH = 6
"""Of `gather`: offset from the place, number of points, squared distance, block."""
_OFFSET = 1 << 20  # makes packed coordinates positive
_MULTIPLIER = -7046029254386353131  # 2^64 / golden ratio, as a signed number


@inlined
def pack(bx: int, by: int, bz: int) -> int:
    """Return the key of a block."""
    return ((bx + _OFFSET) << 42) | ((by + _OFFSET) << 21) | (bz + _OFFSET)


@inlined
def home(key: int, mask: int) -> int:
    """Return the table slot where the search for a key begins."""
    return ((key * _MULTIPLIER) >> 38) & mask


@inlined
def find(table_keys: NDArray[np.int64], table_blocks: NDArray[np.int32], key: int) -> int:
    """Return the pool index of a block, or EMPTY."""
    mask = table_keys.shape[0] - 1
    slot = home(key, mask)
    while table_keys[slot] != EMPTY:
        if table_keys[slot] == key:
            return int(table_blocks[slot])
        slot = (slot + 1) & mask
    return EMPTY


@inlined
def remove(table_keys: NDArray[np.int64], table_blocks: NDArray[np.int32], key: int) -> None:
    """Delete a key, moving later ones of its run back so that no tombstones are left.

    Source: D. Knuth, "The Art of Computer Programming" vol. 3, section 6.4, algorithm R.
    """
    mask = table_keys.shape[0] - 1
    hole = home(key, mask)
    while table_keys[hole] != key:
        if table_keys[hole] == EMPTY:
            return
        hole = (hole + 1) & mask
    slot = (hole + 1) & mask
    while table_keys[slot] != EMPTY:
        start = home(table_keys[slot], mask)
        if ((slot - start) & mask) >= ((slot - hole) & mask):
            table_keys[hole] = table_keys[slot]
            table_blocks[hole] = table_blocks[slot]
            hole = slot
        slot = (slot + 1) & mask
    table_keys[hole] = EMPTY


@inlined
def evict(
    table_keys: NDArray[np.int64],
    table_blocks: NDArray[np.int32],
    block_keys: NDArray[np.int64],
    free: NDArray[np.int32],
    control: NDArray[np.int64],
    block: int,
) -> None:
    """Return a block to the pool."""
    remove(table_keys, table_blocks, block_keys[block])
    block_keys[block] = EMPTY
    free[control[0]] = block
    control[0] += 1
    control[2] += 1


@compiled(
    "void(int64[::1], int32[::1], int64[::1], int64[::1], int64[::1], float32[:,:,::1], int32[::1],"
    " int64[::1], float64[:,::1], float64[::1], float64, float64, int64, int64)"
)
def insert(
    table_keys: NDArray[np.int64],
    table_blocks: NDArray[np.int32],
    block_keys: NDArray[np.int64],
    block_seen: NDArray[np.int64],
    block_born: NDArray[np.int64],
    cells: NDArray[np.float32],
    free: NDArray[np.int32],
    control: NDArray[np.int64],
    points_imu: FloatArray,
    pose: FloatArray,
    cell_m: float,
    max_range_m: float,
    most_fused: int,
    stamp: int,
) -> None:
    """Fuse points into the map; a full pool gives up the block not seen for longest among a few.

    Args:
        table_keys: (t,) keys of the table, t a power of two above 2 m.
        table_blocks: (t,) their places in the pool.
        block_keys: (m,) key of each block of the pool.
        block_seen: (m,) last stamp of each block.
        block_born: (m,) first stamp of each block.
        cells: (m, 8, 4) mean x, y, z and number of points.
        free: (m,) stack of unused blocks.
        control: (3,) see the module.
        points_imu: (n, 3) metres.
        pose: (>= 12,) p_map then R_map_imu by rows.
        cell_m: edge of a cell.
        max_range_m: farther points are left out.
        most_fused: a cell that holds this many points is settled and stays as it is.
        stamp: number of this insertion, growing.
    """
    mask = table_keys.shape[0] - 1
    inverse = 1.0 / cell_m
    far = max_range_m * max_range_m
    for i in range(points_imu.shape[0]):
        x, y, z = points_imu[i, 0], points_imu[i, 1], points_imu[i, 2]
        if not x * x + y * y + z * z <= far:
            continue
        mx = pose[0] + pose[3] * x + pose[4] * y + pose[5] * z
        my = pose[1] + pose[6] * x + pose[7] * y + pose[8] * z
        mz = pose[2] + pose[9] * x + pose[10] * y + pose[11] * z
        ix = int(np.floor(mx * inverse))
        iy = int(np.floor(my * inverse))
        iz = int(np.floor(mz * inverse))
        key = pack(ix >> 1, iy >> 1, iz >> 1)
        slot = home(key, mask)
        while table_keys[slot] != EMPTY and table_keys[slot] != key:
            slot = (slot + 1) & mask
        if table_keys[slot] == key:
            block = int(table_blocks[slot])
        else:
            if control[0] == 0:
                oldest = control[1]
                for _ in range(16):
                    control[1] = (control[1] + 1) % block_keys.shape[0]
                    if block_seen[control[1]] < block_seen[oldest]:
                        oldest = control[1]
                evict(table_keys, table_blocks, block_keys, free, control, oldest)
                slot = home(key, mask)
                while table_keys[slot] != EMPTY:
                    slot = (slot + 1) & mask
            control[0] -= 1
            block = int(free[control[0]])
            table_keys[slot] = key
            table_blocks[slot] = block
            block_keys[block] = key
            block_born[block] = stamp
            cells[block] = 0.0
        block_seen[block] = stamp
        cell = cells[block, (ix & 1) | ((iy & 1) << 1) | ((iz & 1) << 2)]
        if cell[3] < most_fused:
            cell[3] += np.float32(1.0)
            cell[0] += np.float32((mx - cell[0]) / cell[3])
            cell[1] += np.float32((my - cell[1]) / cell[3])
            cell[2] += np.float32((mz - cell[2]) / cell[3])


@compiled(
    "void(int64[::1], int32[::1], int64[::1], int32[::1], int64[::1], float64[::1], float64, float64, int64)"
)
def sweep(
    table_keys: NDArray[np.int64],
    table_blocks: NDArray[np.int32],
    block_keys: NDArray[np.int64],
    free: NDArray[np.int32],
    control: NDArray[np.int64],
    p_map: FloatArray,
    cell_m: float,
    radius_m: float,
    visits: int,
) -> None:
    """Forget blocks farther than a radius, looking at a bounded number of blocks per call.

    Args:
        table_keys: as for `insert`.
        table_blocks: as for `insert`.
        block_keys: as for `insert`.
        free: as for `insert`.
        control: as for `insert`.
        p_map: (>= 3,) centre of what to keep.
        cell_m: edge of a cell.
        radius_m: distance of the farthest blocks to keep.
        visits: blocks to look at.
    """
    edge = 2.0 * cell_m
    for _ in range(visits):
        control[1] = (control[1] + 1) % block_keys.shape[0]
        key = block_keys[control[1]]
        if key == EMPTY:
            continue
        dx = (np.float64((key >> 42) - _OFFSET) + 0.5) * edge - p_map[0]
        dy = (np.float64(((key >> 21) & 0x1FFFFF) - _OFFSET) + 0.5) * edge - p_map[1]
        dz = (np.float64((key & 0x1FFFFF) - _OFFSET) + 0.5) * edge - p_map[2]
        if dx * dx + dy * dy + dz * dz > radius_m * radius_m:
            evict(table_keys, table_blocks, block_keys, free, control, control[1])


@compiled(
    "int64(int64[::1], int32[::1], float32[:,:,::1], float64, float64, float64, float64, float64,"
    " float64[:,::1])"
)
def gather(
    table_keys: NDArray[np.int64],
    table_blocks: NDArray[np.int32],
    cells: NDArray[np.float32],
    cell_m: float,
    radius_m: float,
    x: float,
    y: float,
    z: float,
    found: FloatArray,
) -> int:
    """Collect the fused points of the 27 cells around a place that lie within a radius.

    Any three consecutive cells lie in two blocks, so eight look-ups see all 27.

    Args:
        table_keys: as for `insert`.
        table_blocks: as for `insert`.
        cells: as for `insert`.
        cell_m: edge of a cell.
        radius_m: largest distance to the place.
        x: of the place in the map.
        y: of the place.
        z: of the place.
        found: (27, 6) receives the offset from the place, the number of points, the squared distance
            and the block.

    Returns:
        How many were found.
    """
    inverse = 1.0 / cell_m
    ix = int(np.floor(x * inverse))
    iy = int(np.floor(y * inverse))
    iz = int(np.floor(z * inverse))
    # Of three consecutive cells the lower block holds one or two, the upper one the rest.
    bx, by, bz = (ix - 1) >> 1, (iy - 1) >> 1, (iz - 1) >> 1
    fx, fy, fz = (ix - 1) & 1, (iy - 1) & 1, (iz - 1) & 1
    limit = radius_m * radius_m
    count = 0
    for kx in range(2):
        for ky in range(2):
            for kz in range(2):
                block = find(table_keys, table_blocks, pack(bx + kx, by + ky, bz + kz))
                if block == EMPTY:
                    continue
                for cz in range(0 if kz else fz, (fz if kz else 1) + 1):
                    for cy in range(0 if ky else fy, (fy if ky else 1) + 1):
                        for cx in range(0 if kx else fx, (fx if kx else 1) + 1):
                            cell = cells[block, cx | (cy << 1) | (cz << 2)]
                            weight = cell[3]
                            if weight == 0.0:
                                continue
                            dx = np.float64(cell[0]) - x
                            dy = np.float64(cell[1]) - y
                            dz = np.float64(cell[2]) - z
                            square = dx * dx + dy * dy + dz * dz
                            if square <= limit:
                                found[count, 0] = dx
                                found[count, 1] = dy
                                found[count, 2] = dz
                                found[count, 3] = weight
                                found[count, 4] = square
                                found[count, 5] = block
                                count += 1
    return count
