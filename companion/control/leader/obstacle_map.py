"""What the leader remembers of obstacles: a window of voxels that slides with the vehicle.

Returns raise a voxel's evidence, looking through it lowers it. A column is an obstacle when an occupied
voxel lies in it between the heights that the vehicle is to fly through.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.control.leader import map_kernels, rrt_kernels
from companion.control.leader.settings import ObstacleMapSettings
from companion.messages import FloatArray, RegisteredScan

_CLEARANCE_CAP_M = 3.0
_MAX_POINTS = 400_000
_LAYERS = 16
_IMAGE_ROWS = 24
_IMAGE_COLUMNS = 180


@dataclass(frozen=True, slots=True, eq=False)
class ClearanceField:
    """Distance to the nearest obstacle over a square of the flight plane.

    Attributes:
        corner_map: (2,) position of the lowest corner of cell (0, 0), m.
        cell_m: size of a cell.
        distance: (n, n) distance from the cell's centre to the nearest obstacle's centre, at most 3 m.
        blocked: (n, n) whether an obstacle stands in the column.
        surface: (n, n, 2) mean place of the returns in the column, as an offset from its centre; its
            storage wraps: column (i, j) is at ((first + i) mod n, (first + j) mod n).
        first: (3,) index of the lowest voxel.
    """

    corner_map: FloatArray
    cell_m: float
    distance: NDArray[np.float32]
    blocked: NDArray[np.uint8]
    surface: NDArray[np.float32]
    first: NDArray[np.int64]

    def clearance(self, point: FloatArray) -> float:
        """Distance from a point (2,) of the map to the nearest obstacle, m; 100 outside the square."""
        return rrt_kernels.clearance_at(
            self.distance, self.corner_map[0], self.corner_map[1], self.cell_m, point[0], point[1]
        )

    def is_segment_free(self, start: FloatArray, end: FloatArray, clearance: float, ends: FloatArray) -> bool:
        """Whether a straight line keeps `clearance`; `ends` (2, 3) are points where less is granted."""
        return rrt_kernels.segment_free(
            self.distance, self.corner_map[0], self.corner_map[1], self.cell_m, start[0], start[1],
            end[0], end[1], clearance, ends,
        )  # fmt: skip


class ObstacleMap:
    """Accumulated returns round the vehicle, in bounded memory."""

    def __init__(self, settings: ObstacleMapSettings) -> None:
        self._settings = settings
        # Beyond the reach the window keeps two metres of memory, so nothing flickers at its rim.
        side = _power_of_two(2.0 * (settings.reach_m + 2.0) / settings.cell_m)
        self._evidence = np.zeros((side, side, _LAYERS), np.int16)
        self._hits = np.zeros((side, side, _LAYERS), np.int8)
        self._sums = np.zeros((side, side, 3), np.float32)
        self._surface = np.zeros((side, side, 2), np.float32)
        self._image = np.zeros((_IMAGE_ROWS, _IMAGE_COLUMNS), np.float32)
        self._rows = np.zeros((side, side), np.int32)
        self._first = np.zeros(3, np.int64)
        self._ceiling = map_kernels.EVIDENCE_OCCUPIED + settings.memory_scans
        self._field = self._empty_field()

    @property
    def field(self) -> ClearanceField:
        """The distances as of the last scan."""
        return self._field

    def clear(self) -> None:
        """Forget everything."""
        self._evidence[:] = 0
        self._surface[:] = 0.0
        self._field = self._empty_field()

    def add(self, scan: RegisteredScan, z_low: float, z_high: float) -> None:
        """Take in one scan and recompute the distances.

        Args:
            scan: returns in the map; its odometry tells where they were seen from.
            z_low: lowest height at which obstacles matter, m in the map frame.
            z_high: highest such height.
        """
        p_map = np.ascontiguousarray(scan.odometry.p_map, np.float64)
        if not np.all(np.isfinite(p_map)):
            return
        settings = self._settings
        points = np.ascontiguousarray(scan.points_map[:_MAX_POINTS], np.float32)
        self._slide_to(p_map)
        self._hits[:] = 0
        self._sums[:] = 0.0
        floor_z = settings.ground_z_m + settings.ground_clearance_m
        map_kernels.mark_hits(
            points, p_map, self._first, settings.cell_m, settings.layer_m, settings.reach_m,
            settings.self_radius_m, floor_z, self._hits, self._sums,
        )  # fmt: skip
        map_kernels.draw_ranges(points, p_map, settings.self_radius_m, self._image)
        map_kernels.update_evidence(
            self._evidence, self._hits, self._image, p_map, self._first, settings.cell_m, settings.layer_m,
            self._ceiling,
        )  # fmt: skip
        map_kernels.update_surface(self._surface, self._sums)
        map_kernels.forget_ball(
            self._evidence, p_map, self._first, settings.cell_m, settings.layer_m, settings.self_radius_m
        )
        self._field = self._measured_field(z_low, z_high)

    def _slide_to(self, p_map: FloatArray) -> None:
        settings = self._settings
        side = self._evidence.shape[0]
        sizes = np.array([settings.cell_m, settings.cell_m, settings.layer_m])
        half = np.array([side // 2, side // 2, _LAYERS // 2])
        first = np.floor(p_map / sizes).astype(np.int64) - half
        if not np.array_equal(first, self._first):
            map_kernels.slide_window(self._evidence, self._surface, self._first, first)
            self._first = first

    def _measured_field(self, z_low: float, z_high: float) -> ClearanceField:
        settings = self._settings
        side = self._evidence.shape[0]
        blocked = np.zeros((side, side), np.uint8)
        distance = np.zeros((side, side), np.float32)
        k_low = math.floor(z_low / settings.layer_m)
        k_high = math.floor(z_high / settings.layer_m)
        map_kernels.block_columns(self._evidence, self._first, k_low, k_high, blocked)
        cap_cells = math.ceil(_CLEARANCE_CAP_M / settings.cell_m)
        map_kernels.measure_distances(blocked, settings.cell_m, cap_cells, self._rows, distance)
        return ClearanceField(self._corner(), settings.cell_m, distance, blocked, self._surface, self._first)

    def _corner(self) -> FloatArray:
        return np.asarray(self._first[:2] * self._settings.cell_m, np.float64)

    def _empty_field(self) -> ClearanceField:
        side = self._evidence.shape[0]
        return ClearanceField(
            corner_map=self._corner(),
            cell_m=self._settings.cell_m,
            distance=np.full((side, side), _CLEARANCE_CAP_M, np.float32),
            blocked=np.zeros((side, side), np.uint8),
            surface=self._surface,
            first=self._first,
        )


def _power_of_two(least: float) -> int:
    return 1 << math.ceil(math.log2(least))
