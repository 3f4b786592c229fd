"""The ten sites: what every scene of each keeps free, how far things stand apart, and that there is a way."""

import math
from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.messages import FloatArray
from sitl.worlds import flown_sites, forests
from sitl.worlds.course import spawn_clear_m
from sitl.worlds.open_country import HORIZON_M
from sitl.worlds.primitives import World
from sitl.worlds.raycast_kernels import BOX, CAPSULE, CYLINDER, PLANE, SPHERE
from sitl.worlds.seeds import held_out_seed
from sitl.worlds.settings import SiteName
from sitl.worlds.sites import FLOWN_SITES, OPEN_SITES, SITE_NAMES, Site, build_site
from tests.sitl.worlds.leaders_way import HEIGHTS_M, VEHICLE_RADIUS_M, densely, leaders_way

SEEDS = range(6)


def scene(name: str, number: int, followers: int = 4) -> Site:
    return build_site(name, np.random.default_rng(held_out_seed(number)), followers=followers)


def room_at(world: World, place: FloatArray) -> float:
    """Radius of the free upright cylinder round a place, from the ground to above any flight."""
    heights = np.arange(0.1, 6.0, 0.02)
    points = np.column_stack([np.tile(place, (len(heights), 1)), heights])
    is_ceiling = (
        (world.kinds == BOX) & (world.rows[:, 2] - world.rows[:, 5] > 6.9) & (world.rows[:, 5] < 0.15)
    )
    return float(only(world, ~is_ceiling).obstacles().clearance(points).min())


def only(world: World, keep: NDArray[np.bool_]) -> World:
    """Some of the primitives of a world."""
    return World(
        world.kinds[keep], world.rows[keep], world.discs[keep], world.reflectivity[keep],
        world.retro_reflective[keep],
    )  # fmt: skip


def axes(world: World, kind: int, points: int = 81) -> FloatArray:
    """Points (n, points, 3) along the axes of all rods of a kind."""
    rows = world.rows[world.kinds == kind]
    share = np.linspace(0.0, 1.0, points)[None, :, None]
    return np.asarray(rows[:, None, :3] + share * rows[:, None, 6:7] * rows[:, None, 3:6])


def test_the_catalogue_is_the_one_that_scenarios_know() -> None:
    assert get_args(SiteName) == SITE_NAMES
    assert len(SITE_NAMES) == 10


@pytest.mark.parametrize("name", SITE_NAMES)
def test_equal_generators_give_equal_scenes_and_others_differ(name: str) -> None:
    first, again, other = scene(name, 1), scene(name, 1), scene(name, 2)
    for field in ("kinds", "rows", "discs", "reflectivity", "retro_reflective"):
        assert getattr(first.world, field).tobytes() == getattr(again.world, field).tobytes()
    assert first.waypoints_world.tobytes() == again.waypoints_world.tobytes()
    assert first.world.rows.tobytes() != other.world.rows.tobytes()


@pytest.mark.parametrize("name", SITE_NAMES)
def test_a_scene_stands_on_ground_and_its_rows_describe_what_the_models_describe(name: str) -> None:
    world = scene(name, 3).world
    assert world.kinds[0] == PLANE
    assert np.count_nonzero(world.kinds == PLANE) == 1
    assert world.reflectivity.min() > 0.0
    assert world.reflectivity.max() <= 1.0
    assert not world.retro_reflective.any()
    assert np.all(np.isfinite(world.rows))
    for kind in (CYLINDER, CAPSULE):
        rows = world.rows[world.kinds == kind]
        np.testing.assert_allclose(np.linalg.norm(rows[:, 3:6], axis=1), 1.0)
    for array in (world.rows, world.discs, world.kinds, world.reflectivity):
        assert array.flags["C_CONTIGUOUS"]


@pytest.mark.parametrize("followers", [4, 20])
@pytest.mark.parametrize("name", SITE_NAMES)
def test_start_and_goal_are_free(name: str, followers: int) -> None:
    for number in SEEDS:
        site = scene(name, number, followers)
        assert room_at(site.world, site.spawn_world) >= spawn_clear_m(followers) - 1e-3
        assert room_at(site.world, site.waypoints_world[-1]) >= 2.5 - 1e-3


def test_the_free_disc_at_the_start_holds_every_swarm() -> None:
    assert spawn_clear_m(4) == pytest.approx(4.0)
    assert spawn_clear_m(8) == pytest.approx(4.0)
    for followers in (9, 15, 20):
        side = math.ceil(math.sqrt(followers + 1))
        assert spawn_clear_m(followers) >= 0.5 * (side - 1) * 1.6 * math.sqrt(2.0) + 1.7


@pytest.mark.parametrize("name", OPEN_SITES)
def test_every_waypoint_in_open_country_is_kept_free_wherever_it_is(name: str) -> None:
    way = [[20.0, 5.0], [25.0, 25.0], [0.0, 30.0], [-18.0, 8.0]]
    site = build_site(name, np.random.default_rng(5), followers=4, spawn_world=(3.0, -2.0), goal_world=way)
    np.testing.assert_array_equal(site.waypoints_world, way)
    np.testing.assert_array_equal(site.spawn_world, [3.0, -2.0])
    assert room_at(site.world, site.spawn_world) >= 4.0 - 1e-3
    for waypoint in site.waypoints_world:
        assert room_at(site.world, waypoint) >= 2.5 - 1e-3


@pytest.mark.parametrize("name", OPEN_SITES)
def test_a_goal_that_is_not_given_lies_30_m_away_in_any_direction(name: str) -> None:
    goals = np.array([scene(name, number).waypoints_world[0] for number in range(12)])
    np.testing.assert_allclose(np.hypot(*goals.T), 30.0)
    assert len(np.unique(np.sign(goals), axis=0)) == 4


def test_unknown_sites_and_foreign_ways_are_refused() -> None:
    rng = np.random.default_rng(1)
    with pytest.raises(ValueError, match="no site is called 'desert'"):
        build_site("desert", rng, followers=4)
    for name in FLOWN_SITES:
        with pytest.raises(ValueError, match="part of it"):
            build_site(name, rng, followers=4, goal_world=(5.0, 0.0))
    for wrong in ([1.0, 2.0, 3.0], [[math.nan, 0.0]], np.zeros((0, 2))):
        with pytest.raises(ValueError, match="waypoints must be"):
            build_site("none", rng, followers=4, goal_world=wrong)


@pytest.mark.parametrize(("name", "gap_m", "fewest"), [("pillars_5m", 5.0, 110), ("pillars_10m", 10.0, 32)])
def test_pillars_keep_their_gap_and_fill_the_square(name: str, gap_m: float, fewest: int) -> None:
    for number in SEEDS:
        world = scene(name, number).world
        rows = world.rows[world.kinds == CYLINDER]
        gaps = np.hypot(*(rows[:, None, :2] - rows[None, :, :2]).transpose(2, 0, 1))
        gaps -= rows[:, None, 7] + rows[None, :, 7]
        np.fill_diagonal(gaps, np.inf)
        assert gaps.min() >= gap_m
        assert len(rows) >= fewest
        assert rows[:, 7].min() >= 0.2
        assert rows[:, 7].max() <= 0.5


@pytest.mark.parametrize("name", ["simplified_forest", "forest"])
def test_stems_and_rocks_stand_5_m_apart_at_their_feet_and_trunks_lean(name: str) -> None:
    for number in range(3):
        world = scene(name, number).world
        stems, spheres = world.rows[world.kinds == CYLINDER], world.rows[world.kinds == SPHERE]
        rocks = spheres[spheres[:, 2] < 1.0]
        feet = np.concatenate([stems, rocks])
        assert len(rocks) > 10
        assert np.degrees(np.arccos(stems[:, 5])).max() > 5.0
        apart = feet[:, None, :2] - feet[None, :, :2]
        gaps = np.hypot(apart[..., 0], apart[..., 1]) - feet[:, 7] - feet[:, None, 7]
        np.fill_diagonal(gaps, np.inf)
        assert gaps.min() >= forests.GAP_M


def test_crowns_hang_above_their_floor_and_end_within_their_reach() -> None:
    world = scene("forest", 0).world
    stems = axes(world, CYLINDER, 401)
    spheres = world.rows[world.kinds == SPHERE]
    leaves = spheres[spheres[:, 2] > 1.5]
    assert len(leaves) == 6 * len(stems)
    assert (leaves[:, 2] - leaves[:, 7]).min() >= forests.CROWN_FLOOR_M
    assert (leaves[:, 2] - leaves[:, 7]).min() < forests.CROWN_FLOOR_M + 0.1
    twigs = axes(world, CAPSULE, 5)
    assert world.rows[world.kinds == CAPSULE, 7].max() <= 0.04
    outer = np.concatenate([leaves[:, :3], twigs.reshape(-1, 3)])
    extra = np.concatenate([leaves[:, 7], np.zeros(len(outer) - len(leaves))])
    for point, radius in zip(outer, extra, strict=True):
        level = np.abs(stems[..., 2] - point[2]).argmin(axis=1)
        at_height = stems[np.arange(len(stems)), level]
        gaps = np.hypot(*(at_height[:, :2] - point[:2]).T)
        assert gaps.min() + radius <= forests.CROWN_REACH_M + 0.05


def test_nothing_in_the_open_affects_a_swarm_yet_odometry_has_something_to_hold_on_to() -> None:
    for number in SEEDS:
        site = scene("none", number)
        way = densely(np.vstack([site.spawn_world, site.waypoints_world]), 0.5)
        obstacles = site.world.obstacles()
        for height in (0.5, 1.75, 3.5):
            rooms = obstacles.clearance(np.column_stack([way, np.full(len(way), height)]))
            assert rooms.min() >= HORIZON_M[0]
        for place in way[:: len(way) // 4]:
            azimuth = np.linspace(-math.pi, math.pi, 720, endpoint=False)
            rays = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.full(720, 0.05)])
            rays /= np.linalg.norm(rays, axis=1, keepdims=True)
            origins = np.tile([*place, 1.75], (720, 1))
            hits = obstacles.cast(origins, rays, 35.0)
            seen = np.isfinite(hits.ranges)
            assert seen.sum() > 60
            # What is seen must fix both x and y: the directions of sight and the cosines say how well.
            weight = rays[seen, :2] * hits.cosines[seen, None]
            assert np.linalg.eigvalsh(weight.T @ weight).min() > 8.0


def test_blocks_keep_their_gap_from_each_other_and_from_the_walls() -> None:
    for number in SEEDS:
        world = scene("indoor_blocks", number).world
        blocks = np.flatnonzero((world.kinds == BOX) & (world.discs[:, 2] < 2.0))
        assert len(blocks) >= 8
        for k in blocks:
            row = world.rows[k]
            corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * row[3:5]
            turn = np.array([[row[6], -row[7]], [row[7], row[6]]])
            edge = densely(corners @ turn.T + row[:2], 0.05)
            others = only(world, (np.arange(len(world)) != k) & (world.kinds != PLANE))
            rooms = others.clearance(np.column_stack([edge, np.full(len(edge), 1.0)]))
            assert rooms.min() >= flown_sites.BLOCK_GAP_M


def test_the_wall_must_be_flown_round_and_leaves_room_at_both_ends() -> None:
    for number in SEEDS:
        site = scene("indoor_wall", number)
        obstacles = site.world.obstacles()
        for height in (0.5, 1.75, 3.5):
            start, goal = [*site.spawn_world, height], [*site.waypoints_world[-1], height]
            assert np.isfinite(obstacles.first_contact(start, goal, VEHICLE_RADIUS_M))
        wall = site.world.rows[np.flatnonzero(site.world.kinds == BOX)[-1]]
        assert wall[2] + wall[5] > 3.5 + VEHICLE_RADIUS_M
        for side in (-1.0, 1.0):
            end = [wall[0], wall[1] + side * (wall[4] + 0.5 * flown_sites.PASSAGE_M), 1.75]
            assert obstacles.clearance(end) >= 0.5 * flown_sites.PASSAGE_M - 1e-6


def test_the_tower_stands_in_the_way_from_top_to_bottom() -> None:
    for number in SEEDS:
        site = scene("display_tower", number)
        for height in (0.7, 1.75, 3.3):
            start, goal = [*site.spawn_world, height], [*site.waypoints_world[-1], height]
            assert np.isfinite(site.world.obstacles().first_contact(start, goal, VEHICLE_RADIUS_M))


def test_the_short_forest_is_low_and_dense() -> None:
    for number in SEEDS:
        world = scene("short_forest", number).world
        leaves = world.rows[world.kinds == SPHERE]
        assert (leaves[:, 2] + leaves[:, 7]).max() <= 3.21
        assert (leaves[:, 2] - leaves[:, 7]).min() >= -1e-9
        shrubs = leaves.reshape(-1, 4, 8)
        assert len(shrubs) >= 24
        for k in range(len(shrubs) - 1):
            rest = shrubs[k + 1 :].reshape(-1, 8)
            for leaf in shrubs[k]:
                gaps = np.hypot(*(rest[:, :2] - leaf[:2]).T) - rest[:, 7] - leaf[7]
                assert gaps.min() >= flown_sites.SHRUB_GAP_M


@pytest.mark.parametrize("name", SITE_NAMES)
def test_the_leader_finds_a_way_in_every_scene(name: str) -> None:
    for number in range(20):
        site = scene(name, number)
        way = leaders_way(site, np.random.default_rng(number))
        assert way is not None, f"scene {number}: stuck"
        assert np.hypot(*(way[-1] - site.waypoints_world[-1])) < 0.5
        path = densely(way)
        for height in HEIGHTS_M:
            rooms = site.world.obstacles().clearance(np.column_stack([path, np.full(len(path), height)]))
            assert rooms.min() > VEHICLE_RADIUS_M + 0.2
