"""Scenes to train in: worlds, starts, and how each leader flies, made once and flown many times.

The leader never reacts to its followers, so its whole flight is known beforehand: `SceneBank` keeps where it
is at every control step.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.random import Generator, SeedSequence
from numpy.typing import NDArray

from companion.control.followers.settings import FollowerSettings
from companion.messages import FloatArray
from sitl.abstract.flight import fly_abstract
from sitl.abstract.settings import AbstractSettings, Preset
from sitl.swarm.scene import SwarmScene, set_scene
from sitl.swarm.settings import Behaviour, SwarmSettings
from sitl.swarm.spawn import cells
from sitl.training.environment_settings import EnvironmentSettings
from sitl.worlds.pillars import PillarFieldSettings
from sitl.worlds.primitives import World
from sitl.worlds.seeds import training_seed
from sitl.worlds.settings import WorldSettings

_Name = TypeVar("_Name", bound=str)

_ATTEMPTS = 50
_CELL_ROOM_M = 0.65
_DENSE = WorldSettings(pillars=PillarFieldSettings(min_gap_m=4.0, size_m=(80.0, 80.0)))
_CHOICE = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One scene of a bank.

    Attributes:
        world: its name.
        behaviour: the leader's.
        perception: known perception under which the leader was flown, and followers shall be.
        seed: from which it came.
        vehicles: for swarms of so many at most, the leader included; the cells are laid out for them.
        cells: (c, 2) where followers may begin, m.
        height: at which the leader begins, m.
        goal: (3,) m.
        timeout_s: when its trial has failed.
        obstacles: first and last + 1 of its rows in the bank.
        flight: first and last + 1 row of the leader's flight in the bank.
    """

    world: str
    behaviour: str
    perception: Preset
    seed: int
    vehicles: int
    cells: FloatArray
    height: float
    goal: FloatArray
    timeout_s: float
    obstacles: tuple[int, int]
    flight: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class SceneBank:
    """All scenes, their obstacles and their leaders' flights, one after the other.

    Attributes:
        scenes: each with its place in the arrays.
        kinds: (M,) kind of each primitive.
        rows: (M, 8) its shape.
        discs: (M, 3) its enclosing vertical cylinder.
        flights: (T, 10) position, velocity and attitude of leaders, step by step, world.
    """

    scenes: tuple[Scene, ...]
    kinds: NDArray[np.int32]
    rows: FloatArray
    discs: FloatArray
    flights: FloatArray

    @property
    def most_primitives(self) -> int:
        """How many primitives the fullest scene has."""
        return max((scene.obstacles[1] - scene.obstacles[0] for scene in self.scenes), default=0)

    def for_swarm(self, vehicles: int) -> NDArray[np.int64]:
        """Return the numbers of the scenes whose cells are laid out for so many vehicles."""
        side = _side(vehicles)
        return np.array([k for k, scene in enumerate(self.scenes) if _side(scene.vehicles) == side])

    @classmethod
    def build(
        cls, settings: EnvironmentSettings, on_scene: Callable[[int, int], None] | None = None
    ) -> "SceneBank":
        """Build as many scenes as the settings want; equal settings give equal banks.

        Args:
            settings: which worlds, leaders and perceptions, in which shares.
            on_scene: called with how many scenes are built, of how many.
        """
        scenes: list[Scene] = []
        obstacles: list[World] = []
        flights: list[FloatArray] = []
        filled, flown = 0, 0
        number = settings.first_scene
        sizes = sorted(set(settings.followers))
        for index in range(settings.scenes):
            followers = settings.followers[index % len(settings.followers)]
            if index < len(sizes):
                # Every size has a scene even in the smallest bank.
                followers = sizes[index]
            scene, world, flight, number = _next_scene(settings, followers, number)
            scene = replace(
                scene, obstacles=(filled, filled + len(world.kinds)), flight=(flown, flown + len(flight))
            )
            filled, flown = scene.obstacles[1], scene.flight[1]
            scenes.append(scene)
            obstacles.append(world)
            flights.append(flight)
            if on_scene is not None:
                on_scene(index + 1, settings.scenes)
        return cls(
            scenes=tuple(scenes),
            kinds=np.concatenate([world.kinds for world in obstacles]),
            rows=np.ascontiguousarray(np.concatenate([world.rows for world in obstacles])),
            discs=np.ascontiguousarray(np.concatenate([world.discs for world in obstacles])),
            flights=np.ascontiguousarray(np.concatenate(flights)),
        )


def _next_scene(
    settings: EnvironmentSettings, followers: int, number: int
) -> tuple[Scene, World, FloatArray, int]:
    """Return the next scene in which the leader alone reaches its goal, and the number after its own."""
    for candidate in range(number, number + _ATTEMPTS):
        built = _scene(settings, followers, training_seed(candidate))
        if built is not None:
            return *built, candidate + 1
    raise ValueError(f"none of {_ATTEMPTS} scenes for {followers} followers can be flown by a leader")


def _scene(
    settings: EnvironmentSettings, followers: int, seed: int
) -> tuple[Scene, World, FloatArray] | None:
    rng = np.random.default_rng(SeedSequence(seed, spawn_key=(_CHOICE,)))
    world = _drawn(rng, settings.worlds)
    behaviour: Behaviour = _drawn(rng, settings.behaviours)
    preset: Preset = _drawn(rng, settings.perceptions)
    swarm = settings.swarm.model_copy(
        update={
            "followers": followers,
            "leader": settings.swarm.leader.model_copy(update={"behaviour": behaviour}),
        }
    )
    try:
        scene = set_scene(swarm, _DENSE if world == "pillars_4m" else world, seed)
    except ValueError:
        return None
    flight = _leader_flight(scene, swarm, settings.abstract(preset))
    if flight is None:
        return None
    obstacles = scene.world.obstacles()
    free = _free_cells(scene, swarm, obstacles)
    if len(free) < followers:
        return None
    return (
        Scene(
            world=world,
            behaviour=behaviour,
            perception=preset,
            seed=seed,
            vehicles=followers + 1,
            cells=free,
            height=float(scene.starts_world[0, 2]),
            goal=scene.waypoints_world[-1].copy(),
            timeout_s=scene.timeout_s,
            obstacles=(0, 0),
            flight=(0, 0),
        ),
        obstacles,
        flight,
    )


def _leader_flight(scene: SwarmScene, swarm: SwarmSettings, abstract: AbstractSettings) -> FloatArray | None:
    """Return where the leader is at every step (T, 10), None if it does not get to its goal."""
    alone = replace(scene, starts_world=scene.starts_world[:1].copy(), yaws=scene.yaws[:1].copy())
    # There is nobody who could lose it.
    rules = swarm.termination.model_copy(update={"leader_unseen_s": math.inf})
    flown = fly_abstract(alone, "flock", FollowerSettings(), abstract, termination=rules, record=True)
    if flown.record.end != "success" or flown.trajectory is None:
        return None
    path = flown.trajectory
    return np.hstack([path.p_world[:, 0], path.v_world[:, 0], path.q_world_body[:, 0]])


def _free_cells(scene: SwarmScene, swarm: SwarmSettings, obstacles: World) -> FloatArray:
    """Return the cells of the start (c, 2) in which followers may begin: all but the leader's own."""
    grid = cells(swarm.followers + 1, swarm.spacing_m)
    apart = np.hypot(*(grid - scene.starts_world[0, :2]).T)
    grid = np.asarray(grid[np.arange(len(grid)) != int(np.argmin(apart))])
    if len(obstacles.kinds) == 0:
        return grid
    places = np.column_stack([grid, np.full(len(grid), scene.starts_world[0, 2])])
    return np.asarray(grid[obstacles.clearance(places) >= _CELL_ROOM_M])


def _side(vehicles: int) -> int:
    return len(cells(vehicles, 1.0))


def _drawn(rng: Generator, shares: Mapping[_Name, float]) -> _Name:
    names = list(shares)
    weights = np.array([shares[name] for name in names])
    return names[int(rng.choice(len(names), p=weights / weights.sum()))]
