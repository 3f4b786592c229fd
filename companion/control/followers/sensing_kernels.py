"""What several laws ask of the obstacle grid."""

import math

import numpy as np

from companion.compiled import portable_inlined
from companion.control.followers.layout_kernels import (
    AZIMUTHS,
    EGO_HEIGHT,
    ELEVATIONS,
    HEIGHT_GAIN,
    HEIGHT_SPEED,
    HIGHEST_ELEVATION_DEG,
    LOWEST_ELEVATION_DEG,
    RECOVERY_HEIGHT,
    ROW_P,
    ROW_PRESENT,
)
from companion.messages import FloatArray

_LOW = math.radians(LOWEST_ELEVATION_DEG)
_HEIGHT = math.radians(HIGHEST_ELEVATION_DEG - LOWEST_ELEVATION_DEG) / ELEVATIONS
_SINES = np.array([math.sin(_LOW + row * _HEIGHT) for row in range(ELEVATIONS + 1)])
_COSINES = np.array([math.cos(_LOW + (row + 0.5) * _HEIGHT) for row in range(ELEVATIONS)])
_ANGLES = [(column + 0.5) * 2.0 * math.pi / AZIMUTHS for column in range(AZIMUTHS)]
_DIRECTIONS = np.array([(math.cos(angle), math.sin(angle)) for angle in _ANGLES])


@portable_inlined
def find_columns(ranges: FloatArray, below: float, above: float, columns: FloatArray, first: int) -> None:
    """Find the nearest horizontal distance in each direction, within a band about the own height.

    A cell belongs to the band if any of it does: its return may be anywhere in the cell.

    Args:
        ranges: (72, 12) m, infinity where free.
        below: depth of the band under the own height, m.
        above: its height over it, m.
        columns: receives the distances, infinity where nothing is.
        first: where in `columns` they begin.
    """
    for column in range(AZIMUTHS):
        nearest = math.inf
        for row in range(ELEVATIONS):
            reach = ranges[column, row]
            if reach < math.inf and reach * _SINES[row] <= above and reach * _SINES[row + 1] >= -below:
                nearest = min(nearest, reach * _COSINES[row])
        columns[first + column] = nearest


@portable_inlined
def find_columns_up_to(ranges: FloatArray, highest: float, columns: FloatArray, first: int) -> None:
    """Find the nearest horizontal distance in each direction, in the cells centred up to an elevation.

    Args:
        ranges: (72, 12) m, infinity where free.
        highest: elevation, rad.
        columns: receives the distances, infinity where nothing is.
        first: where in `columns` they begin.
    """
    rows = 0
    while rows < ELEVATIONS and _LOW + (rows + 0.5) * _HEIGHT <= highest:
        rows += 1
    for column in range(AZIMUTHS):
        nearest = math.inf
        for row in range(rows):
            reach = ranges[column, row]
            if reach < math.inf:
                nearest = min(nearest, reach * _COSINES[row])
        columns[first + column] = nearest


@portable_inlined
def direction_of(column: int) -> tuple[float, float]:
    """Return cosine and sine of the angle of a column's centre to the left of straight ahead."""
    return _DIRECTIONS[column, 0], _DIRECTIONS[column, 1]


@portable_inlined
def keep_height(ego: FloatArray, neighbours: FloatArray, parameters: FloatArray) -> float:
    """Return the vertical velocity towards the neighbours' mean height, or home if nobody is seen."""
    count, rise = 0, 0.0
    for row in range(neighbours.shape[0]):
        if neighbours[row, ROW_PRESENT] > 0.5:
            count += 1
            rise += neighbours[row, ROW_P + 2]
    wanted = rise / count if count > 0 else parameters[RECOVERY_HEIGHT] - ego[EGO_HEIGHT]
    limit = parameters[HEIGHT_SPEED]
    speed: float = min(max(parameters[HEIGHT_GAIN] * wanted, -limit), limit)
    return speed
