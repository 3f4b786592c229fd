import math

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from sitl.worlds.bodies import Bodies, Body, poses_midway
from sitl.worlds.primitives import Box, Capsule, Cylinder, Ground, Sphere, World
from tests.sitl.worlds.oracle import (
    AnyPrimitive,
    follow_ray,
    random_directions,
    random_primitives,
    signed_distance,
)

RANGE_M = 30.0
PARTS: list[AnyPrimitive] = [
    Box(centre_world_m=(0.1, 0.0, 0.0), size_m=(0.8, 0.5, 0.3), yaw_deg=20.0),
    Capsule(start_world_m=(-0.6, -0.6, 0.1), end_world_m=(0.6, 0.6, 0.1), radius_m=0.08),
    Cylinder(start_world_m=(0.0, 0.0, 0.1), end_world_m=(0.0, 0.0, 0.5), radius_m=0.15),
    Sphere(centre_world_m=(0.0, 0.3, -0.4), radius_m=0.2),
]


def _random_poses(rng: np.random.Generator, n: int, extent: float) -> tuple[FloatArray, FloatArray]:
    return rng.uniform(-extent, extent, (n, 3)), rotation.exp(rng.uniform(-1.5, 1.5, (n, 3)))


def _one_by_one(
    world: World, p: FloatArray, q: FloatArray, origins: FloatArray, directions: FloatArray
) -> FloatArray:
    """Cast against the world and, in its own frame, against each body alone, and take the nearest."""
    ranges = [world.cast(origins, directions, RANGE_M).ranges]
    for place, attitude in zip(p, q, strict=True):
        back = rotation.conjugate(attitude)
        local = World.of(PARTS).cast(
            rotation.rotate(back, origins - place), rotation.rotate(back, directions), RANGE_M
        )
        ranges.append(local.ranges)
    return np.asarray(np.min(ranges, axis=0))


def test_a_tilted_body_is_hit_where_the_signed_distance_in_its_own_frame_changes_sign() -> None:
    rng = np.random.default_rng(2)
    p, q = _random_poses(rng, 1, 2.0)
    world = Bodies(World.of([]), [Body.of(PARTS)]).at(p, q)
    origins = rng.uniform(-4.0, 4.0, (120, 3))
    directions = p + rng.uniform(-0.7, 0.7, (120, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = world.cast(origins, directions, RANGE_M)
    back = rotation.conjugate(q[0])
    compared = 0
    for i in range(len(origins)):
        o, d = rotation.rotate(back, origins[i] - p[0]), rotation.rotate(back, directions[i])
        found = [follow_ray(part, o, d, 15.0) for part in PARTS]
        expected, nearest_miss = min(each[0] for each in found), min(each[1] for each in found)
        if nearest_miss < 0.02 and expected > hits.ranges[i] + 1e-6:
            continue  # grazing: the oracle's steps may miss what the formula hits
        compared += 1
        if math.isinf(expected):
            assert hits.indices[i] == -1
        else:
            assert hits.ranges[i] == pytest.approx(expected, abs=1e-6)
            assert found[hits.indices[i]][0] == pytest.approx(expected, abs=1e-6)
    assert compared > 100
    assert np.isfinite(hits.ranges).sum() > 40


def test_culling_loses_no_hit_among_many_bodies() -> None:
    rng = np.random.default_rng(4)
    p, q = _random_poses(rng, 19, 8.0)
    static = World.of(random_primitives(rng, 20, 12.0))
    world = Bodies(static, [Body.of(PARTS)] * 19).at(p, q)
    origins = rng.uniform(-0.3, 0.3, (4000, 3))
    directions = random_directions(rng, 4000)
    hits = world.cast(origins, directions, RANGE_M)
    np.testing.assert_allclose(hits.ranges, _one_by_one(static, p, q, origins, directions), atol=1e-9)
    bodies = world.bodies_of(hits.indices)
    assert len(np.unique(bodies[bodies >= 0])) > 10
    struck = np.flatnonzero(bodies >= 0)
    points = origins[struck] + hits.ranges[struck, None] * directions[struck]
    reach = np.linalg.norm(points - p[bodies[struck]], axis=1)
    assert reach.max() <= Body.of(PARTS).radius_m + 1e-9


def test_angles_of_incidence_turn_with_the_body() -> None:
    plate = Body.of([Box(centre_world_m=(0.0, 0.0, 0.0), size_m=(0.02, 1.0, 1.0))])
    for degrees in (0.0, 30.0, 60.0):
        q = rotation.exp([0.0, math.radians(degrees), 0.0])
        world = Bodies(World.of([]), [plate]).at([[3.0, 0.0, 0.0]], [q])
        hits = world.cast([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], RANGE_M)
        assert hits.cosines[0] == pytest.approx(math.cos(math.radians(degrees)), abs=1e-9)


def test_clearances_see_bodies_as_the_signed_distance_does() -> None:
    rng = np.random.default_rng(9)
    p, q = _random_poses(rng, 3, 1.5)
    world = Bodies(World.of([Ground(height_m=-6.0)]), [Body.of(PARTS)] * 3).at(p, q)
    points = rng.uniform(-3.0, 3.0, (300, 3))
    expected = points[:, 2] + 6.0
    for place, attitude in zip(p, q, strict=True):
        local = rotation.rotate(rotation.conjugate(attitude), points - place)
        for part in PARTS:
            expected = np.minimum(expected, signed_distance(part, local))
    outside = expected > 0.0  # inside several parts at once, the least depth is not defined the same way
    np.testing.assert_allclose(world.clearance(points)[outside], expected[outside], atol=1e-9)
    contact = world.first_contact(p[0] + [5.0, 0.0, 0.0], p[0], 0.1)
    assert 0.0 < contact < 1.0


def test_blades_turn_about_their_own_hubs_and_nothing_else_moves() -> None:
    blade = Capsule(start_world_m=(1.0, 0.9, 0.0), end_world_m=(1.0, 1.1, 0.0), radius_m=0.01)
    body = Body.of([Sphere(centre_world_m=(0.0, 0.0, 0.0), radius_m=0.1), blade], spinning=[1])
    bodies = Bodies(World.of([Ground()]), [body, body])
    level = np.tile(rotation.IDENTITY, (2, 1))
    still = bodies.at([[0.0, 0.0, 1.0], [5.0, 0.0, 1.0]], level)
    turned = bodies.at([[0.0, 0.0, 1.0], [5.0, 0.0, 1.0]], level, turns=[0.0, 0.5 * math.pi])
    np.testing.assert_allclose(turned.rows[:4], still.rows[:4], atol=1e-12)
    start, axis = turned.rows[4, :3], turned.rows[4, 3:6]
    np.testing.assert_allclose(start + 0.1 * axis, [1.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.abs(axis), [1.0, 0.0, 0.0], atol=1e-12)


def test_obstacles_keep_the_bodies_and_their_numbers() -> None:
    static = World.of([Ground(), Sphere(centre_world_m=(0.0, 9.0, 0.0), radius_m=0.5)])
    world = Bodies(static, [Body.of(PARTS)] * 2).at(
        [[3.0, 0.0, 0.0], [0.0, -4.0, 0.0]], np.tile(rotation.IDENTITY, (2, 1))
    )
    for seen in (world, world.obstacles()):
        hits = seen.cast(np.zeros((3, 3)), [[1, 0, 0], [0, -1, 0], [0, 1, 0]], RANGE_M)
        assert seen.bodies_of(hits.indices).tolist() == [0, 1, -1]
        assert seen.bounds_xy()[1].tolist() == [0.5, 9.5]


def test_what_cannot_be_a_body_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one part"):
        Body.of([])
    with pytest.raises(ValueError, match="ground plane"):
        Body.of([Ground()])
    with pytest.raises(ValueError, match="cannot spin"):
        Body.of(PARTS, spinning=[0])
    world = Bodies(World.of([]), [Body.of(PARTS)])
    with pytest.raises(ValueError, match=r"need \(b, 3\)"):
        world.at(np.zeros((2, 3)), np.zeros((2, 4)))
    occupied = world.at(np.zeros((1, 3)), [rotation.IDENTITY])
    with pytest.raises(ValueError, match="before bodies"):
        occupied.joined(World.of([]))
    with pytest.raises(ValueError, match="together"):
        Bodies(occupied, [])


def test_no_bodies_change_nothing() -> None:
    static = World.of([Ground(), Sphere(centre_world_m=(2.0, 0.0, 1.0), radius_m=0.5)])
    world = Bodies(static, []).at(np.empty((0, 3)), np.empty((0, 4)), turns=[])
    rays = random_directions(np.random.default_rng(0), 50)
    origins = np.tile([0.0, 0.0, 1.0], (50, 1))
    np.testing.assert_array_equal(
        world.cast(origins, rays, RANGE_M).ranges, static.cast(origins, rays, RANGE_M).ranges
    )


def test_poses_midway_lie_between_whatever_the_sign_of_the_quaternion() -> None:
    q_start, q_end = rotation.from_yaw(np.array([0.2])), rotation.from_yaw(np.array([0.3]))
    for sign in (1.0, -1.0):
        p, q = poses_midway(np.zeros((1, 3)), q_start, np.ones((1, 3)), sign * q_end)
        np.testing.assert_allclose(p, 0.5)
        assert rotation.yaw_of(q)[0] == pytest.approx(0.25)
