import math

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from sitl.worlds.primitives import Cylinder, Ground, Primitive, Sphere, World
from tests.sitl.worlds.oracle import random_primitives, signed_distance

PILLAR = Cylinder(start_world_m=(2.0, 0.0, 0.0), end_world_m=(2.0, 0.0, 5.0), radius_m=0.5)


def test_clearance_is_the_least_signed_distance_of_all_primitives() -> None:
    rng = np.random.default_rng(2)
    primitives = random_primitives(rng, 40, 6.0)
    points = rng.uniform(-9.0, 9.0, (500, 3))
    expected = np.min([signed_distance(each, points) for each in primitives], axis=0)
    assert (expected < 0.0).sum() > 10
    np.testing.assert_allclose(World.of(primitives).clearance(points), expected, atol=1e-12)


def test_clearance_keeps_the_shape_of_its_points() -> None:
    assert World.of([Ground()]).clearance(np.ones((2, 5, 3))).shape == (2, 5)
    assert World.of([Ground()]).clearance([0.0, 0.0, 2.5]) == pytest.approx(2.5)
    assert math.isinf(float(World.of([]).clearance([0.0, 0.0, 0.0])))


def test_a_fast_body_cannot_jump_over_a_thin_pillar() -> None:
    thin = World.of([Cylinder(start_world_m=(2.0, 0.0, 0.0), end_world_m=(2.0, 0.0, 5.0), radius_m=0.05)])
    fraction = thin.first_contact([0.0, 0.1, 1.0], [4.0, 0.1, 1.0], 0.15)
    assert 4.0 * float(fraction) == pytest.approx(2.0 - math.sqrt(0.2**2 - 0.1**2), abs=2e-3)
    assert math.isinf(float(thin.first_contact([0.0, 0.21, 1.0], [4.0, 0.21, 1.0], 0.15)))


def test_a_segment_that_starts_in_contact_touches_at_once() -> None:
    world = World.of([PILLAR])
    np.testing.assert_array_equal(
        world.first_contact([[1.4, 0.0, 1.0], [0.0, 0.0, 1.0]], [[1.4, 0.0, 1.0], [0.0, 0.0, 1.0]], 0.2),
        [0.0, math.inf],
    )


def test_contacts_agree_with_fine_sampling() -> None:
    rng = np.random.default_rng(4)
    world = World.of(random_primitives(rng, 20, 4.0))
    starts, ends = rng.uniform(-6.0, 6.0, (2, 200, 3))
    fractions = world.first_contact(starts, ends, 0.3)
    along = np.linspace(0.0, 1.0, 2001)
    for start, end, fraction in zip(starts, ends, fractions, strict=True):
        clearance = world.clearance(start + along[:, None] * (end - start)) - 0.3
        touching = np.flatnonzero(clearance <= 0.0)
        if len(touching):
            assert fraction == pytest.approx(along[touching[0]], abs=2e-3)
        elif not math.isinf(fraction):
            assert clearance.min() < 0.01
    assert 20 < np.isinf(fractions).sum() < 180


def test_obstacles_leave_out_the_ground_only() -> None:
    world = World.of([Ground(), PILLAR])
    assert len(world.obstacles()) == 1
    assert world.obstacles().clearance([0.0, 0.0, 0.3]) == pytest.approx(1.5)


def test_joined_worlds_are_hit_in_both_parts() -> None:
    joined = World.of([PILLAR]).joined(World.of([Sphere(centre_world_m=(-2.0, 0.0, 1.0), radius_m=0.3)]))
    hits = joined.cast([[0.0, 0.0, 1.0]] * 2, [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], 10.0)
    np.testing.assert_array_equal(hits.indices, [0, 1])
    np.testing.assert_allclose(hits.ranges, [1.5, 1.7])


def test_bounds_enclose_all_bounded_primitives() -> None:
    low, high = World.of([Ground(), PILLAR]).bounds_xy()
    np.testing.assert_allclose(low, [1.5, -0.5])
    np.testing.assert_allclose(high, [2.5, 0.5])
    with pytest.raises(ValueError, match="no bounds"):
        World.of([Ground()]).bounds_xy()


def test_a_list_as_written_in_yaml_becomes_a_world() -> None:
    entries = TypeAdapter(list[Primitive]).validate_python(
        [
            {"shape": "ground", "reflectivity": 0.2},
            {"shape": "box", "centre_world_m": [1, 2, 0.5], "size_m": [1, 1, 1], "yaw_deg": 45.0},
            {"shape": "capsule", "start_world_m": [0, 0, 1], "end_world_m": [0, 1, 2], "radius_m": 0.05},
            {"shape": "sphere", "centre_world_m": [5, 5, 1], "radius_m": 0.5, "retro_reflective": True},
        ]
    )
    world = World.of(entries)
    assert len(world) == 4
    np.testing.assert_array_equal(world.retro_reflective, [0, 0, 0, 1])
    np.testing.assert_allclose(world.reflectivity, [0.2, 0.3, 0.3, 0.3])


@pytest.mark.parametrize(
    "entry",
    [
        {"shape": "sphere", "centre_world_m": [0, 0], "radius_m": 1.0},
        {"shape": "sphere", "centre_world_m": [0, 0, 0], "radius_m": 0.0},
        {"shape": "sphere", "centre_world_m": [0, 0, 0], "radius_m": 1.0, "reflectivity": 1.1},
        {"shape": "cylinder", "start_world_m": [0, 0, 0], "end_world_m": [0, 0, 0], "radius_m": 1.0},
        {"shape": "cone"},
    ],
)
def test_an_impossible_primitive_is_refused(entry: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        TypeAdapter(Primitive).validate_python(entry)
