"""The catalogue of worlds: ten named sites, each built anew from a generator.

Five are open country, where the way is free to choose: the swarm starts in the middle and flies to a goal in
any direction, or along any waypoints. Five are rebuilt from what the paper tells of its real flights; there
the way is part of the site, and it always starts at the origin.

All of them keep free what `sitl.worlds.course` says: a disc round the start in which the whole swarm fits
(4 m for five vehicles) and one of 2.5 m round every waypoint.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from companion.messages import FloatArray
from sitl.worlds import flown_sites, forests, open_country
from sitl.worlds.course import GOAL_DISTANCE_M, Course, open_course
from sitl.worlds.primitives import World


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """A world and the way through it.

    Attributes:
        name: of the site, or of the file it came from.
        world: ground and obstacles.
        spawn_world: (2,) middle of the swarm at the start, m.
        waypoints_world: (k, 2) the leader's way, the last is the goal, m.
    """

    name: str
    world: World
    spawn_world: FloatArray
    waypoints_world: FloatArray


_OpenBuilder = Callable[[Generator, Course], World]
_FlownBuilder = Callable[[Generator, int], tuple[World, Course]]

_OPEN: dict[str, _OpenBuilder] = {
    "none": open_country.nothing,
    "pillars_10m": lambda rng, course: open_country.pillars(rng, course, 10.0),
    "pillars_5m": lambda rng, course: open_country.pillars(rng, course, 5.0),
    "simplified_forest": forests.simplified_forest,
    "forest": forests.forest,
}

_FLOWN: dict[str, _FlownBuilder] = {
    "indoor_blocks": flown_sites.indoor_blocks,
    "indoor_wall": flown_sites.indoor_wall,
    "outdoor_pillars": flown_sites.outdoor_pillars,
    "display_tower": flown_sites.display_tower,
    "short_forest": flown_sites.short_forest,
}

OPEN_SITES = tuple(_OPEN)
"""Sites whose goal or waypoints can be chosen."""

FLOWN_SITES = tuple(_FLOWN)
"""Sites with a way of their own."""

SITE_NAMES = OPEN_SITES + FLOWN_SITES


def build_site(
    name: str,
    rng: Generator,
    *,
    followers: int,
    spawn_world: ArrayLike = (0.0, 0.0),
    goal_world: ArrayLike | None = None,
    goal_distance_m: float = GOAL_DISTANCE_M,
) -> Site:
    """Build one scene of a site; equal generators give equal scenes.

    Args:
        name: one of `SITE_NAMES`.
        rng: draws everything that the name leaves open.
        followers: how many fly behind the leader; the free disc at the start grows with them.
        spawn_world: (2,) middle of the start, in open country.
        goal_world: (2,) goal or (k, 2) waypoints in open country; by default one goal in a random direction.
        goal_distance_m: from the start to that one.

    Raises:
        ValueError: if there is no such site, or if a way is given for one that has its own.
    """
    if name not in SITE_NAMES:
        raise ValueError(f"no site is called {name!r}; there are {', '.join(SITE_NAMES)}")
    if name in _FLOWN:
        if goal_world is not None or np.any(np.asarray(spawn_world) != 0.0):
            raise ValueError(f"the way of the site {name} is part of it: no other start or goal can be given")
        world, course = _FLOWN[name](rng, followers)
        return Site(name, world, course.spawn_world, course.waypoints_world)
    course = open_course(
        rng,
        followers=followers,
        spawn_world=spawn_world,
        goal_world=goal_world,
        goal_distance_m=goal_distance_m,
    )
    world = _OPEN[name](rng, course)
    return Site(name, world, course.spawn_world, course.waypoints_world)
