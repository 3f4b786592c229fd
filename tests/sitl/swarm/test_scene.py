from dataclasses import replace

import numpy as np
import pytest

from sitl.swarm.scene import set_scene
from sitl.swarm.settings import LeaderBehaviourSettings, SwarmSettings
from sitl.worlds.primitives import Cylinder, Primitive
from sitl.worlds.settings import WorldSettings
from sitl.worlds.sites import FLOWN_SITES, SITE_NAMES

FOUR = SwarmSettings()


@pytest.mark.parametrize("site", SITE_NAMES)
def test_every_site_makes_a_scene_with_room_for_everybody(site: str) -> None:
    scene = set_scene(FOUR, site, 1_000_000_007)
    obstacles = scene.world.obstacles()
    assert scene.starts_world.shape == (5, 3)
    assert scene.yaws.shape == (5,)
    assert len(scene.holds_s) == len(scene.waypoints_world)
    assert scene.holds_s[-1] == 3.0
    if len(obstacles):
        assert obstacles.clearance(scene.starts_world).min() >= 0.5
        assert obstacles.clearance(scene.waypoints_world).min() >= 1.0
    gaps = np.linalg.norm(scene.starts_world[:, None] - scene.starts_world[None], axis=2)
    assert gaps[np.triu_indices(5, 1)].min() > 1.2
    assert 0.5 <= scene.speed_mps <= 1.5
    way = np.vstack([scene.starts_world[0, :2], scene.waypoints_world[:, :2]])
    length = np.hypot(*np.diff(way, axis=0).T).sum()
    assert scene.timeout_s == pytest.approx(2.0 * length / scene.speed_mps + 3.0 + 20.0)


def test_equal_seeds_give_equal_scenes_and_other_seeds_others() -> None:
    first, again, other = (set_scene(FOUR, "pillars_5m", seed) for seed in (4, 4, 5))
    assert first.scene_hash == again.scene_hash
    assert first.starts_world.tobytes() == again.starts_world.tobytes()
    assert first.world.rows.tobytes() == again.world.rows.tobytes()
    assert first.scene_hash != other.scene_hash
    assert len(first.scene_hash) == 16


def test_the_leaders_speed_start_and_height_are_drawn_anew_every_time() -> None:
    scenes = [set_scene(FOUR, "none", seed) for seed in range(40)]
    speeds = np.array([scene.speed_mps for scene in scenes])
    assert speeds.min() < 0.7
    assert speeds.max() > 1.3
    heights = np.array([scene.starts_world[0, 2] for scene in scenes])
    assert heights.min() >= 1.5
    assert heights.max() <= 2.0
    assert all(np.all(np.abs(s.starts_world[:, 2] - s.starts_world[0, 2]) <= 0.1) for s in scenes)
    goals = np.array([scene.waypoints_world[-1, :2] for scene in scenes])
    np.testing.assert_allclose(np.hypot(*goals.T), 30.0)
    assert len({scene.scene_hash for scene in scenes}) == 40


def test_waypoints_of_the_swarm_are_the_way_in_open_country_and_refused_elsewhere() -> None:
    way = FOUR.model_copy(update={"waypoints_m": [(10.0, 0.0), (10.0, 10.0)]})
    scene = set_scene(way, "pillars_10m", 3)
    np.testing.assert_array_equal(scene.waypoints_world[:, :2], [[10.0, 0.0], [10.0, 10.0]])
    with pytest.raises(ValueError, match="has a way of its own"):
        set_scene(way, FLOWN_SITES[0], 3)


def test_an_unknown_site_is_refused_with_the_names_of_those_there_are() -> None:
    with pytest.raises(ValueError, match=r"no site is called 'moon'.*pillars_5m"):
        set_scene(FOUR, "moon", 1)


def test_a_start_full_of_obstacles_is_refused() -> None:
    wall: list[Primitive] = [
        Cylinder(start_world_m=(x, y, 0.0), end_world_m=(x, y, 5.0), radius_m=0.5)
        for x in (-1.6, 0.0, 1.6)
        for y in (-1.6, 0.0)
    ]
    with pytest.raises(ValueError, match="leave 3 places free at the start, 5 are needed"):
        set_scene(FOUR, WorldSettings(primitives=wall), 1)


def test_a_goal_in_an_obstacle_moves_to_the_nearest_free_place() -> None:
    pillar = Cylinder(start_world_m=(12.0, 0.0, 0.0), end_world_m=(12.0, 0.0, 5.0), radius_m=0.5)
    swarm = FOUR.model_copy(update={"waypoints_m": [(12.0, 0.0)]})
    scene = set_scene(swarm, WorldSettings(primitives=[pillar]), 1)
    room = scene.world.obstacles().clearance(scene.waypoints_world[-1])
    assert 1.2 <= room < 1.5


def test_behaviour_changes_the_way_and_nothing_else() -> None:
    straight = set_scene(FOUR, "none", 9)
    hover = set_scene(
        FOUR.model_copy(update={"leader": LeaderBehaviourSettings(behaviour="hover")}), "none", 9
    )
    np.testing.assert_array_equal(straight.starts_world, hover.starts_world)
    np.testing.assert_array_equal(straight.waypoints_world[-1], hover.waypoints_world[-1])
    assert straight.speed_mps == hover.speed_mps
    assert hover.timeout_s > straight.timeout_s
    assert replace(straight, seed=1).scene_hash == straight.scene_hash
