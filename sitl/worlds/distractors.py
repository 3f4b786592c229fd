"""Things that shine like taped UAVs and are none: signs, taped poles and pillars, people in vests."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from pydantic import Field

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.settings import Settings
from sitl.worlds.bodies import Body
from sitl.worlds.primitives import Box, Capsule, Cylinder, Primitive, World
from sitl.worlds.raycast_kernels import CYLINDER

_TAPE_LIFT_M = 0.001
_PERSON_RADIUS_M = 0.22
_ATTEMPTS = 1000


class DistractorSettings(Settings):
    """How many of each kind stand in a world, and where."""

    signs: int = Field(default=4, ge=0, le=100)
    """Traffic signs: plates of 0.4 to 0.9 m on posts."""
    plates: int = Field(default=4, ge=0, le=100)
    """Plates of a UAV's size on posts of a flying UAV's height."""
    taped_poles: int = Field(default=4, ge=0, le=100)
    """Thin poles with a band of tape."""
    taped_pillars: int = Field(default=4, ge=0, le=100)
    """Pillars of the world that get a band of tape, as many as there are."""
    people: int = Field(default=3, ge=0, le=20)
    """People in vests with two bands of tape."""
    walking_mps: float = Field(default=0.8, ge=0.0, le=3.0)
    """Greatest speed at which people walk; every third stands still."""
    nearest_m: float = Field(default=2.0, ge=0.0, le=100.0)
    """Least distance to the middle of the world."""
    farthest_m: float = Field(default=14.0, gt=0.0, le=200.0)
    """Greatest distance to the middle of the world."""
    room_m: float = Field(default=1.3, ge=0.0, le=20.0)
    """Least distance to where vehicles fly."""


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """A person who walks to and fro.

    Attributes:
        middle: (2,) of the way.
        reach: (2,) from there to its one end.
        rate: of the swing, rad/s; 0 for one who stands.
        phase: of the swing, rad.
    """

    middle: FloatArray
    reach: FloatArray
    rate: float
    phase: float

    def at(self, t_s: float) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) of the feet and attitude (4,) at a time."""
        swing = np.sin(self.rate * t_s + self.phase)
        place = self.middle + swing * self.reach
        return np.append(place, 0.0), rotation.from_yaw(np.arctan2(self.reach[1], self.reach[0]))


@dataclass(frozen=True, slots=True, eq=False)
class Distractors:
    """What was placed.

    Attributes:
        fixed: things that stand.
        people: (k,) how each looks.
        walks: (k,) how each walks.
    """

    fixed: World
    people: tuple[Body, ...]
    walks: tuple[Walk, ...]

    def poses(self, t_s: float) -> tuple[FloatArray, FloatArray]:
        """Return positions (k, 3) and attitudes (k, 4) of the people at a time."""
        placed = [walk.at(t_s) for walk in self.walks]
        return (
            np.array([p for p, _ in placed]).reshape(-1, 3),
            np.array([q for _, q in placed]).reshape(-1, 4),
        )


def no_distractors() -> Distractors:
    """Return nothing at all."""
    return Distractors(World.of([]), (), ())


def place_distractors(
    rng: Generator, world: World, path_world: FloatArray, settings: DistractorSettings
) -> Distractors:
    """Return distractors at random places that keep clear of a flight and of the world's primitives.

    Args:
        rng: of places and looks; equal generators give equal distractors.
        world: where they are to stand.
        path_world: (n, 3) points where vehicles fly.
        settings: how many of each kind, and where. Fewer are placed where no room is found.
    """
    obstacles = world.obstacles()
    fixed: list[Primitive] = []

    def place(draw: Callable[[Generator, float, float], list[Primitive]], count: int) -> None:
        for _ in range(_ATTEMPTS):
            if count == 0:
                return
            thing = draw(rng, *_somewhere(rng, settings))
            alone = World.of(thing)
            base = np.append(alone.discs[0, :2], 0.0)
            if len(obstacles) and obstacles.clearance(base) < 0.5:
                continue
            if fixed and World.of(fixed).clearance(base) < 1.0:
                continue
            if alone.clearance(path_world).min() >= settings.room_m:
                fixed.extend(thing)
                count -= 1

    place(_sign, settings.signs)
    place(_plate, settings.plates)
    place(_taped_pole, settings.taped_poles)
    fixed.extend(_bands_on_pillars(rng, world, settings.taped_pillars))
    standing = obstacles.joined(World.of(fixed))
    walks = _walks(rng, standing, path_world, settings)
    return Distractors(World.of(fixed), tuple(person(rng) for _ in walks), walks)


def person(rng: Generator) -> Body:
    """Return a standing person of random height in a vest; the origin is between the feet."""
    height = float(rng.uniform(1.6, 1.9))
    low = 0.62 * height
    return Body.of(
        [
            Capsule(
                start_world_m=(0.0, 0.0, _PERSON_RADIUS_M),
                end_world_m=(0.0, 0.0, height - _PERSON_RADIUS_M),
                radius_m=_PERSON_RADIUS_M,
                reflectivity=float(rng.uniform(0.2, 0.6)),
            ),
            *(
                _band(0.0, 0.0, z, 0.05, _PERSON_RADIUS_M, float(rng.uniform(0.8, 0.95)))
                for z in (low, low + 0.25)
            ),
        ]
    )


def _somewhere(rng: Generator, settings: DistractorSettings) -> tuple[float, float]:
    distance = np.sqrt(rng.uniform(settings.nearest_m**2, settings.farthest_m**2))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return float(distance * np.cos(angle)), float(distance * np.sin(angle))


def _band(x: float, y: float, z: float, width_m: float, radius_m: float, strength: float) -> Cylinder:
    """Return a band of tape around an upright thing, centred at height z."""
    return Cylinder(
        start_world_m=(x, y, z - 0.5 * width_m),
        end_world_m=(x, y, z + 0.5 * width_m),
        radius_m=radius_m + _TAPE_LIFT_M,
        reflectivity=strength,
        retro_reflective=True,
    )


def _post(x: float, y: float, height_m: float, radius_m: float) -> Cylinder:
    return Cylinder(
        start_world_m=(x, y, 0.0), end_world_m=(x, y, height_m), radius_m=radius_m, reflectivity=0.4
    )


def _board(
    rng: Generator, x: float, y: float, z: float, width_m: float, height_m: float, strength: float
) -> list[Primitive]:
    """Return a plate on the front of a post."""
    yaw = float(rng.uniform(-np.pi, np.pi))
    ahead = np.array([np.cos(yaw), np.sin(yaw)]) * 0.045
    plate = Box(
        centre_world_m=(x + float(ahead[0]), y + float(ahead[1]), z),
        size_m=(0.01, width_m, height_m),
        yaw_deg=float(np.degrees(yaw)),
        reflectivity=strength,
        retro_reflective=True,
    )
    return [_post(x, y, z + 0.5 * height_m, 0.03), plate]


def _sign(rng: Generator, x: float, y: float) -> list[Primitive]:
    size, z = float(rng.uniform(0.4, 0.9)), float(rng.uniform(1.6, 2.4))
    return _board(rng, x, y, z, size, size, float(rng.uniform(0.8, 1.0)))


def _plate(rng: Generator, x: float, y: float) -> list[Primitive]:
    width, height, z = rng.uniform((0.2, 0.08, 1.0), (0.4, 0.25, 2.2)).tolist()
    return _board(rng, x, y, z, width, height, float(rng.uniform(0.75, 0.95)))


def _taped_pole(rng: Generator, x: float, y: float) -> list[Primitive]:
    radius, height = rng.uniform((0.03, 1.8), (0.06, 3.0)).tolist()
    z, width = rng.uniform((0.9, 0.05), (1.6, 0.15)).tolist()
    return [_post(x, y, height, radius), _band(x, y, z, width, radius, float(rng.uniform(0.7, 0.95)))]


def _bands_on_pillars(rng: Generator, world: World, most: int) -> list[Primitive]:
    upright = np.flatnonzero((world.kinds == CYLINDER) & (world.rows[:, 5] > 0.999))
    chosen = rng.permutation(upright)[:most]
    bands: list[Primitive] = []
    for k in chosen:
        x, y, foot, _, _, _, height, radius = world.rows[k].tolist()
        z = foot + min(float(rng.uniform(0.8, 2.2)), 0.9 * height)
        width, strength = rng.uniform((0.05, 0.7), (0.2, 0.95)).tolist()
        bands.append(_band(x, y, z, width, radius, strength))
    return bands


def _walks(
    rng: Generator, standing: World, path_world: FloatArray, settings: DistractorSettings
) -> tuple[Walk, ...]:
    walks: list[Walk] = []
    low = path_world[path_world[:, 2] < 2.5 + settings.room_m]
    for _ in range(_ATTEMPTS):
        if len(walks) == settings.people:
            break
        middle = np.array(_somewhere(rng, settings))
        angle, length = rng.uniform((0.0, 0.8), (2.0 * np.pi, 3.0)).tolist()
        stands = len(walks) % 3 == 2 or settings.walking_mps == 0.0
        speed = 0.0 if stands else float(rng.uniform(0.5, 1.0)) * settings.walking_mps
        walk = Walk(
            middle,
            (0.0 if stands else length) * np.array([np.cos(angle), np.sin(angle)]) + 1e-9,
            speed / length,
            float(rng.uniform(0.0, 2.0 * np.pi)),
        )
        if _is_free(walk, standing, low, settings.room_m):
            walks.append(walk)
    return tuple(walks)


def _is_free(walk: Walk, standing: World, path_world: FloatArray, room_m: float) -> bool:
    way = walk.middle + np.linspace(-1.0, 1.0, 9)[:, None] * walk.reach
    heads = np.column_stack([way, np.full(9, 1.2)])
    if len(standing) and standing.clearance(heads).min() < 0.5:
        return False
    gaps = np.linalg.norm(path_world[:, None, :2] - way[None], axis=2)
    return bool(len(path_world) == 0 or gaps.min() >= room_m + _PERSON_RADIUS_M)
