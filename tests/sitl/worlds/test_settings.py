"""Worlds as scenarios name them."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from companion.errors import ProfileError
from companion.yaml_tree import MissingProfileError
from sitl.worlds.primitives import Ground, Sphere
from sitl.worlds.settings import WorldSettings, site_of, told_way
from sitl.worlds.sites import SITE_NAMES, Site, build_site
from tests.sitl.short_flight import FIELD_CONFIGS
from tests.sitl.worlds.test_mesh import write_box

HERE = Path()


def built(settings: WorldSettings, folder: Path = HERE, seed: int = 4, followers: int = 4) -> Site:
    return site_of(settings, np.random.default_rng(seed), folder=folder, followers=followers)


@pytest.mark.parametrize("name", SITE_NAMES)
def test_a_named_site_is_that_of_the_catalogue(name: str) -> None:
    site = built(WorldSettings.model_validate({"site": name}))
    same = build_site(name, np.random.default_rng(4), followers=4)
    assert site.world.rows.tobytes() == same.world.rows.tobytes()
    np.testing.assert_array_equal(site.waypoints_world, same.waypoints_world)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({}, "name exactly one of"),
        ({"site": "forest", "primitives": []}, "name exactly one of"),
        ({"file": "a.yaml", "mesh": "b.ply"}, "name exactly one of"),
        ({"site": "desert"}, "Input should be"),
        ({"site": "indoor_wall", "waypoints_world_m": [[1.0, 2.0]]}, "part of it"),
        ({"primitives": [], "waypoints_world_m": []}, "at least 1"),
    ],
)
def test_contradictions_are_refused(wrong: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        WorldSettings.model_validate(wrong)


def test_a_file_tells_bodies_start_and_way_and_the_scenario_may_overrule_the_way() -> None:
    settings = WorldSettings(file="world_courtyard.yaml")
    site = built(settings, FIELD_CONFIGS)
    assert site.name == "world_courtyard"
    np.testing.assert_array_equal(site.waypoints_world, [[14.0, 0.0], [14.0, 14.0]])
    spawn, way = told_way(settings, FIELD_CONFIGS)
    np.testing.assert_array_equal(spawn, site.spawn_world)
    assert way is not None
    np.testing.assert_array_equal(way, site.waypoints_world)
    other = built(settings.model_copy(update={"waypoints_world_m": [(3.0, 0.0)]}), FIELD_CONFIGS)
    np.testing.assert_array_equal(other.waypoints_world, [[3.0, 0.0]])
    np.testing.assert_array_equal(other.world.rows, site.world.rows)


def test_a_wrong_file_is_named_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("primitives:\n  - {shape: ball, radius_m: 1.0}\n")
    with pytest.raises(ProfileError, match=r"bad\.yaml:2:"):
        built(WorldSettings(file="bad.yaml"), tmp_path)
    with pytest.raises(MissingProfileError, match=r"absent\.yaml"):
        built(WorldSettings(file="absent.yaml"), tmp_path)


def test_a_goal_that_is_not_given_has_room(tmp_path: Path) -> None:
    balls = [
        Sphere(centre_world_m=(30.0 * x, 30.0 * y, 1.5), radius_m=6.0) for x, y in ((1, 0), (-1, 0), (0, 1))
    ]
    settings = WorldSettings(primitives=[Ground(), *balls])
    for seed in range(20):
        site = built(settings, seed=seed)
        assert np.hypot(*site.waypoints_world[0]) == pytest.approx(30.0)
        assert float(site.world.obstacles().clearance([*site.waypoints_world[0], 1.5])) >= 1.0
    walled = WorldSettings(primitives=[Sphere(centre_world_m=(0.0, 0.0, 0.0), radius_m=40.0)])
    with pytest.raises(ProfileError, match="no place 30 m from the start is free"):
        built(walled)


def test_a_mesh_is_read_beside_its_scenario(tmp_path: Path) -> None:
    write_box(tmp_path / "hut.obj", (10.0, -1.5, 0.0), (14.0, 1.5, 3.0))
    site = built(WorldSettings(mesh="hut.obj", mesh_voxel_m=0.25), tmp_path)
    assert site.name == "hut"
    assert float(site.world.obstacles().clearance([9.0, 0.0, 1.0])) == pytest.approx(1.0, abs=0.25)


def test_a_pillar_field_keeps_the_whole_way_and_the_whole_swarm_free() -> None:
    settings = WorldSettings.model_validate({"pillars": {"min_gap_m": 2.0, "failures_until_full": 300}})
    way = [[12.0, 0.0], [12.0, 12.0]]
    site = site_of(
        settings, np.random.default_rng(1), folder=HERE, followers=20, spawn_world=(-8.0, 0.0), goal_world=way
    )
    obstacles = site.world.obstacles()
    rooms = obstacles.clearance([[-8.0, 0.0, 1.5], [12.0, 0.0, 1.5], [12.0, 12.0, 1.5]])
    assert rooms[0] >= 6.2
    assert rooms[1:].min() >= 2.5
    free = built(settings)
    assert np.hypot(*free.waypoints_world[0]) == pytest.approx(30.0)
