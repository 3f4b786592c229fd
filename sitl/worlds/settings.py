"""What a scenario says about its surroundings, and the site that comes of it."""

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike
from pydantic import Field, Strict, model_validator

from companion.errors import ProfileError
from companion.messages import FloatArray
from companion.settings import Settings
from companion.yaml_source import load
from sitl.worlds.course import GOAL_DISTANCE_M, spawn_clear_m
from sitl.worlds.mesh import mesh_world
from sitl.worlds.pillars import PillarFieldSettings, pillar_field
from sitl.worlds.primitives import Primitive, World
from sitl.worlds.sites import FLOWN_SITES, Site, build_site

SiteName = Literal[
    "none",
    "pillars_10m",
    "pillars_5m",
    "simplified_forest",
    "forest",
    "indoor_blocks",
    "indoor_wall",
    "outdoor_pillars",
    "display_tower",
    "short_forest",
]
Point = Annotated[tuple[float, float], Strict(False)]
Way = Annotated[list[Point], Field(min_length=1, max_length=200)]

_KINDS = ("site", "file", "mesh", "pillars", "primitives")
_GOAL_ROOM_M = 1.0
_GOAL_HEIGHTS_M = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
_GOAL_DRAWS = 200


class WorldFile(Settings):
    """A world of one's own: bodies one by one, and the way of a swarm through them."""

    primitives: list[Primitive] = Field(max_length=50_000)
    """Bodies."""
    spawn_world_m: Point = (0.0, 0.0)
    """Middle of a swarm at the start."""
    waypoints_world_m: Way | None = None
    """A leader's way; by default one goal in a random direction where there is room."""


class WorldSettings(Settings):
    """The surroundings: one of the named sites, a file, a mesh, a random pillar field, or bodies."""

    site: SiteName | None = None
    """A site of the catalogue, built anew from the seed."""

    file: str | None = Field(default=None, min_length=1)
    """A YAML file with a list of bodies, relative to the file that names it."""

    mesh: str | None = Field(default=None, min_length=1)
    """A triangle mesh (PLY, STL, OBJ, OFF, glTF; metres, z up), relative to the file that names it."""

    mesh_voxel_m: float = Field(default=0.2, ge=0.02, le=5.0)
    """Resolution of the mesh: it becomes cubes of this side, merged into boxes."""

    mesh_ground_m: float | None = 0.0
    """Height of the ground plane that replaces what lies low in the mesh; null keeps the mesh's own floor."""

    mesh_reflectivity: float = Field(default=0.4, ge=0.0, le=1.0)
    """Diffuse reflectivity of the mesh."""

    pillars: PillarFieldSettings | None = None
    """A random field; its free discs are moved to the vehicle's start and goal."""

    primitives: list[Primitive] | None = None
    """Bodies one by one."""

    spawn_world_m: Point | None = None
    """Middle of a swarm at the start, for worlds whose start is free to choose."""

    waypoints_world_m: Way | None = None
    """A leader's way, for worlds whose way is free to choose."""

    @model_validator(mode="after")
    def _one_kind(self) -> "WorldSettings":
        if sum(getattr(self, kind) is not None for kind in _KINDS) != 1:
            raise ValueError(f"name exactly one of {', '.join(_KINDS)}")
        if self.site in FLOWN_SITES and (self.spawn_world_m or self.waypoints_world_m):
            raise ValueError(
                f"the way of the site {self.site} is part of it: no start or waypoints can be given"
            )
        return self


def told_way(settings: WorldSettings, folder: Path) -> tuple[FloatArray, FloatArray | None]:
    """Return the start (2,) and the waypoints (k, 2), if any, that a scenario or its file of bodies tells.

    Sites with a way of their own tell it when they are built.

    Raises:
        ProfileError: if the file is missing or wrong.
    """
    spawn, way = _first(settings.spawn_world_m, None), _first(settings.waypoints_world_m, None)
    if settings.file is not None:
        told = load(folder / settings.file, WorldFile)
        spawn, way = _first(spawn, told.spawn_world_m), _first(way, told.waypoints_world_m)
    if settings.pillars is not None:
        spawn, way = _first(spawn, settings.pillars.spawn_world_m), _first(way, settings.pillars.goal_world_m)
    return np.zeros(2) if spawn is None else spawn, None if way is None else np.atleast_2d(way)


def site_of(
    settings: WorldSettings,
    rng: Generator,
    *,
    folder: Path,
    followers: int,
    spawn_world: ArrayLike | None = None,
    goal_world: ArrayLike | None = None,
    goal_distance_m: float = GOAL_DISTANCE_M,
) -> Site:
    """Build the world that a scenario names, with a way through it.

    Args:
        settings: what the scenario says.
        rng: draws everything that it leaves open.
        folder: to which files are relative.
        followers: how many fly behind the leader.
        spawn_world: (2,) start instead of the settings' own; ignored by sites with a way of their own.
        goal_world: (2,) goal or (k, 2) waypoints instead of the settings' own; ignored likewise.
        goal_distance_m: from the start to a random goal, where no goal is given.

    Raises:
        ProfileError: if a file is missing or wrong, or if a random goal finds no room.
    """
    if settings.site in FLOWN_SITES:
        return build_site(settings.site, rng, followers=followers)
    told_spawn, told = told_way(settings, folder)
    spawn = told_spawn if spawn_world is None else np.asarray(spawn_world, np.float64)
    goal = _first(goal_world, told)
    if settings.site is not None:
        return build_site(
            settings.site,
            rng,
            followers=followers,
            spawn_world=spawn,
            goal_world=goal,
            goal_distance_m=goal_distance_m,
        )
    if settings.pillars is not None:
        return _pillars(settings.pillars, rng, followers, spawn, goal, goal_distance_m)
    name, world = _own_world(settings, folder)
    if goal is None:
        goal = _goal_with_room(world, rng, spawn, goal_distance_m, name)
    return Site(name, world, spawn, np.atleast_2d(goal))


def _own_world(settings: WorldSettings, folder: Path) -> tuple[str, World]:
    if settings.file is not None:
        path = folder / settings.file
        return path.stem, World.of(load(path, WorldFile).primitives)
    if settings.mesh is not None:
        path = folder / settings.mesh
        return path.stem, mesh_world(
            path, settings.mesh_voxel_m, settings.mesh_ground_m, settings.mesh_reflectivity
        )
    return "primitives", World.of(settings.primitives or ())


def _first(given: ArrayLike | None, otherwise: ArrayLike | None) -> FloatArray | None:
    chosen = otherwise if given is None else given
    return None if chosen is None else np.asarray(chosen, np.float64)


def _pillars(
    settings: PillarFieldSettings,
    rng: Generator,
    followers: int,
    spawn: FloatArray,
    goal: FloatArray | None,
    goal_distance_m: float,
) -> Site:
    if goal is None:
        azimuth = rng.uniform(-math.pi, math.pi)
        goal = spawn + goal_distance_m * np.array([math.cos(azimuth), math.sin(azimuth)])
    way = np.atleast_2d(goal)
    settings = settings.model_copy(
        update={
            "spawn_world_m": (float(spawn[0]), float(spawn[1])),
            "goal_world_m": (float(way[-1, 0]), float(way[-1, 1])),
            "spawn_clear_m": max(settings.spawn_clear_m, spawn_clear_m(followers) if followers else 0.0),
        }
    )
    on_the_way = [(float(x), float(y), settings.goal_clear_m) for x, y in way[:-1]]
    return Site("pillars", pillar_field(rng, settings, on_the_way), spawn, way)


def _goal_with_room(
    world: World, rng: Generator, spawn: FloatArray, distance_m: float, name: str
) -> FloatArray:
    """Return a place in a random direction that is a metre from any obstacle at all heights of flight."""
    obstacles = world.obstacles()
    azimuths = rng.uniform(-math.pi, math.pi, _GOAL_DRAWS)
    goals = spawn + distance_m * np.column_stack([np.cos(azimuths), np.sin(azimuths)])
    heights = np.array(_GOAL_HEIGHTS_M)
    points = np.empty((_GOAL_DRAWS, len(heights), 3))
    points[..., :2], points[..., 2] = goals[:, None, :], heights
    free = np.flatnonzero(obstacles.clearance(points).min(axis=1) >= _GOAL_ROOM_M)
    if free.size == 0:
        raise ProfileError(
            f"world {name}: no place {distance_m:g} m from the start is free; give it waypoints_world_m"
        )
    return np.asarray(goals[free[0]])
