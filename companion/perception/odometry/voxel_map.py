"""The local map: fused points in hashed cells, bounded in memory and in distance."""

import numpy as np

from companion.messages import FloatArray
from companion.perception.odometry import voxel_kernels

MOST_FUSED = 50
"""Points after which a cell's mean is settled, so that the map does not follow later drift."""

_SWEEP_FRACTION = 64  # of the pool per scan: a full turn takes about six seconds


class VoxelMap:
    """Fused points in cells, found through a hash of 2 x 2 x 2 blocks.

    All memory is taken at construction.
    """

    def __init__(self, cell_m: float, blocks: int, radius_m: float) -> None:
        """Prepare an empty map.

        Args:
            cell_m: edge of a cell.
            blocks: most blocks to keep.
            radius_m: blocks farther than this from the sensor are forgotten.
        """
        self.cell_m = cell_m
        self.radius_m = radius_m
        table = 1 << int(np.ceil(np.log2(2 * blocks)))
        self.table_keys = np.empty(table, dtype=np.int64)
        self.table_blocks = np.empty(table, dtype=np.int32)
        self.block_keys = np.empty(blocks, dtype=np.int64)
        self.block_seen = np.empty(blocks, dtype=np.int64)
        self.block_born = np.empty(blocks, dtype=np.int64)
        # Written once now, so that the system gives all memory before the flight, not page by page in it.
        self.cells = np.full((blocks, 8, 4), 0.0, dtype=np.float32)
        self.free = np.empty(blocks, dtype=np.int32)
        self.control = np.zeros(3, dtype=np.int64)
        self._stamp = 0
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        blocks = len(self.block_keys)
        self.table_keys.fill(voxel_kernels.EMPTY)
        self.block_keys.fill(voxel_kernels.EMPTY)
        self.block_seen.fill(0)
        self.block_born.fill(0)
        self.free[:] = np.arange(blocks - 1, -1, -1, dtype=np.int32)
        self.control[:] = (blocks, 0, 0)
        self._stamp = 0

    @property
    def stamp(self) -> int:
        """Number of insertions so far; blocks that the next one makes are born with one more."""
        return self._stamp

    @property
    def blocks(self) -> int:
        """Number of blocks in use."""
        return len(self.block_keys) - int(self.control[0])

    def insert(self, points_imu: FloatArray, pose: FloatArray, max_range_m: float) -> None:
        """Fuse points into the map and forget what has come too far.

        Args:
            points_imu: (n, 3) metres.
            pose: (>= 12,) p_map, then R_map_imu by rows.
            max_range_m: farther points are left out.
        """
        self._stamp += 1
        voxel_kernels.insert(
            self.table_keys,
            self.table_blocks,
            self.block_keys,
            self.block_seen,
            self.block_born,
            self.cells,
            self.free,
            self.control,
            points_imu,
            pose,
            self.cell_m,
            max_range_m,
            MOST_FUSED,
            self._stamp,
        )
        voxel_kernels.sweep(
            self.table_keys,
            self.table_blocks,
            self.block_keys,
            self.free,
            self.control,
            pose,
            self.cell_m,
            self.radius_m,
            len(self.block_keys) // _SWEEP_FRACTION + 1,
        )

    def points(self) -> FloatArray:
        """Return the fused points (n, 3) in the map, for tests and tools."""
        used = self.cells[self.block_keys != voxel_kernels.EMPTY].reshape(-1, 4)
        return np.asarray(used[used[:, 3] > 0.0, :3], dtype=np.float64)
