"""Scenes of swarms by name, for judging how well neighbours are seen; each another one for every seed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator
from pydantic import Field

from companion.settings import Settings
from sitl.bench import courses
from sitl.bench.swarm_flights import LIGHT_WIND
from sitl.bench.swarm_flights import PLAN_START_S as PLAN_START_S
from sitl.bench.swarm_flights import SwarmScene as SwarmScene
from sitl.bench.swarm_flights import SwarmStep as SwarmStep
from sitl.bench.swarm_flights import move as move
from sitl.bench.swarm_flights import stream as stream
from sitl.bench.swarm_motion import Plan, Ring, figure_eight, passes, procession, rings
from sitl.bench.swarm_truth import MapFrame as MapFrame
from sitl.bench.swarm_truth import NeighbourSights as NeighbourSights
from sitl.wind import WindSettings
from sitl.worlds.distractors import DistractorSettings, no_distractors, place_distractors
from sitl.worlds.pillars import PillarFieldSettings, pillar_field
from sitl.worlds.primitives import World
from sitl.worlds.uav_body import UavBodySettings

_HEIGHT_M = 1.6
_ROOM_BETWEEN_M = 1.1
_PASSING_MPS = 2.0
_PLANNED_S = 120.0
_FRESH_WIND = WindSettings(mean_world_mps=(2.0, 1.0, 0.0), gust_mps=0.8, vertical_gust_mps=0.3)


class SwarmSettings(Settings):
    """What can be chosen of a scene."""

    uavs: int = Field(default=5, ge=1, le=20)
    """Vehicles, the ego vehicle included."""
    range_m: float = Field(default=5.0, ge=1.0, le=15.0)
    """Distance of the neighbours in `ring` and `hover`, and of the nearest lanes in `pass`."""
    distractors: DistractorSettings | None = None
    """Signs, vests and tape on poles and pillars that stand about; none by default."""
    body: UavBodySettings = UavBodySettings()
    """How every vehicle looks; its tape can be taken off here."""
    wind: WindSettings | None = None
    """What blows on every vehicle instead of the scene's own weather."""


def _ring(rng: Generator, settings: SwarmSettings) -> SwarmScene:
    _check_room(settings)
    wanted = [Ring(settings.range_m, settings.uavs - 1)]
    return _staged(rng, settings, _open(rng), rings(rng, wanted, _HEIGHT_M, 0.2))


def _hover(rng: Generator, settings: SwarmSettings) -> SwarmScene:
    _check_room(settings)
    wanted = [Ring(settings.range_m, settings.uavs - 1, speed=0.0, breath_m=0.0)]
    return _staged(rng, settings, _open(rng), rings(rng, wanted, _HEIGHT_M, 0.0))


def _pass(rng: Generator, settings: SwarmSettings) -> SwarmScene:
    plan = passes(rng, settings.uavs - 1, settings.range_m, _PASSING_MPS, _HEIGHT_M, 0.2)
    return _staged(rng, settings, _open(rng), plan)


def _crowd(rng: Generator, settings: SwarmSettings) -> SwarmScene:
    others = settings.uavs - 1
    inner, middle = -(-others * 5 // 19), -(-others * 6 // 19)
    wanted = [
        Ring(2.5, min(inner, others), speed=1.2),
        Ring(4.8, max(min(middle, others - inner), 0), speed=1.5),
        Ring(7.5, max(others - inner - middle, 0)),
    ]
    return _staged(rng, settings, _open(rng), rings(rng, wanted, _HEIGHT_M, 0.2))


def _weave(rng: Generator, settings: SwarmSettings) -> SwarmScene:
    plan = figure_eight(rng, settings.uavs, (10.0, 7.0), 0.8, _HEIGHT_M)
    field = PillarFieldSettings(
        size_m=(36.0, 30.0), min_gap_m=3.2, radius_min_m=0.15, radius_max_m=0.35, height_m=4.0,
        spawn_clear_m=0.0,
    )  # fmt: skip
    world = _without_those_near(pillar_field(rng, field), plan)
    return _staged(rng, settings, world, plan)


def _aggressive(rng: Generator, settings: SwarmSettings) -> SwarmScene:
    course = courses.aggressive(rng)
    plan = procession(
        rng, settings.uavs, course.half_axes_m, 3.1, course.height_m, 2.2, 0.6 * course.height_sway_m
    )
    return replace(
        _staged(rng, settings, course.world, plan),
        yaw_rate=course.yaw_rate, yaw_sway=course.yaw_sway, imu=course.imu, vehicle=course.vehicle,
        wind=settings.wind or _FRESH_WIND,
    )  # fmt: skip


def _staged(rng: Generator, settings: SwarmSettings, world: World, plan: Plan) -> SwarmScene:
    """Put the distractors where the plan leaves room."""
    flown = [plan(t) for t in np.arange(0.0, _PLANNED_S, 0.25)]
    take_off = np.column_stack([np.tile(flown[0][0, :2], (8, 1)), np.linspace(0.1, flown[0][0, 2], 8)])
    distractors = (
        place_distractors(rng, world, np.vstack([*flown, take_off]), settings.distractors)
        if settings.distractors
        else no_distractors()
    )
    return SwarmScene(
        world.joined(distractors.fixed), distractors, plan, settings.uavs, body=settings.body,
        wind=settings.wind or LIGHT_WIND,
    )  # fmt: skip


SCENES: dict[str, Callable[[Generator, SwarmSettings], SwarmScene]] = {
    "ring": _ring,
    "hover": _hover,
    "pass": _pass,
    "weave": _weave,
    "aggressive": _aggressive,
    "crowd": _crowd,
}
"""The scenes by name."""


def scene(name: str, seed: int, settings: SwarmSettings | None = None) -> SwarmScene:
    """Return a scene of `SCENES`; equal seeds and settings give equal scenes.

    Raises:
        KeyError: if there is no such scene.
        ValueError: if so many vehicles have no room at that range.
    """
    return SCENES[name](np.random.default_rng([seed, 1]), settings or SwarmSettings())


def _check_room(settings: SwarmSettings) -> None:
    others = settings.uavs - 1
    if others > 1 and 2.0 * settings.range_m * np.sin(np.pi / others) < _ROOM_BETWEEN_M:
        raise ValueError(f"a ring of {settings.range_m} m has no room for {others} vehicles")


def _open(rng: Generator) -> World:
    """Return a pillar field free within 16 m of the middle."""
    field = PillarFieldSettings(
        size_m=(60.0, 60.0), min_gap_m=3.5, spawn_clear_m=16.5, radius_min_m=0.2, radius_max_m=0.6
    )
    return pillar_field(rng, field)


def _without_those_near(world: World, plan: Plan) -> World:
    """Remove pillars that would stand where a vehicle starts."""
    places = plan(0.0)[:, :2]
    gaps = np.linalg.norm(world.discs[:, None, :2] - places[None], axis=2) - world.discs[:, 2:]
    keep = ~np.isfinite(world.discs[:, 2]) | (gaps.min(axis=1) > 1.0)
    return World(
        world.kinds[keep], world.rows[keep], world.discs[keep], world.reflectivity[keep],
        world.retro_reflective[keep],
    )  # fmt: skip
