"""Tables of the obstacle grid that all swarms share."""

import numpy as np

from companion.messages import FloatArray
from sitl.training.environment_settings import EnvironmentSettings


def grid_tables(
    settings: EnvironmentSettings,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return rays by azimuth and by elevation, edges of columns and of rows, and directions of the cells.

    The first four are those of `grid_kernels.draw_grid`; the last (72, 12, 3) are unit vectors in the heading
    frame.
    """
    abstract = settings.abstract("paper")
    _, azimuth_rays, elevation_rays, column_edges, row_edges = abstract.packed_grid()
    grid = abstract.grid
    azimuths = (np.arange(grid.azimuths) + 0.5) * (2.0 * np.pi / grid.azimuths)
    angles = row_edges[:, 0]
    elevations = 0.5 * (angles[:-1] + angles[1:])
    directions = np.empty((grid.azimuths, grid.elevations, 3))
    directions[..., 0] = np.cos(azimuths)[:, None] * np.cos(elevations)
    directions[..., 1] = np.sin(azimuths)[:, None] * np.cos(elevations)
    directions[..., 2] = np.sin(elevations)
    return azimuth_rays, elevation_rays, column_edges, row_edges, directions
