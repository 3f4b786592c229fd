"""Worlds of one's own in campaigns: whatever the files say is kept with the results, body by body."""

import math
from pathlib import Path

from pydantic import Field

from companion.errors import ProfileError
from companion.yaml_source import load
from sitl.campaign.definition import WorldEntry
from sitl.worlds.mesh import mesh_world
from sitl.worlds.primitives import Box, Ground, Primitive, World
from sitl.worlds.raycast_kernels import PLANE
from sitl.worlds.settings import WorldFile, WorldSettings


class FlownWorld(WorldEntry):
    """A world of a campaign that needs no other file."""

    primitives: list[Primitive] | None = Field(default=None, max_length=50_001)
    """Its bodies, if it comes from a file or a mesh."""


def flown_world(entry: WorldEntry, folder: Path) -> FlownWorld:
    """Read what a world of a campaign names.

    Args:
        entry: the world.
        folder: of the campaign's file.

    Raises:
        ProfileError: if a file is missing or wrong.
    """
    world = FlownWorld.model_validate(entry.model_dump())
    if entry.file is not None:
        told = load(folder / entry.file, WorldFile)
        spawn, way = entry.spawn_world_m, entry.waypoints_world_m
        return world.model_copy(
            update={
                "primitives": told.primitives,
                "spawn_world_m": told.spawn_world_m if spawn is None else spawn,
                "waypoints_world_m": told.waypoints_world_m if way is None else way,
            }
        )
    if entry.mesh is not None:
        reflectivity = WorldSettings.model_fields["mesh_reflectivity"].default
        built = mesh_world(folder / entry.mesh, entry.mesh_voxel_m, entry.mesh_ground_m, reflectivity)
        if len(built.kinds) == 0:
            raise ProfileError(f"{folder / entry.mesh}: nothing is left of the mesh at this resolution")
        return world.model_copy(update={"primitives": _bodies(built, reflectivity)})
    return world


def settings_of(entry: WorldEntry) -> WorldSettings:
    """Return a campaign's world as a scenario would describe it."""
    own = entry.primitives if isinstance(entry, FlownWorld) else None
    values = {"site": entry.site_name} if own is None else {"primitives": own}
    return WorldSettings.model_validate(
        {**values, "spawn_world_m": entry.spawn_world_m, "waypoints_world_m": entry.waypoints_world_m}
    )


def _bodies(world: World, reflectivity: float) -> list[Ground | Box]:
    """Return ground and boxes, which is what becomes of a mesh, one by one."""
    bodies: list[Ground | Box] = []
    for kind, row in zip(world.kinds, world.rows.tolist(), strict=True):
        if kind == PLANE:
            bodies.append(Ground(height_m=row[2], reflectivity=reflectivity))
        else:
            size = (2.0 * row[3], 2.0 * row[4], 2.0 * row[5])
            yaw_deg = math.degrees(math.atan2(row[7], row[6]))
            centre = (row[0], row[1], row[2])
            bodies.append(Box(centre_world_m=centre, size_m=size, yaw_deg=yaw_deg, reflectivity=reflectivity))
    return bodies
