"""The obstacle grid from the world itself: rays instead of points, for those who have no LiDAR."""

import numpy as np

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.occupancy import GridSettings
from sitl.worlds.primitives import World


def grid_ranges(
    world: World,
    p_world: FloatArray,
    yaw: float,
    settings: GridSettings,
    *,
    ground_world_m: float = 0.0,
    rays_per_cell: int = 4,
) -> FloatArray:
    """Cast rays through every cell and keep the nearest range of each.

    Args:
        world: what can be hit.
        p_world: (3,) centre of the grid.
        yaw: heading of the grid in the world, rad.
        settings: of the grid.
        ground_world_m: height of the place where heights begin (the map's origin).
        rays_per_cell: rays across a cell in each of both directions.

    Returns:
        Ranges (azimuths, elevations), infinity where no ray hits anything that the grid shows.
    """
    n = rays_per_cell
    low, high = np.radians([settings.lowest_elevation_deg, settings.highest_elevation_deg])
    azimuth = (np.arange(settings.azimuths * n) + 0.5) * (2.0 * np.pi / (settings.azimuths * n))
    elevation = low + (np.arange(settings.elevations * n) + 0.5) * ((high - low) / (settings.elevations * n))
    a, e = np.meshgrid(azimuth, elevation, indexing="ij")
    directions_heading = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    directions = rotation.rotate(rotation.from_yaw(yaw), directions_heading.reshape(-1, 3))
    origins = np.broadcast_to(np.asarray(p_world, dtype=np.float64), directions.shape)
    ranges = world.cast(np.ascontiguousarray(origins), directions, settings.max_range_m).ranges
    height = p_world[2] + ranges * directions[:, 2] - ground_world_m
    shown = (ranges >= settings.min_range_m) & (height >= settings.min_height_m)
    by_cell = np.where(shown, ranges, np.inf).reshape(settings.azimuths, n, settings.elevations, n)
    return np.asarray(by_cell.min(axis=(1, 3)))
