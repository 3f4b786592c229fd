"""Worlds to fly in and the rounds flown there: five by name, each another world for every seed.

Every course is an ellipse with a slow turn about the vertical. What stands in a world is drawn at random
and kept only where it leaves the flight its room, so no course can end in a collision.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from companion.messages import FloatArray
from sitl.dynamics import QuadrotorSettings
from sitl.sensors.imu import ImuSettings
from sitl.sensors.vibration import VibrationSettings
from sitl.worlds.primitives import Box, Capsule, Cylinder, Ground, Primitive, Sphere, World

_PATH_POINTS = 120
_ROOM_M = 1.3
_USUAL_CHIP = ImuSettings()
_USUAL_VEHICLE = QuadrotorSettings()
_Draw = Callable[[Generator], Sequence[Primitive]]


@dataclass(frozen=True)
class Course:
    """An ellipse to be flown around, and the world around it.

    Attributes:
        world: what stands there.
        half_axes_m: of the ellipse about the origin, along x and y.
        height_m: mean height of the flight.
        speed: along the ellipse, m/s.
        yaw_rate: mean turn about the vertical, rad/s.
        yaw_sway: amplitude of its change, rad/s.
        height_sway_m: amplitude of the height's change.
        height_sway_rate: its angular rate, rad/s.
        climb_max: m/s.
        descent_max: m/s.
        imu: the inertial chip and its vibration.
        vehicle: how the vehicle answers.
    """

    world: World
    half_axes_m: tuple[float, float]
    height_m: float
    speed: float
    yaw_rate: float
    yaw_sway: float = 0.4
    height_sway_m: float = 0.3
    height_sway_rate: float = 0.7
    climb_max: float = 1.5
    descent_max: float = 1.0
    imu: ImuSettings = _USUAL_CHIP
    vehicle: QuadrotorSettings = _USUAL_VEHICLE

    def path_world(self) -> FloatArray:
        """Return points (n, 3) between which the flight stays, the take-off included."""
        angles = np.linspace(0.0, 2.0 * np.pi, _PATH_POINTS, endpoint=False)
        lowest, highest = self.height_m - self.height_sway_m, self.height_m + self.height_sway_m
        rounds = [
            np.column_stack(
                [self.half_axes_m[0] * np.cos(angles), self.half_axes_m[1] * np.sin(angles), 0.0 * angles + z]
            )
            for z in np.linspace(lowest, highest, 5)
        ]
        climb = np.zeros((10, 3))
        climb[:, 0], climb[:, 2] = self.half_axes_m[0], np.linspace(0.1, self.height_m, 10)
        return np.concatenate([*rounds, climb])


def field(rng: Generator, pillars: int = 50) -> Course:
    """Return a field of pillars on a plane, free around the course."""
    placed: list[tuple[float, float, float]] = []
    while len(placed) < pillars:
        x, y = rng.uniform(-25.0, 25.0, 2)
        clear = abs(np.hypot(x, y / 0.7) - 12.0) > 2.5
        if clear and all(np.hypot(x - other[0], y - other[1]) > 1.8 for other in placed):
            placed.append((float(x), float(y), float(rng.uniform(0.2, 0.5))))
    cylinders = [_pillar(x, y, 5.0, radius, float(rng.uniform(0.1, 0.8))) for x, y, radius in placed]
    return Course(World.of([Ground(), *cylinders]), (12.0, 8.4), 2.0, 2.5, 0.3)


def hall() -> Course:
    """Return a hall of 16 m x 12 m x 4.5 m with five boxes in it."""
    boxes = [
        ((-6.7, -4.7, 1.0), (1.5, 1.5, 2.0)),
        ((6.2, 4.2, 0.6), (1.5, 1.5, 1.2)),
        ((-0.1, 0.1, 0.5), (1.8, 1.7, 1.0)),
        ((6.8, -4.8, 1.5), (2.0, 1.3, 3.0)),
        ((-7.3, 5.0, 2.25), (0.9, 1.6, 4.5)),
    ]
    return _inside([Box(centre_world_m=centre, size_m=size, reflectivity=0.4) for centre, size in boxes])


def indoor(rng: Generator) -> Course:
    """Return the same hall with other boxes: along the walls, on the floor and in the middle."""
    return _inside(_scattered(rng, _inside([]), _crate, int(rng.integers(5, 10)), 1.0))


def forest(rng: Generator) -> Course:
    """Return tilted trunks with crowns and branches, rocks, and ground in humps."""
    empty = Course(World.of([Ground(reflectivity=0.25)]), (12.0, 8.4), 1.9, 2.2, 0.3, height_sway_m=0.25)
    grown = [
        *_scattered(rng, empty, _hump, 30, 0.7),
        *_scattered(rng, empty, _rock, 20, 0.7),
        *_scattered(rng, empty, _tree, 55, _ROOM_M),
    ]
    return _filled(empty, grown)


def open_field(rng: Generator) -> Course:
    """Return a plain with few, far and small things: bushes, posts, two trees and a hut."""
    empty = Course(World.of([Ground(reflectivity=0.25)]), (10.0, 7.0), 2.0, 2.5, 0.3)
    grown = [
        *_scattered(rng, empty, _bush, 8, 3.0),
        *_scattered(rng, empty, _post, 6, 3.0),
        *_scattered(rng, empty, _lone_tree, 2, 3.0),
        *_scattered(rng, empty, _hut, 1, 3.0),
    ]
    return _filled(empty, grown)


def aggressive(rng: Generator) -> Course:
    """Return pillars and low buildings, flown fast, turning at 90 deg/s, up and down, shaken hard."""
    empty = Course(
        World.of([Ground()]),
        half_axes_m=(13.0, 9.5),
        height_m=2.8,
        speed=3.6,
        yaw_rate=float(np.radians(90.0)),
        yaw_sway=0.3,
        height_sway_m=1.2,
        height_sway_rate=1.3,
        climb_max=3.0,
        descent_max=2.0,
        imu=ImuSettings(vibration=VibrationSettings(accel_rms_mps2=2.5, gyro_rms_radps=0.05)),
        vehicle=QuadrotorSettings(yaw_rate_max_radps=2.5),
    )
    grown = [*_scattered(rng, empty, _tall_pillar, 45, 1.8), *_scattered(rng, empty, _shed, 4, 1.8)]
    return _filled(empty, grown)


COURSES: dict[str, Callable[[Generator], Course]] = {
    "indoor": indoor,
    "pillars": field,
    "forest": forest,
    "open_field": open_field,
    "aggressive": aggressive,
}
"""The courses by name."""


def course(name: str, seed: int) -> Course:
    """Return a course of `COURSES`; equal seeds give equal worlds.

    Raises:
        KeyError: if there is no such course.
    """
    return COURSES[name](np.random.default_rng([seed, 0]))


def _scattered(rng: Generator, flown: Course, draw: _Draw, count: int, room_m: float) -> list[Primitive]:
    """Draw things until `count` of them keep `room_m` to the flight."""
    path = flown.path_world()
    kept: list[Primitive] = []
    while count:
        thing = draw(rng)
        if World.of(thing).clearance(path).min() >= room_m:
            kept += thing
            count -= 1
    return kept


def _filled(empty: Course, things: Sequence[Primitive]) -> Course:
    return replace(empty, world=empty.world.joined(World.of(things)))


def _inside(things: Sequence[Primitive]) -> Course:
    walls = [
        ((0.0, 6.1, 2.25), (16.4, 0.2, 4.5)),
        ((0.0, -6.1, 2.25), (16.4, 0.2, 4.5)),
        ((8.1, 0.0, 2.25), (0.2, 12.4, 4.5)),
        ((-8.1, 0.0, 2.25), (0.2, 12.4, 4.5)),
        ((0.0, 0.0, 4.6), (16.4, 12.4, 0.2)),
    ]
    surfaces = [Box(centre_world_m=centre, size_m=size, reflectivity=0.4) for centre, size in walls]
    return Course(World.of([Ground(), *surfaces, *things]), (5.0, 3.2), 1.8, 2.0, 0.3)


def _ring(rng: Generator, nearest_m: float, farthest_m: float) -> tuple[float, float]:
    """Return a place (x, y) spread evenly over the area between two circles about the origin."""
    distance = np.sqrt(rng.uniform(nearest_m**2, farthest_m**2))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return float(distance * np.cos(angle)), float(distance * np.sin(angle))


def _shade(rng: Generator) -> float:
    return float(rng.uniform(0.1, 0.8))


def _pillar(x: float, y: float, height_m: float, radius_m: float, reflectivity: float) -> Cylinder:
    return Cylinder(
        start_world_m=(x, y, 0.0),
        end_world_m=(x, y, height_m),
        radius_m=radius_m,
        reflectivity=reflectivity,
    )


def _block(rng: Generator, x: float, y: float, size_m: tuple[float, float, float], yaw_deg: float) -> Box:
    return Box(
        centre_world_m=(x, y, 0.5 * size_m[2]), size_m=size_m, yaw_deg=yaw_deg, reflectivity=_shade(rng)
    )


def _sizes(rng: Generator, low_m: Sequence[float], high_m: Sequence[float]) -> tuple[float, float, float]:
    length, width, height = rng.uniform(low_m, high_m).tolist()
    return length, width, height


def _crate(rng: Generator) -> list[Primitive]:
    size = _sizes(rng, (0.6, 0.6, 0.6), (2.0, 2.0, 3.5))
    x, y = rng.uniform((-7.4, -5.4), (7.4, 5.4)).tolist()
    return [_block(rng, x, y, size, float(rng.uniform(-20.0, 20.0)))]


def _shed(rng: Generator) -> list[Primitive]:
    size = _sizes(rng, (3.0, 2.5, 1.8), (7.0, 5.0, 3.0))
    return [_block(rng, *_ring(rng, 0.0, 28.0), size, float(rng.uniform(0.0, 180.0)))]


def _hut(rng: Generator) -> list[Primitive]:
    size = _sizes(rng, (3.0, 2.5, 2.2), (5.0, 4.0, 3.0))
    return [_block(rng, *_ring(rng, 22.0, 32.0), size, float(rng.uniform(0.0, 180.0)))]


def _tall_pillar(rng: Generator) -> list[Primitive]:
    return [_pillar(*_ring(rng, 0.0, 28.0), 6.0, float(rng.uniform(0.2, 0.5)), _shade(rng))]


def _post(rng: Generator) -> list[Primitive]:
    height_m, radius_m = rng.uniform((1.2, 0.05), (2.4, 0.12)).tolist()
    return [_pillar(*_ring(rng, 12.0, 24.0), height_m, radius_m, _shade(rng))]


def _bush(rng: Generator) -> list[Primitive]:
    x, y = _ring(rng, 12.0, 28.0)
    radius_m = float(rng.uniform(0.4, 0.9))
    centre = (x, y, 0.5 * radius_m)
    return [Sphere(centre_world_m=centre, radius_m=radius_m, reflectivity=float(rng.uniform(0.2, 0.5)))]


def _rock(rng: Generator) -> list[Primitive]:
    x, y = _ring(rng, 0.0, 24.0)
    radius_m = float(rng.uniform(0.2, 0.8))
    centre = (x, y, float(rng.uniform(-0.5, 0.3)) * radius_m)
    return [Sphere(centre_world_m=centre, radius_m=radius_m, reflectivity=float(rng.uniform(0.2, 0.5)))]


def _hump(rng: Generator) -> list[Primitive]:
    """Draw the cap of a large sphere: a rise of the ground."""
    x, y = _ring(rng, 0.0, 28.0)
    rise_m, width_m = rng.uniform((0.1, 1.5), (0.6, 5.0)).tolist()
    radius_m = (width_m**2 + rise_m**2) / (2.0 * rise_m)
    return [Sphere(centre_world_m=(x, y, rise_m - radius_m), radius_m=radius_m, reflectivity=0.25)]


def _lone_tree(rng: Generator) -> list[Primitive]:
    return _grown(rng, *_ring(rng, 18.0, 30.0))


def _tree(rng: Generator) -> list[Primitive]:
    return _grown(rng, *_ring(rng, 0.0, 26.0))


def _grown(rng: Generator, x: float, y: float) -> list[Primitive]:
    """Draw a trunk that leans by up to some 10 degrees, two branches and a crown."""
    height_m = float(rng.uniform(5.0, 9.0))
    radius_m = float(rng.uniform(0.08, 0.35))
    lean = rng.normal(0.0, 0.07, 2)
    bark = float(rng.uniform(0.1, 0.4))

    def on_trunk(share: float) -> tuple[float, float, float]:
        rise_m = share * height_m
        return x + float(lean[0]) * rise_m, y + float(lean[1]) * rise_m, rise_m

    parts: list[Primitive] = [
        Cylinder(start_world_m=(x, y, -0.2), end_world_m=on_trunk(1.0), radius_m=radius_m, reflectivity=bark)
    ]
    for share in rng.uniform(0.25, 0.7, 2):
        start = on_trunk(float(share))
        reach_m, angle, rise_m = rng.uniform((0.6, 0.0, 0.1), (1.8, 2.0 * np.pi, 0.9)).tolist()
        tip = (start[0] + reach_m * np.cos(angle), start[1] + reach_m * np.sin(angle), start[2] + rise_m)
        parts.append(
            Capsule(start_world_m=start, end_world_m=tip, radius_m=0.15 * radius_m, reflectivity=bark)
        )
    leaves = float(rng.uniform(0.3, 0.6))
    crown_m = float(rng.uniform(0.8, 1.8))
    parts.append(
        Capsule(
            start_world_m=on_trunk(0.75), end_world_m=on_trunk(1.0), radius_m=crown_m, reflectivity=leaves
        )
    )
    return parts
