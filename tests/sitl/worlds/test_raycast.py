import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geometry import rotation
from sitl.worlds.primitives import Box, Capsule, Cylinder, Ground, Sphere, World
from tests.sitl.worlds.oracle import (
    AnyPrimitive,
    centre_of,
    follow_ray,
    normal_at,
    random_directions,
    random_primitives,
)

RANGE_M = 30.0
LONE: list[AnyPrimitive] = [
    Ground(height_m=-1.0),
    Sphere(centre_world_m=(1.0, 2.0, 0.5), radius_m=0.8),
    Cylinder(start_world_m=(2.0, -1.0, 0.0), end_world_m=(2.0, -1.0, 3.0), radius_m=0.4),
    Cylinder(start_world_m=(-2.0, 0.5, -1.0), end_world_m=(-1.0, 1.5, 2.0), radius_m=0.6),
    Capsule(start_world_m=(-1.0, -2.0, 0.0), end_world_m=(0.5, -2.5, 1.0), radius_m=0.3),
    Box(centre_world_m=(0.0, 3.0, 1.0), size_m=(2.0, 1.0, 3.0), yaw_deg=30.0),
]


@pytest.mark.parametrize("primitive", LONE, ids=lambda primitive: primitive.shape)
def test_a_ray_hits_where_the_signed_distance_changes_sign(primitive: AnyPrimitive) -> None:
    rng = np.random.default_rng(5)
    n = 300
    origins = rng.uniform(-4.0, 4.0, (n, 3))
    # Half of the rays aim at the neighbourhood of the body, or most would miss.
    aims = centre_of(primitive) + rng.uniform(-1.5, 1.5, (n, 3)) - origins
    directions = np.where(np.arange(n)[:, None] % 2 == 0, aims, rng.standard_normal((n, 3)))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = World.of([primitive]).cast(origins, directions, RANGE_M)
    compared = 0
    for i in range(n):
        expected, nearest_miss = follow_ray(primitive, origins[i], directions[i], RANGE_M)
        if nearest_miss < 0.02 and expected > hits.ranges[i] + 1e-6:
            continue  # grazing: the oracle's steps may miss what the formula hits
        compared += 1
        if math.isinf(expected):
            assert math.isinf(hits.ranges[i])
            assert hits.indices[i] == -1
            continue
        assert hits.ranges[i] == pytest.approx(expected, abs=1e-6)
        normal = normal_at(primitive, origins[i] + expected * directions[i])
        assert hits.cosines[i] == pytest.approx(abs(float(normal @ directions[i])), abs=1e-3)
    assert compared > 0.95 * n
    assert np.isfinite(hits.ranges).sum() > 20


def _nearest_one_by_one(
    primitives: list[AnyPrimitive], origins: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cast against each primitive alone, with a list for every sector, and take the nearest."""
    ranges = np.stack([World.of([each]).cast(origins, directions, RANGE_M).ranges for each in primitives])
    return ranges.min(axis=0), ranges.argmin(axis=0)


@pytest.mark.parametrize("spread_m", [0.0, 0.3, 8.0])
def test_culling_by_sector_loses_no_hit(spread_m: float) -> None:
    rng = np.random.default_rng(7)
    primitives = random_primitives(rng, 60, 12.0)
    n = 3000
    origins = rng.uniform(-spread_m, spread_m, (n, 3)) + np.array([0.5, -0.3, 0.2])
    directions = random_directions(rng, n)
    hits = World.of(primitives).cast(origins, directions, RANGE_M)
    expected, index = _nearest_one_by_one(primitives, origins, directions)
    np.testing.assert_array_equal(hits.ranges, expected)
    struck = np.isfinite(expected)
    np.testing.assert_array_equal(hits.indices[struck], index[struck])
    assert 0.3 < struck.mean() < 1.0


def test_every_whole_degree_finds_a_thin_pole() -> None:
    origin = np.array([[3.0, -2.0, 1.0]])
    for azimuth in np.radians(np.arange(360.0)):
        direction = np.array([[math.cos(azimuth), math.sin(azimuth), 0.0]])
        x, y = (origin + 5.0 * direction)[0, :2].tolist()
        pole = Cylinder(start_world_m=(x, y, 0.0), end_world_m=(x, y, 2.0), radius_m=0.05)
        assert World.of([pole]).cast(origin, direction, RANGE_M).ranges[0] == pytest.approx(4.95, abs=1e-9)


@given(yaw=st.floats(-math.pi, math.pi), shift=st.tuples(*[st.floats(-50.0, 50.0)] * 3))
@settings(max_examples=40, deadline=None)
def test_ranges_do_not_change_when_world_and_rays_move_together(
    yaw: float, shift: tuple[float, float, float]
) -> None:
    rng = np.random.default_rng(3)
    origins, directions = rng.uniform(-4.0, 4.0, (200, 3)), random_directions(rng, 200)
    q = rotation.from_yaw(yaw)

    def moved(point: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (rotation.rotate(q, point) + shift).tolist()
        return x, y, z

    there: list[AnyPrimitive] = []
    for primitive in LONE:
        if isinstance(primitive, Ground):
            there.append(Ground(height_m=primitive.height_m + shift[2]))
        elif isinstance(primitive, Box):
            turned = primitive.yaw_deg + math.degrees(yaw)
            there.append(
                Box(centre_world_m=moved(primitive.centre_world_m), size_m=primitive.size_m, yaw_deg=turned)
            )
        elif isinstance(primitive, Sphere):
            there.append(Sphere(centre_world_m=moved(primitive.centre_world_m), radius_m=primitive.radius_m))
        else:
            there.append(
                type(primitive)(
                    start_world_m=moved(primitive.start_world_m),
                    end_world_m=moved(primitive.end_world_m),
                    radius_m=primitive.radius_m,
                )
            )
    here = World.of(LONE).cast(origins, directions, RANGE_M)
    hits = World.of(there).cast(
        rotation.rotate(q, origins) + np.array(shift), rotation.rotate(q, directions), RANGE_M
    )
    same = here.indices == hits.indices
    assert same.sum() >= 199  # at most a ray on an edge
    np.testing.assert_allclose(hits.ranges[same], here.ranges[same], atol=1e-7)
    np.testing.assert_allclose(hits.cosines[same], here.cosines[same], atol=1e-6)


@pytest.mark.parametrize("primitive", LONE[1:], ids=lambda primitive: primitive.shape)
def test_from_inside_a_body_every_ray_hits_its_wall(primitive: AnyPrimitive) -> None:
    directions = random_directions(np.random.default_rng(0), 100)
    hits = World.of([primitive]).cast(np.tile(centre_of(primitive), (100, 1)), directions, RANGE_M)
    assert np.all(np.isfinite(hits.ranges))


def test_a_tangent_ray_hits_just_inside_and_misses_just_outside() -> None:
    world = World.of([Cylinder(start_world_m=(5.0, 0.0, -1.0), end_world_m=(5.0, 0.0, 1.0), radius_m=0.5)])
    origins = np.array([[0.0, 0.5 - 1e-9, 0.0], [0.0, 0.5 + 1e-9, 0.0]])
    hits = world.cast(origins, np.tile([1.0, 0.0, 0.0], (2, 1)), RANGE_M)
    assert hits.ranges[0] == pytest.approx(5.0, abs=1e-3)
    assert hits.cosines[0] < 1e-3
    assert math.isinf(hits.ranges[1])


def test_a_ray_along_the_axis_hits_the_cap() -> None:
    pillar = Cylinder(start_world_m=(1.0, 2.0, 0.0), end_world_m=(1.0, 2.0, 3.0), radius_m=0.5)
    hits = World.of([pillar]).cast([[1.2, 2.0, 5.0]], [[0.0, 0.0, -1.0]], RANGE_M)
    assert hits.ranges[0] == pytest.approx(2.0)
    assert hits.cosines[0] == pytest.approx(1.0)


def test_nothing_is_hit_beyond_the_range_limit_or_in_an_empty_world() -> None:
    ball = World.of([Sphere(centre_world_m=(10.0, 0.0, 0.0), radius_m=1.0)])
    for world, limit in ((ball, 8.9), (World.of([]), 100.0)):
        hits = world.cast([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], limit)
        assert math.isinf(hits.ranges[0])
        assert hits.indices[0] == -1
        assert hits.cosines[0] == 0.0
    assert ball.cast([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], 9.1).ranges[0] == pytest.approx(9.0)


def test_rays_of_the_wrong_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"must both be \(n, 3\)"):
        World.of([]).cast([[0.0, 0.0]], [[1.0, 0.0]], 1.0)
