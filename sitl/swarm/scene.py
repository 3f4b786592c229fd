"""One trial's scene: the same for every method and for both fidelities."""

import hashlib
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.random import Generator, SeedSequence

from companion.messages import FloatArray
from sitl.swarm.leader_plan import plan_leader
from sitl.swarm.settings import SwarmSettings
from sitl.swarm.spawn import spawn
from sitl.worlds.primitives import World
from sitl.worlds.settings import WorldSettings, site_of, told_way
from sitl.worlds.sites import FLOWN_SITES, SITE_NAMES, build_site

_ROOM_M = 1.2
_SEARCH_M = 4.0
_SEARCH_STEP_M = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class SwarmScene:
    """A world with a swarm ready to fly in it; number 0 is the leader.

    Attributes:
        seed: from which everything random in the trial comes.
        world: what can be seen and hit.
        starts_world: (n, 3) where each hovers when the followers are let go, m.
        yaws: (n,) heading of each, rad.
        waypoints_world: (k, 3) the leader's way; the last is the goal.
        holds_s: (k,) pause of the leader at each of them; all but the last are equal or zero.
        speed_mps: the leader's cruise speed.
        timeout_s: the trial has failed if it lasts longer.
        scene_hash: short digest of all the above.
        wait_s: standstill of the leader at the start.
        ramp_s: from there to its cruise speed.
    """

    seed: int
    world: World
    starts_world: FloatArray
    yaws: FloatArray
    waypoints_world: FloatArray
    holds_s: FloatArray
    speed_mps: float
    timeout_s: float
    scene_hash: str
    wait_s: float = 1.0
    ramp_s: float = 1.0


def set_scene(
    settings: SwarmSettings, world: WorldSettings | str, seed: int, *, folder: Path = Path()
) -> SwarmScene:
    """Build the scene of one trial; equal arguments give equal scenes.

    Args:
        settings: of the swarm.
        world: settings of the world, or the name of a site.
        seed: everything random comes from it.
        folder: to which files named in the world's settings are relative.

    Raises:
        ValueError: if there is no such site, a way is given for one that has its own, or the start is not
            free.
        ProfileError: if a file of the world is missing or wrong.
    """
    if isinstance(world, str):
        world = _site_settings(world)
    spawn_world, told = told_way(world, folder)
    if world.site in FLOWN_SITES:
        if settings.waypoints_m is not None:
            raise ValueError(f"the site {world.site} has a way of its own: take waypoints_m away")
        site = build_site(world.site, _generator(seed, "world"), followers=settings.followers)
        built, spawn_world = site.world, site.spawn_world
        plan = plan_leader(
            settings.leader, spawn_world, site.waypoints_world, _generator(seed, "leader"), own_way=True
        )
    else:
        way = _way(settings, spawn_world, told, _generator(seed, "way"))
        plan = plan_leader(settings.leader, spawn_world, way, _generator(seed, "leader"))
        built = site_of(
            world,
            _generator(seed, "world"),
            folder=folder,
            followers=settings.followers,
            spawn_world=spawn_world,
            goal_world=plan.waypoints_world,
        ).world
    starts, yaws = spawn(settings, built, spawn_world, _generator(seed, "spawn"))
    waypoints = _freed(built, plan.waypoints_world, float(starts[0, 2]))
    low, high = settings.leader.speed_mps
    speed = float(_generator(seed, "speed").uniform(low, high))
    length = float(np.hypot(*np.diff(np.vstack([starts[0, :2], waypoints[:, :2]]), axis=0).T).sum())
    scene = SwarmScene(
        seed=seed,
        world=built,
        starts_world=starts,
        yaws=yaws,
        waypoints_world=waypoints,
        holds_s=plan.holds_s,
        speed_mps=speed,
        timeout_s=2.0 * length / speed + float(plan.holds_s.sum()) + settings.termination.spare_time_s,
        scene_hash="",
        wait_s=settings.leader.wait_s,
        ramp_s=settings.leader.ramp_s,
    )
    return replace(scene, scene_hash=_digest(scene))


def _generator(seed: int, consumer: str) -> Generator:
    return np.random.default_rng(SeedSequence(seed, spawn_key=tuple(ord(letter) for letter in consumer)))


def _site_settings(name: str) -> WorldSettings:
    if name not in SITE_NAMES:
        raise ValueError(f"no site is called {name!r}; there are {', '.join(SITE_NAMES)}")
    return WorldSettings.model_validate({"site": name})


def _way(
    settings: SwarmSettings, spawn_world: FloatArray, told: FloatArray | None, rng: Generator
) -> FloatArray:
    """Return the waypoints (k, 2) in open country, m: the swarm's own, the world's, or one anywhere."""
    azimuth = rng.uniform(-math.pi, math.pi)
    if settings.waypoints_m is not None:
        return np.array(settings.waypoints_m, np.float64)
    if told is not None:
        return told
    return spawn_world + settings.goal_distance_m * np.array([[math.cos(azimuth), math.sin(azimuth)]])


def _freed(world: World, way_world: FloatArray, height: float) -> FloatArray:
    """Return waypoints (k, 3) at a height, moved to the nearest free place where they lie too near to one."""
    waypoints = np.column_stack([way_world, np.full(len(way_world), height)])
    obstacles = world.obstacles()
    if len(obstacles) == 0:
        return waypoints
    steps = np.arange(-_SEARCH_M, _SEARCH_M + 1e-9, _SEARCH_STEP_M)
    offsets = np.stack([axis.ravel() for axis in np.meshgrid(steps, steps, [0.0], indexing="ij")], axis=1)
    offsets = offsets[np.argsort(np.hypot(offsets[:, 0], offsets[:, 1]), kind="stable")]
    for row in np.flatnonzero(obstacles.clearance(waypoints) < _ROOM_M):
        places = waypoints[row] + offsets
        rooms = obstacles.clearance(places)
        free = np.flatnonzero(rooms >= _ROOM_M)
        waypoints[row] = places[free[0] if len(free) else np.argmax(rooms)]
    return waypoints


def _digest(scene: SwarmScene) -> str:
    digest = hashlib.sha256()
    world = scene.world
    for array in (
        world.kinds,
        world.rows,
        scene.starts_world,
        scene.yaws,
        scene.waypoints_world,
        scene.holds_s,
    ):
        digest.update(np.ascontiguousarray(array).tobytes())
    numbers = [scene.speed_mps, scene.timeout_s, scene.wait_s, scene.ramp_s]
    digest.update(np.array(numbers).tobytes())
    digest.update(scene.seed.to_bytes(16, "little"))
    return digest.hexdigest()[:16]
