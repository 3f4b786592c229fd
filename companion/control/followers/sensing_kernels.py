"""What several laws ask of the obstacle grid."""

import math

from companion.compiled import portable_inlined
from companion.control.followers.layout_kernels import (
    EGO_HEIGHT,
    HEIGHT_GAIN,
    HEIGHT_SPEED,
    HIGHEST_ELEVATION_DEG,
    LOWEST_ELEVATION_DEG,
    RECOVERY_HEIGHT,
    ROW_P,
    ROW_PRESENT,
)
from companion.messages import FloatArray


@portable_inlined
def find_columns(ranges: FloatArray, below: float, above: float, columns: FloatArray, first: int) -> None:
    """Find the nearest horizontal distance in each direction, within a band about the own height.

    A cell belongs to the band if any of it does: its return may be anywhere in the cell.

    Args:
        ranges: (azimuths, elevations) m, infinity where free.
        below: depth of the band under the own height, m.
        above: its height over it, m.
        columns: receives the distances, infinity where nothing is.
        first: where in `columns` they begin.
    """
    azimuths, elevations = ranges.shape
    for column in range(azimuths):
        columns[first + column] = math.inf
    low = math.radians(LOWEST_ELEVATION_DEG)
    step = math.radians(HIGHEST_ELEVATION_DEG - LOWEST_ELEVATION_DEG) / elevations
    for row in range(elevations):
        lower = math.sin(low + row * step)
        upper = math.sin(low + (row + 1) * step)
        flat = math.cos(low + (row + 0.5) * step)
        for column in range(azimuths):
            reach = ranges[column, row]
            if reach < math.inf and reach * lower <= above and reach * upper >= -below:
                columns[first + column] = min(columns[first + column], reach * flat)


@portable_inlined
def find_columns_up_to(ranges: FloatArray, highest: float, columns: FloatArray, first: int) -> None:
    """Find the nearest horizontal distance in each direction, in the cells centred up to an elevation.

    Args:
        ranges: (azimuths, elevations) m, infinity where free.
        highest: elevation, rad.
        columns: receives the distances, infinity where nothing is.
        first: where in `columns` they begin.
    """
    azimuths, elevations = ranges.shape
    for column in range(azimuths):
        columns[first + column] = math.inf
    low = math.radians(LOWEST_ELEVATION_DEG)
    step = math.radians(HIGHEST_ELEVATION_DEG - LOWEST_ELEVATION_DEG) / elevations
    for row in range(elevations):
        centre = low + (row + 0.5) * step
        if centre > highest:
            break
        flat = math.cos(centre)
        for column in range(azimuths):
            reach = ranges[column, row]
            if reach < math.inf:
                columns[first + column] = min(columns[first + column], reach * flat)


@portable_inlined
def direction_of(column: int, azimuths: int) -> float:
    """Return the angle of a column's centre to the left of straight ahead, rad."""
    return (column + 0.5) * 2.0 * math.pi / azimuths


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
