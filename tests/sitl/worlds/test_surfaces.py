"""Worlds from arrays are those that the models give one by one."""

import math

import numpy as np
import pytest

from sitl.worlds.bodies import Bodies, Body
from sitl.worlds.primitives import Box, Capsule, Cylinder, Ground, Sphere, World
from sitl.worlds.surfaces import boxes, capsules, cylinders, ground, spheres, together

RNG = np.random.default_rng(3)
N = 20


def triple(row: np.ndarray) -> tuple[float, float, float]:
    return float(row[0]), float(row[1]), float(row[2])


def assert_same(fast: World, slow: World) -> None:
    np.testing.assert_array_equal(fast.kinds, slow.kinds)
    np.testing.assert_allclose(fast.rows, slow.rows, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(fast.discs, slow.discs, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(fast.reflectivity, slow.reflectivity)
    np.testing.assert_array_equal(fast.retro_reflective, slow.retro_reflective)
    for name in ("kinds", "rows", "discs", "reflectivity", "retro_reflective"):
        assert getattr(fast, name).dtype == getattr(slow, name).dtype
        assert getattr(fast, name).flags["C_CONTIGUOUS"]


def test_arrays_give_the_same_worlds_as_models() -> None:
    starts, ends = RNG.uniform(-5.0, 5.0, (2, N, 3))
    radii, shades = RNG.uniform(0.1, 1.0, N), RNG.random(N)
    sizes, yaws = RNG.uniform(0.1, 3.0, (N, 3)), RNG.uniform(-3.0, 3.0, N)
    fast = together(
        ground(0.2, -0.1),
        spheres(starts, radii, shades),
        cylinders(starts, ends, radii, shades),
        capsules(starts, ends, radii, shades),
        boxes(starts, sizes, yaws, shades),
    )
    rows = list(zip(starts, ends, radii.tolist(), shades.tolist(), sizes, yaws.tolist(), strict=True))
    slow = World.of(
        [
            Ground(reflectivity=0.2, height_m=-0.1),
            *(Sphere(centre_world_m=triple(a), radius_m=r, reflectivity=s) for a, _, r, s, _, _ in rows),
            *(
                Cylinder(start_world_m=triple(a), end_world_m=triple(b), radius_m=r, reflectivity=s)
                for a, b, r, s, _, _ in rows
            ),
            *(
                Capsule(start_world_m=triple(a), end_world_m=triple(b), radius_m=r, reflectivity=s)
                for a, b, r, s, _, _ in rows
            ),
            *(
                Box(centre_world_m=triple(a), size_m=triple(c), yaw_deg=math.degrees(yaw), reflectivity=s)
                for a, _, _, s, c, yaw in rows
            ),
        ]
    )
    assert_same(fast, slow)


def test_none_of_a_kind_is_an_empty_world() -> None:
    none = np.zeros((0, 3))
    empty = np.zeros(0)
    for world in (
        spheres(none, empty, empty),
        cylinders(none, none, empty, empty),
        boxes(none, none, empty, empty),
    ):
        assert_same(world, World.of([]))


def test_worlds_with_bodies_are_not_joined() -> None:
    body = Body.of([Sphere(centre_world_m=(0.0, 0.0, 0.0), radius_m=0.1)])
    moving = Bodies(ground(), [body]).at(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))
    with pytest.raises(ValueError, match="before bodies enter"):
        together(ground(), moving)
