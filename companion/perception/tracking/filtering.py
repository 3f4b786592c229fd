"""Which points are looked at: the last scans in the map, near the sensor."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.clock import NANOSECONDS_PER_SECOND
from companion.messages import ByteArray, FloatArray, PointArray, RegisteredScan
from companion.perception.tracking.settings import TrackingSettings

MOST_POINTS_PER_SCAN = 60_000
"""Points of one scan beyond this number are thinned evenly before anything else."""

_OLDEST_AGE_S = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class StackedPoints:
    """The near points of the last scans, newest scan first.

    Attributes:
        points_map: (n, 3) m.
        ages_s: (n,) how long before now they were measured.
        bright: (n,) 1 for bright points.
        fresh: number of points of the newest scan; they are the first.
    """

    points_map: PointArray
    ages_s: FloatArray
    bright: ByteArray
    fresh: int


class ScanStack:
    """Keeps the last B scans."""

    def __init__(self, settings: TrackingSettings) -> None:
        """Begin with none."""
        self._settings = settings
        self._layers: deque[tuple[int, PointArray, FloatArray, ByteArray]] = deque(
            maxlen=settings.stacked_scans
        )

    def clear(self) -> None:
        """Forget all scans: the map is another one."""
        self._layers.clear()

    def add(self, scan: RegisteredScan, t_ns: int, sensor_map: FloatArray) -> StackedPoints:
        """Add the newest scan and return all points of the stack.

        Args:
            scan: its points may contain anything; those that are not finite are left out.
            t_ns: host time of the scan's end.
            sensor_map: (3,) where the sensor was then, m.
        """
        self._layers.appendleft((t_ns, *self._near(scan, sensor_map)))
        layers = list(self._layers)
        ages = [age + (t_ns - then) / NANOSECONDS_PER_SECOND for then, _, age, _ in layers]
        return StackedPoints(
            np.concatenate([points for _, points, _, _ in layers]),
            np.clip(np.concatenate(ages), 0.0, _OLDEST_AGE_S),
            np.concatenate([bright for _, _, _, bright in layers]),
            len(layers[0][1]),
        )

    def _near(self, scan: RegisteredScan, sensor_map: FloatArray) -> tuple[PointArray, FloatArray, ByteArray]:
        count = min(len(scan.points_map), len(scan.reflectivity), len(scan.ages_ns))
        stride = -(-count // MOST_POINTS_PER_SCAN) if count > MOST_POINTS_PER_SCAN else 1
        pick = slice(0, count, stride)
        points = np.asarray(scan.points_map[pick], np.float32).reshape(-1, 3)
        away = points - sensor_map.astype(np.float32)
        square = np.einsum("ij,ij->i", away, away)
        # A comparison with NaN is false, so points that are not finite fall out here.
        keep = square >= self._settings.min_range_m**2
        keep &= square <= self._settings.max_range_m**2
        bright = scan.reflectivity[pick][keep] >= self._settings.bright_reflectivity
        return (
            np.ascontiguousarray(points[keep]),
            scan.ages_ns[pick][keep] / NANOSECONDS_PER_SECOND,
            bright.astype(np.uint8),
        )


def thinned(chosen: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return at most `most` of the indices (n,), evenly taken."""
    if len(chosen) <= most:
        return chosen
    return chosen[np.linspace(0, len(chosen) - 1, most).astype(np.int64)]


def rationed(owners: NDArray[np.int32], ration: int, unowned: int) -> NDArray[np.bool_]:
    """Return which points (n,) to keep: of every owner at most a ration, evenly taken.

    Args:
        owners: (n,) negative for none.
        ration: most points of one owner.
        unowned: most points without any.
    """
    counts = np.bincount(owners + 1, minlength=1)
    limits = np.full(len(counts), ration)
    limits[0] = unowned
    keep = np.ones(len(owners), np.bool_)
    for name in np.flatnonzero(counts > limits):
        mine = np.flatnonzero(owners == name - 1)
        keep[mine] = False
        keep[thinned(mine, int(limits[name]))] = True
    return keep
