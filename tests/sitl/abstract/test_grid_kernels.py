import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.occupancy import GridSettings
from sitl.abstract.grid_kernels import draw_grid
from sitl.abstract.settings import AbstractSettings, PerceptionSettings
from sitl.worlds.grid_rays import grid_ranges
from sitl.worlds.primitives import Box, Capsule, Cylinder, Ground, Sphere, World
from sitl.worlds.sites import build_site

GRID = GridSettings()
WHOLE_SPHERE = PerceptionSettings(lowest_elevation_deg=-90.0, highest_elevation_deg=90.0)
NOBODY: FloatArray = np.zeros((0, 3))


def _grid(
    world: World,
    p: tuple[float, float, float],
    yaw: float,
    *,
    settings: AbstractSettings | None = None,
    bodies: FloatArray = NOBODY,
    roles: tuple[int, ...] = (),
    q: FloatArray | None = None,
) -> FloatArray:
    settings = settings or AbstractSettings(perception=WHOLE_SPHERE)
    world = world.obstacles()
    up = np.array([0.0, 0.0, 1.0])
    if q is not None:
        up = rotation.rotate(rotation.from_yaw(-yaw), rotation.rotate(q, up))
    ranges = np.empty((72, 12))
    everything = np.arange(len(world.kinds), dtype=np.int32)
    draw_grid(
        world.kinds, world.rows, world.discs, everything, len(everything), bodies,
        np.array(roles, np.uint8), settings.perception.body_radius_m, *p, yaw,
        np.ascontiguousarray(up), *settings.packed_grid(), ranges,
    )  # fmt: skip
    return ranges


def _compare(ours: FloatArray, rays: FloatArray, *, near: float, missed: float) -> None:
    """Cells agree; rays, being few, may find less and farther points, and never nearer ones."""
    both = np.isfinite(ours) & np.isfinite(rays)
    assert both.sum() > 30
    assert np.all(rays[both] - ours[both] > -1e-6)
    assert np.mean(rays[both] - ours[both] < near) > 0.97
    assert not np.any(np.isfinite(rays) & ~np.isfinite(ours))
    assert np.sum(np.isfinite(ours) & ~np.isfinite(rays)) <= missed * np.isfinite(ours).sum()


@pytest.mark.parametrize("seed", range(3))
def test_the_grid_among_pillars_is_what_many_rays_find(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = build_site("pillars_5m", rng, followers=4).world
    yaw = rng.uniform(-3.0, 3.0)
    p = (float(rng.uniform(-1, 1)), float(rng.uniform(-1, 1)), 1.7)
    rays = grid_ranges(world, np.array(p), yaw, GRID, rays_per_cell=12)
    _compare(_grid(world, p, yaw), rays, near=0.12, missed=0.1)


def test_balls_are_drawn_at_every_bearing_height_and_size() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        offset = rng.uniform(-6.0, 6.0, 3) * np.array([1.0, 1.0, 0.5])
        radius = min(float(rng.uniform(0.2, 1.5)), 0.8 * float(np.linalg.norm(offset)))
        centre = np.array([1.0, -2.0, 3.0]) + offset
        world = World.of([Sphere(centre_world_m=(centre[0], centre[1], centre[2]), radius_m=radius)])
        yaw = float(rng.uniform(-3.0, 3.0))
        rays = grid_ranges(world, np.array([1.0, -2.0, 3.0]), yaw, GRID, rays_per_cell=12)
        ours = _grid(world, (1.0, -2.0, 3.0), yaw)
        both = np.isfinite(ours) & np.isfinite(rays)
        # Rays, being few, may miss a cell's nearest point, but never find a nearer one.
        assert np.all(rays[both] - ours[both] > -1e-9)
        assert np.all(rays[both] - ours[both] < 0.2)
        assert not np.any(np.isfinite(rays) & ~np.isfinite(ours))
        assert np.sum(np.isfinite(ours) & ~np.isfinite(rays)) <= 2


def test_tilted_rods_and_boxes_are_drawn_by_the_very_rays_of_the_oracle() -> None:
    world = World.of(
        [
            Cylinder(start_world_m=(3.0, 1.0, 0.0), end_world_m=(3.6, 2.0, 4.0), radius_m=0.25),
            Capsule(start_world_m=(-2.0, 1.0, 1.0), end_world_m=(-3.0, -1.0, 3.0), radius_m=0.1),
            Box(centre_world_m=(0.0, -4.0, 1.0), size_m=(2.0, 0.5, 3.0), yaw_deg=30.0),
            Cylinder(start_world_m=(2.0, -2.0, 0.0), end_world_m=(2.0, -2.0, 1.0), radius_m=0.5),
            Ground(),
        ]
    )
    settings = AbstractSettings(perception=WHOLE_SPHERE, rays_per_cell=4)
    for yaw in (0.0, 1.0, -2.5):
        rays = grid_ranges(world, np.array([0.2, 0.1, 1.6]), yaw, GRID, rays_per_cell=4)
        ours = _grid(world, (0.2, 0.1, 1.6), yaw, settings=settings)
        assert np.isfinite(ours).sum() > 40
        np.testing.assert_allclose(ours, rays, atol=1e-9)


def test_a_forest_looks_as_many_rays_see_it() -> None:
    rng = np.random.default_rng(3)
    world = build_site("forest", rng, followers=4).world
    rays = grid_ranges(world, np.array([0.0, 0.0, 1.8]), 0.3, GRID, rays_per_cell=8)
    ours = _grid(
        world, (0.0, 0.0, 1.8), 0.3, settings=AbstractSettings(perception=WHOLE_SPHERE, rays_per_cell=4)
    )
    both = np.isfinite(ours) & np.isfinite(rays)
    assert both.sum() > 50
    # Thin branches fall between rays, ours and theirs; nothing else may.
    apart = np.abs(ours[both] - rays[both])
    assert np.median(apart) < 0.05
    assert np.mean(apart < 0.25) > 0.9
    assert np.sum(np.isfinite(ours) != np.isfinite(rays)) < 0.2 * both.sum()


def test_an_unknown_vehicle_is_an_obstacle_and_a_known_one_hides_what_is_behind_it() -> None:
    wall = World.of([Box(centre_world_m=(4.0, 0.0, 2.0), size_m=(0.2, 8.0, 4.0))])
    body = np.array([[0.0, 0.0, 1.6], [1.0, 0.0, 1.6]])
    alone = _grid(wall, (0.0, 0.0, 1.6), 0.0)
    unknown = _grid(wall, (0.0, 0.0, 1.6), 0.0, bodies=body, roles=(0, 1))
    known = _grid(wall, (0.0, 0.0, 1.6), 0.0, bodies=body, roles=(0, 2))
    nearer = unknown < alone
    assert nearer.any()
    assert np.all(np.abs(unknown[nearer] - 0.9) < 0.15)
    hidden = ~np.isfinite(known) & np.isfinite(alone)
    assert hidden.any()
    # Only cells that the body covers wholly lose what is behind it.
    assert np.all(nearer[hidden])
    assert np.array_equal(known[~hidden], alone[~hidden])


def test_the_field_of_view_tilts_with_the_body() -> None:
    wall = World.of([Box(centre_world_m=(x, 0.0, 2.0), size_m=(0.2, 8.0, 8.0)) for x in (4.0, -4.0)])
    settings = AbstractSettings()
    level = _grid(wall, (0.0, 0.0, 2.0), 0.0, settings=settings, q=rotation.from_yaw(0.0))
    nose_up = _grid(
        wall, (0.0, 0.0, 2.0), 0.0, settings=settings, q=rotation.exp(np.array([0.0, np.radians(-12.0), 0.0]))
    )
    assert np.isfinite(level[[0, 36], 0]).tolist() == [True, True]
    assert np.isfinite(nose_up[[0, 36], 0]).tolist() == [False, True]


def test_what_is_too_near_too_far_or_too_low_is_left_out() -> None:
    world = World.of(
        [
            Sphere(centre_world_m=(0.18, 0.0, 1.5), radius_m=0.05),
            Cylinder(start_world_m=(-12.0, 0.0, 0.0), end_world_m=(-12.0, 0.0, 5.0), radius_m=0.5),
            Box(centre_world_m=(0.0, 5.0, 0.1), size_m=(1.0, 1.0, 0.2)),
        ]
    )
    assert not np.isfinite(_grid(world, (0.0, 0.0, 1.5), 0.0)).any()
