"""The obstacle grid: how near the surroundings are, by azimuth and elevation.

It is level and turns with the heading only, so that a vehicle that tilts to accelerate does not see the
world tilt. `nearest_ranges` makes it from points, in flight and in the emulator; training, which has no
points, casts rays and shares `GridSettings` and `encode`.
"""

import math

import numpy as np
from pydantic import Field, model_validator

from companion.geometry import rotation
from companion.messages import FloatArray, NeighbourTracks, PointArray, RegisteredScan
from companion.perception import occupancy_kernels
from companion.settings import Settings

CHANNELS = 2
_NOBODY: FloatArray = np.zeros((0, 6))


class GridSettings(Settings):
    """What the grid covers."""

    azimuths: int = Field(default=72, ge=4, le=720)
    """Cells around; the first begins straight ahead, and they go on to the left."""
    elevations: int = Field(default=12, ge=1, le=180)
    """Cells from the lowest to the highest elevation."""
    lowest_elevation_deg: float = Field(default=-7.0, ge=-90.0, le=89.0)
    """Lower edge of the lowest cells."""
    highest_elevation_deg: float = Field(default=52.0, ge=-89.0, le=90.0)
    """Upper edge of the highest cells."""
    max_range_m: float = Field(default=10.0, gt=0.0, le=100.0)
    """What is farther is not in the grid."""
    min_range_m: float = Field(default=0.25, ge=0.0, le=5.0)
    """What is nearer is the vehicle itself."""
    min_height_m: float = Field(default=0.3, ge=-100.0, le=100.0)
    """What is lower over the start point counts as ground."""
    neighbour_radius_m: float = Field(default=0.35, ge=0.0, le=2.0)
    """Points this near to a validated neighbour belong to it: it is no obstacle but a neighbour."""

    @model_validator(mode="after")
    def _field_is_open(self) -> "GridSettings":
        if self.lowest_elevation_deg >= self.highest_elevation_deg:
            raise ValueError("lowest_elevation_deg must be below highest_elevation_deg")
        if self.min_range_m >= self.max_range_m:
            raise ValueError("min_range_m must be below max_range_m")
        return self

    @property
    def limits(self) -> FloatArray:
        """Return the numbers (5,) that `occupancy_kernels.nearest_ranges` wants."""
        low, high = np.radians([self.lowest_elevation_deg, self.highest_elevation_deg])
        return np.array([self.min_range_m, self.max_range_m, self.min_height_m, low, high])


def encode(ranges: FloatArray, max_range_m: float) -> PointArray:
    """Turn ranges (..., azimuths, elevations) into the grid (..., 2, azimuths, elevations).

    The first channel is the nearness, 1 at the centre and 0 at `max_range_m`; the second is 1 where there
    is anything. A cell without return (infinite or beyond `max_range_m`) is 0 in both.
    """
    hit = ranges <= max_range_m
    nearness = np.where(hit, 1.0 - np.where(hit, ranges, 0.0) / max_range_m, 0.0)
    return np.stack([nearness, hit], axis=-3).astype(np.float32)


def decode(grid: PointArray, max_range_m: float) -> FloatArray:
    """Return the ranges (..., azimuths, elevations) of a grid, infinity where there is nothing."""
    nearness, hit = grid[..., 0, :, :].astype(np.float64), grid[..., 1, :, :]
    return np.where(hit > 0.5, (1.0 - nearness) * max_range_m, np.inf)


class ObstacleGrid:
    """Makes grids of one size."""

    def __init__(self, settings: GridSettings) -> None:
        """Take all memory at once."""
        self._settings = settings
        self._limits = settings.limits
        self._ranges = np.empty((settings.azimuths, settings.elevations))

    def ranges(
        self, scan: RegisteredScan, tracks: NeighbourTracks | None, p_map: FloatArray, yaw: float
    ) -> FloatArray:
        """Return the nearest range (azimuths, elevations) in every cell, infinity where nothing is.

        Args:
            scan: what was seen; the vehicle's own parts, the ground and validated neighbours are left out,
                bodies that are not known stay in, for they must be avoided.
            tracks: neighbours at the scan's end.
            p_map: (3,) where the grid is centred, usually the body; nothing is near an unknown place.
            yaw: heading of the grid, rad.
        """
        if not (np.isfinite(p_map).all() and math.isfinite(yaw)):
            return np.full_like(self._ranges, np.inf)
        # The kernel trusts both to be of one length.
        count = min(len(scan.points_map), len(scan.ages_ns))
        occupancy_kernels.nearest_ranges(
            np.ascontiguousarray(scan.points_map[:count], dtype=np.float32),
            np.ascontiguousarray(scan.ages_ns[:count], dtype=np.int32),
            np.ascontiguousarray(p_map, dtype=np.float64),
            yaw,
            self._limits,
            _validated(tracks),
            self._settings.neighbour_radius_m,
            self._ranges,
        )
        return self._ranges.copy()

    def of(self, scan: RegisteredScan, tracks: NeighbourTracks | None = None) -> PointArray:
        """Return the grid (2, azimuths, elevations) about the body at the scan's end, in its heading."""
        heading = float(rotation.yaw_of(scan.odometry.q_map_body))
        ranges = self.ranges(scan, tracks, scan.odometry.p_map, heading)
        return encode(ranges, self._settings.max_range_m)


def _validated(tracks: NeighbourTracks | None) -> FloatArray:
    if tracks is None:
        return _NOBODY
    rows = [np.concatenate([track.p_map, track.v_map]) for track in tracks.tracks if track.validated]
    return np.array(rows) if rows else _NOBODY
