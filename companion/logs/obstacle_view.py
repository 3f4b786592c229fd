"""Obstacles at flight level, gathered from thinned clouds into cells: bounded however long the flight."""

import numpy as np

from companion.logs.views import LEVEL_BAND_M
from companion.messages import FloatArray, PointArray

CELL_M = 0.15
GROUND_CLEARANCE_M = LEVEL_BAND_M + 0.3
"""Below this height over the start, the ground itself would count as an obstacle."""

_CELLS_MAX = 200_000
_HALF_WIDTH = 1 << 20
_HITS_MIN = 2


class ObstacleView:
    """Counts how often a cell of the map, seen from above, held a point near the vehicle's height."""

    def __init__(self) -> None:
        """Begin without obstacles."""
        self._hits: dict[int, int] = {}
        self._clouds = 0

    def add(self, points_map: PointArray, height_map: float) -> None:
        """Add a cloud (n, 3) seen while the body was at `height_map` metres."""
        self._clouds += 1
        level = points_map[np.abs(points_map[:, 2] - height_map) <= LEVEL_BAND_M]
        cells = np.floor(level[:, :2].astype(np.float64) / CELL_M)
        cells = cells[np.all(np.abs(cells) < _HALF_WIDTH, axis=1)].astype(np.int64)
        keys = (cells[:, 0] + _HALF_WIDTH) * (2 * _HALF_WIDTH) + cells[:, 1] + _HALF_WIDTH
        for key in np.unique(keys).tolist():
            if key in self._hits or len(self._hits) < _CELLS_MAX:
                self._hits[key] = self._hits.get(key, 0) + 1

    def centres_map(self) -> FloatArray:
        """Return the centres (n, 2) of the cells seen more than once (once, if there is one cloud only)."""
        enough = min(_HITS_MIN, self._clouds)
        keys = np.array([key for key, hits in self._hits.items() if hits >= enough], dtype=np.int64)
        x, y = np.divmod(keys, 2 * _HALF_WIDTH)
        centres: FloatArray = (np.stack([x, y], axis=-1) - _HALF_WIDTH + 0.5) * CELL_M
        return centres
