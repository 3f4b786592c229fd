"""Neighbours without tape: what is as small as a UAV and touches nothing."""

import numpy as np

from companion.messages import FloatArray
from companion.perception.tracking import clustering_kernels as kernels
from companion.perception.tracking.clustering import epsilons, least_points
from companion.perception.tracking.filtering import StackedPoints
from companion.perception.tracking.settings import TrackingSettings

_SEPARATION = 1.6  # epsilons of empty space around what is said to float
_MOST_POINTS = 12_000
_CELL_M = 0.1
_OFFSET = 1 << 20


def compact_bodies(stack: StackedPoints, sensor_map: FloatArray, settings: TrackingSettings) -> FloatArray:
    """Return the middles (k, 3) of small free clusters in the newest scan, the nearest ones.

    Args:
        stack: all near points.
        sensor_map: (3,) m.
        settings: size limits and density.
    """
    stride = -(-stack.fresh // _MOST_POINTS) if stack.fresh else 1
    points = stack.points_map[: stack.fresh : stride].astype(np.float64)
    # One point a cell is enough to see what hangs together, and near walls are dense.
    cells = np.floor(points / _CELL_M).astype(np.int64) + _OFFSET
    keys = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    _, chosen, cell_of = np.unique(keys, return_index=True, return_inverse=True)
    ranges = np.linalg.norm(points[chosen] - sensor_map, axis=1)
    reach = _SEPARATION * np.sqrt(stride * settings.stacked_scans) * epsilons(ranges, settings)
    of_cell = np.empty(len(chosen), np.int32)
    count = kernels.density_clusters(np.ascontiguousarray(points[chosen]), reach, 1, of_cell)
    labels = of_cell[cell_of].astype(np.int32)
    table = np.empty((count, kernels.SUMMARY_WIDTH))
    ones = np.ones(len(points), np.uint8)
    kernels.summarise(labels, points, points, np.zeros(len(points)), ones, ones, table)
    middles = table[:, kernels.SUM] / table[:, kernels.COUNT, None]
    away = np.linalg.norm(middles - sensor_map, axis=1)
    size = table[:, kernels.HIGH] - table[:, kernels.LOW]
    wanted = np.array([least_points(float(r), settings) for r in away]) / (
        2.0 * settings.stacked_scans * stride
    )
    small = (np.hypot(size[:, 0], size[:, 1]) <= settings.max_width_m) & (size[:, 2] <= settings.max_height_m)
    good = np.flatnonzero(small & (table[:, kernels.COUNT] >= np.maximum(wanted, 2.0)))
    order = good[np.argsort(away[good], kind="stable")]
    return np.asarray(middles[order[: settings.most_untaped]])
