"""Which returns of a scan are used at all, and which of them are matched."""

import numpy as np
from numpy.typing import NDArray

from companion.messages import ByteArray, FloatArray, LidarScan, PointArray
from companion.perception.odometry import kernels
from companion.perception.odometry.settings import OdometrySettings

MOST_POINTS = 60_000
"""Returns of one scan beyond this number are thinned evenly before anything else."""

_SCRATCH = 131_072


def usable_points(
    scan: LidarScan, settings: OdometrySettings
) -> tuple[PointArray, NDArray[np.int32], ByteArray]:
    """Return the finite, confident points in range, their time offsets and reflectivities.

    Bits 4-5 of a tag are the confidence by position; 0 and 1 are kept.
    """
    count = min(len(scan.points_lidar), len(scan.offsets_ns), len(scan.reflectivity), len(scan.tags))
    stride = -(-count // MOST_POINTS) if count > MOST_POINTS else 1
    pick = slice(0, count, stride)
    points = np.asarray(scan.points_lidar[pick], dtype=np.float32)
    square = np.einsum("ij,ij->i", points, points)
    # A comparison with NaN is false, so points that are not finite fall out here.
    keep = (square >= settings.min_range_m**2) & (square <= settings.max_range_m**2)
    if settings.ignore_uncertain_points:
        keep &= (scan.tags[pick] & 0x30) <= 0x10
    return (
        np.ascontiguousarray(points[keep]),
        np.ascontiguousarray(scan.offsets_ns[pick][keep], dtype=np.int32),
        np.asarray(scan.reflectivity[pick][keep]),
    )


def nearest_first(points: FloatArray, most: int) -> NDArray[np.int64] | slice:
    """Return which of points (n, 3) to keep when only `most` may stay.

    The nearest half of the quota stays whole, for it is what one may collide with; the rest is taken
    evenly from all farther points.
    """
    count = len(points)
    if count <= most:
        return slice(None)
    order = np.argsort(np.einsum("ij,ij->i", points, points), kind="stable")
    near = most // 2
    far = np.linspace(near, count - 1, most - near).astype(np.int64)
    return np.sort(np.concatenate([order[:near], order[far]]))


class Thinning:
    """Chooses about a wanted number of points, spread evenly over what is seen.

    One point a cell keeps every far, lonely surface and thins what is near and dense; the cell's size
    follows the number it yields from scan to scan.
    """

    def __init__(self, settings: OdometrySettings) -> None:
        """Start in the middle of the allowed cell sizes."""
        self._wanted = settings.matched_points
        self._smallest_m = settings.thinning_cell_min_m
        self._largest_m = max(settings.thinning_cell_min_m, settings.thinning_cell_max_m)
        self.cell_m = float(np.sqrt(self._smallest_m * self._largest_m))
        self._keys = np.full(_SCRATCH, 0, dtype=np.int64)
        self._stamps = np.full(_SCRATCH + 1, 0, dtype=np.int64)
        self._chosen = np.full(MOST_POINTS, 0, dtype=np.int64)

    def choose(self, points_imu: FloatArray) -> NDArray[np.int64]:
        """Return the indices (m,) of the chosen points (n, 3), ascending."""
        count = kernels.thin(points_imu, self.cell_m, self._keys, self._stamps, self._chosen)
        step = min(1.25, max(0.8, float(np.sqrt(max(count, 1) / self._wanted))))
        self.cell_m = min(self._largest_m, max(self._smallest_m, self.cell_m * step))
        most = 2 * self._wanted
        if count <= most:
            return self._chosen[:count]
        # The first scans at a new place: evenly from all cells.
        even = np.linspace(0, count - 1, most).astype(np.int64)
        self._chosen[:most] = self._chosen[even]
        return self._chosen[:most]
