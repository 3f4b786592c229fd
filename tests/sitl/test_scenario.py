"""A scenario and a seed make a world, a start and streams of chance, the same each time."""

from pathlib import Path

import numpy as np
import pytest

from companion.errors import ProfileError
from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray
from companion.yaml_tree import MissingProfileError
from sitl.scenario import Scenario, Stage, load_scenario, set_stage
from tests.sitl.short_flight import FIELD_CONFIGS, write_scenario

PILLARS = {
    "pillars": {"size_m": [40.0, 40.0], "min_gap_m": 3.0, "spawn_clear_m": 3.0, "failures_until_full": 100}
}


@pytest.fixture
def scenario(tmp_path: Path) -> Scenario:
    return load_scenario(write_scenario(tmp_path, world=PILLARS))


def staged(folder: Path, scenario: Scenario, seed: int | None = None) -> Stage:
    return set_stage(scenario, folder, seed)


def gap_to_nearest_pillar(stage: Stage, p_world: FloatArray) -> float:
    at_pillar_height = np.array([p_world[0], p_world[1], 2.0])
    return float(stage.world.obstacles().clearance(at_pillar_height))


def test_the_same_seed_makes_the_same_world_start_and_goal(tmp_path: Path, scenario: Scenario) -> None:
    first, second = staged(tmp_path, scenario, 7), staged(tmp_path, scenario, 7)
    np.testing.assert_array_equal(first.world.rows, second.world.rows)
    np.testing.assert_array_equal(first.world.reflectivity, second.world.reflectivity)
    np.testing.assert_array_equal(first.T_world_start.q, second.T_world_start.q)
    np.testing.assert_array_equal(first.goal_world, second.goal_world)


def test_another_seed_makes_another_world_heading_and_noise(tmp_path: Path, scenario: Scenario) -> None:
    first, second = staged(tmp_path, scenario, 7), staged(tmp_path, scenario, 8)
    assert not np.array_equal(first.world.rows, second.world.rows)
    assert rotation.yaw_of(first.T_world_start.q) != rotation.yaw_of(second.T_world_start.q)
    assert first.generator("imu").random() != second.generator("imu").random()


def test_the_seed_given_counts_instead_of_the_scenarios_own(tmp_path: Path, scenario: Scenario) -> None:
    assert staged(tmp_path, scenario).scenario.seed == 3
    given = staged(tmp_path, scenario, 9)
    assert given.scenario.seed == 9
    own = staged(tmp_path, scenario.model_copy(update={"seed": 9}))
    np.testing.assert_array_equal(given.world.rows, own.world.rows)


def test_streams_of_chance_do_not_disturb_each_other(tmp_path: Path, scenario: Scenario) -> None:
    quiet, busy = staged(tmp_path, scenario), staged(tmp_path, scenario)
    busy.generator("wind").random(1000)
    np.testing.assert_array_equal(quiet.generator("imu").random(100), busy.generator("imu").random(100))
    firsts = {quiet.generator(name).random() for name in ("lidar", "imu", "wind", "autopilot", "network")}
    assert len(firsts) == 5


def test_a_scenarios_faults_leave_its_world_as_it_is(tmp_path: Path, scenario: Scenario) -> None:
    lossy = load_scenario(write_scenario(tmp_path, world=PILLARS, network={"loss": 0.3}))
    one, other = staged(tmp_path, scenario), staged(tmp_path, lossy)
    np.testing.assert_array_equal(one.world.rows, other.world.rows)


@pytest.mark.parametrize("seed", range(5))
def test_start_and_goal_are_free_of_pillars_that_fill_the_rest(
    tmp_path: Path, scenario: Scenario, seed: int
) -> None:
    stage = staged(tmp_path, scenario, seed)
    assert len(stage.world) > 20
    assert gap_to_nearest_pillar(stage, stage.T_world_start.p) >= 3.0 - 1e-9
    assert gap_to_nearest_pillar(stage, stage.goal_world) >= 2.5 - 1e-9


@pytest.mark.parametrize("yaw_deg", [-135.0, 0.0, 90.0])
def test_the_goal_is_the_last_waypoint_seen_from_the_start(
    tmp_path: Path, scenario: Scenario, yaw_deg: float
) -> None:
    update = {"start_yaw_deg": yaw_deg, "start_world_m": (2.0, -1.0)}
    stage = staged(tmp_path, scenario.model_copy(update=update))
    yaw = np.radians(yaw_deg)
    standing_m = scenario.quadrotor.standing_height_m
    np.testing.assert_allclose(stage.T_world_start.p, [2.0, -1.0, standing_m])
    ahead = [2.0 + 6.0 * np.cos(yaw), -1.0 + 6.0 * np.sin(yaw), standing_m + 1.2]
    np.testing.assert_allclose(stage.goal_world, ahead, atol=1e-12)


def test_a_start_that_somebody_else_decided_moves_goal_and_free_discs(
    tmp_path: Path, scenario: Scenario
) -> None:
    elsewhere = Pose.of([5.0, 6.0, 0.1], rotation.from_yaw(np.pi / 2.0))
    stage = set_stage(scenario, tmp_path, None, elsewhere)
    assert stage.scenario.start_world_m == (5.0, 6.0)
    np.testing.assert_allclose(stage.goal_world, [5.0, 12.0, 1.3], atol=1e-12)
    assert gap_to_nearest_pillar(stage, elsewhere.p) >= 3.0 - 1e-9
    assert gap_to_nearest_pillar(stage, stage.goal_world) >= 2.5 - 1e-9


def test_a_vehicle_without_waypoints_has_its_start_for_a_goal(tmp_path: Path, scenario: Scenario) -> None:
    follower = str(FIELD_CONFIGS / "uav_follower.yaml")
    stage = staged(tmp_path, scenario.model_copy(update={"profile": follower}))
    np.testing.assert_array_equal(stage.goal_world, stage.T_world_start.p)


def test_a_list_of_bodies_is_the_whole_world(tmp_path: Path) -> None:
    bodies = [{"shape": "ground"}, {"shape": "sphere", "centre_world_m": [3.0, 0.0, 1.0], "radius_m": 0.5}]
    path = write_scenario(tmp_path, world={"primitives": bodies})
    assert len(staged(tmp_path, load_scenario(path)).world) == 2


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"world": {}}, "name exactly one of site, file, mesh, pillars, primitives"),
        (
            {"world": {**PILLARS, "primitives": []}},
            "name exactly one of site, file, mesh, pillars, primitives",
        ),
        ({"weather": "fine"}, "weather: unknown key"),
        ({"network": {"loss": 1.5}}, "network.loss: found 1.5"),
        ({"seed": -1}, "seed: found -1"),
        ({"start_yaw_deg": 400}, "start_yaw_deg: found 400"),
    ],
)
def test_a_wrong_scenario_is_refused_with_its_place(
    tmp_path: Path, changes: dict[str, object], expected: str
) -> None:
    path = write_scenario(tmp_path, **changes)
    with pytest.raises(ProfileError, match=expected) as caught:
        load_scenario(path)
    assert str(caught.value).startswith(f"{path}:")


def test_a_profile_that_does_not_exist_is_named(tmp_path: Path) -> None:
    scenario = load_scenario(write_scenario(tmp_path, profile="gone.yaml"))
    with pytest.raises(MissingProfileError, match=r"gone\.yaml"):
        staged(tmp_path, scenario)


def test_the_scenarios_that_ship_can_be_staged() -> None:
    shipped = [path for path in FIELD_CONFIGS.glob("sitl_*.yaml") if "profile:" in path.read_text()]
    assert shipped
    for path in shipped:
        assert len(set_stage(load_scenario(path), path.parent, None).world) > 1
