"""Fields of upright pillars with a guaranteed gap between their surfaces."""

from collections.abc import Iterable
from typing import Annotated

import numpy as np
from numpy.random import Generator
from pydantic import Field, Strict, model_validator

from companion.messages import FloatArray
from companion.settings import Settings
from sitl.worlds.placing import FreeDisc, fill
from sitl.worlds.primitives import World
from sitl.worlds.surfaces import cylinders, ground, together

Point = Annotated[tuple[float, float], Strict(False)]


class PillarFieldSettings(Settings):
    """One random pillar field without walls."""

    centre_world_m: Point = (0.0, 0.0)
    """Middle of the area in which pillars stand."""
    size_m: Point = (60.0, 60.0)
    """Extent of that area along x and y; pillars stand wholly inside it."""
    min_gap_m: float = Field(default=5.0, ge=0.5, le=100.0)
    """Least distance between the surfaces of any two pillars."""
    radius_min_m: float = Field(default=0.2, ge=0.02, le=5.0)
    """Least radius."""
    radius_max_m: float = Field(default=0.5, ge=0.02, le=5.0)
    """Greatest radius."""
    height_m: float = Field(default=5.0, ge=0.1, le=100.0)
    """Height of every pillar."""
    spawn_world_m: Point = (0.0, 0.0)
    """Middle of the disc kept free for the start."""
    spawn_clear_m: float = Field(default=4.0, ge=0.0, le=100.0)
    """Radius of that disc."""
    goal_world_m: Point | None = None
    """Middle of the disc kept free for the goal, if any."""
    goal_clear_m: float = Field(default=2.5, ge=0.0, le=100.0)
    """Radius of that disc."""
    reflectivity_min: float = Field(default=0.1, ge=0.0, le=1.0)
    """Least diffuse reflectivity of a pillar."""
    reflectivity_max: float = Field(default=0.8, ge=0.0, le=1.0)
    """Greatest diffuse reflectivity of a pillar."""
    ground_reflectivity: float = Field(default=0.3, ge=0.0, le=1.0)
    """Diffuse reflectivity of the ground."""
    failures_until_full: int = Field(default=2000, ge=1, le=1_000_000)
    """Random places refused in a row after which the field counts as full."""

    @model_validator(mode="after")
    def _ordered(self) -> "PillarFieldSettings":
        if self.radius_max_m < self.radius_min_m:
            raise ValueError("radius_max_m must not be below radius_min_m")
        if self.reflectivity_max < self.reflectivity_min:
            raise ValueError("reflectivity_max must not be below reflectivity_min")
        if min(self.size_m) <= 2.0 * self.radius_max_m:
            raise ValueError("size_m must leave room for a pillar of radius_max_m")
        return self


def pillar_field(rng: Generator, settings: PillarFieldSettings, also_free: Iterable[FreeDisc] = ()) -> World:
    """Return the ground (index 0) and as many pillars as random placement finds room for.

    Candidates are drawn uniformly and kept if they respect every gap and free disc (Poisson-disk
    sampling by dart throwing with individual radii). Equal generators give equal worlds.

    Args:
        rng: source of chance.
        settings: of the field.
        also_free: more discs into which no pillar may reach.
    """
    low = np.array(settings.centre_world_m) - 0.5 * np.array(settings.size_m)
    high = np.array(settings.centre_world_m) + 0.5 * np.array(settings.size_m)
    free = [(*settings.spawn_world_m, settings.spawn_clear_m)]
    if settings.goal_world_m is not None:
        free.append((*settings.goal_world_m, settings.goal_clear_m))
    free += also_free
    pillars = fill_with_pillars(
        rng,
        low,
        high,
        radius_m=(settings.radius_min_m, settings.radius_max_m),
        height_m=settings.height_m,
        free=free,
        gap_m=settings.min_gap_m,
        failures_until_full=settings.failures_until_full,
    )
    shades = rng.uniform(settings.reflectivity_min, settings.reflectivity_max, len(pillars))
    return together(
        ground(settings.ground_reflectivity),
        cylinders(pillars[:, :3], pillars[:, 3:6], pillars[:, 6], shades),
    )


def fill_with_pillars(
    rng: Generator,
    low_world: FloatArray,
    high_world: FloatArray,
    *,
    radius_m: tuple[float, float],
    height_m: float,
    free: Iterable[FreeDisc],
    gap_m: float,
    failures_until_full: int,
) -> FloatArray:
    """Return upright rods (n, 7) wholly between the corners `low_world` and `high_world` (2,) of an area."""

    def rods_of(numbers: FloatArray) -> FloatArray:
        radii = radius_m[0] + (radius_m[1] - radius_m[0]) * numbers[:, :1]
        low, high = low_world + radii, high_world - radii
        feet = low + (high - low) * numbers[:, 1:3]
        rods = np.zeros((len(numbers), 7))
        rods[:, :2], rods[:, 3:5], rods[:, 5], rods[:, 6] = feet, feet, height_m, radii[:, 0]
        return rods

    rods, _ = fill(rng, 3, rods_of, free=free, gap_m=gap_m, failures_until_full=failures_until_full)
    return rods
