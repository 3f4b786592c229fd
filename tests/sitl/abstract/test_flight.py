from dataclasses import asdict, replace

import numpy as np
import pytest

from companion.control.followers.settings import FollowerSettings
from companion.logs.metrics import measure
from sitl.abstract.flight import AbstractFlight, SwarmTrajectory, fly_abstract
from sitl.abstract.settings import PRESETS, AbstractSettings, PerceptionSettings
from sitl.swarm.scene import SwarmScene, set_scene
from sitl.swarm.settings import LeaderBehaviourSettings, SwarmSettings, TerminationSettings
from sitl.wind import WindSettings
from sitl.worlds.primitives import Box, Cylinder, World

SHORT = SwarmSettings(goal_distance_m=10.0)
# These tests are not about how well a law keeps its flock together.
LOOSE = TerminationSettings(gathered_m=20.0)


def _fly(scene: SwarmScene, method: str = "flock", **changes: object) -> AbstractFlight:
    settings = AbstractSettings().model_copy(update=changes)
    return fly_abstract(scene, method, FollowerSettings(), settings, termination=LOOSE, record=True)


def _path(flight: AbstractFlight) -> SwarmTrajectory:
    assert flight.trajectory is not None
    return flight.trajectory


def _moved(scene: SwarmScene, number: int, x: float, y: float) -> SwarmScene:
    starts = scene.starts_world.copy()
    starts[number, :2] = x, y
    return replace(scene, starts_world=starts)


def test_a_swarm_follows_its_leader_to_the_goal() -> None:
    scene = set_scene(SHORT, "none", 3)
    flight = _fly(scene)
    assert flight.record.end == "success"
    assert flight.record.mission_progress_percent == 100.0
    path = _path(flight)
    assert np.linalg.norm(path.p_world[-1, 0] - scene.waypoints_world[-1]) < 1.0
    assert np.all(np.linalg.norm(path.p_world[-1] - path.p_world[-1, 0], axis=1) < 20.0)
    np.testing.assert_array_equal(path.p_world[0], scene.starts_world)
    assert path.t[-1] == pytest.approx(flight.record.t_end_s)


def test_sums_in_the_kernel_are_the_formulas_over_the_trajectory() -> None:
    for site, seed in (("pillars_5m", 4), ("forest", 2)):
        flight = _fly(set_scene(SHORT, site, seed))
        path, record = _path(flight), flight.record
        expected = measure(path.t, path.p_world, path.v_world, path.distances, cap_m=4.0)
        assert record.steps == len(path.t)
        assert record.flock_radius_m == pytest.approx(expected.FR.mean, abs=1e-9)
        assert record.minimum_separation_m == pytest.approx(expected.MS.mean, abs=1e-9)
        assert record.alignment == pytest.approx(expected.AL.mean, abs=1e-9)
        assert record.obstacle_distance_m == pytest.approx(expected.MDO.mean, abs=1e-9)


def test_distances_to_obstacles_are_the_worlds_own() -> None:
    scene = set_scene(SwarmSettings(goal_distance_m=20.0), "forest", 4)
    path = _path(_fly(scene))
    near = path.distances < 4.0
    assert near.any()
    own = scene.world.obstacles().clearance(path.p_world)
    np.testing.assert_allclose(path.distances[near], own[near], atol=1e-9)


def test_equal_scenes_give_equal_bytes_whatever_flew_before_and_whether_it_is_recorded() -> None:
    scene = set_scene(SHORT, "pillars_5m", 8)
    first = _fly(scene)
    _fly(set_scene(SHORT, "forest", 9))
    again = _fly(set_scene(SHORT, "pillars_5m", 8))
    assert asdict(first.record) == asdict(again.record)
    assert _path(first).p_world.tobytes() == _path(again).p_world.tobytes()
    silent = fly_abstract(
        scene, "flock", FollowerSettings(), AbstractSettings(), termination=LOOSE, course=first.course
    )
    assert asdict(silent.record) == asdict(first.record)
    assert silent.trajectory is None


def test_other_seeds_give_other_noise_in_the_same_scene() -> None:
    scene = set_scene(SHORT, "none", 8)
    other = _fly(replace(scene, seed=scene.seed + 1))
    assert not np.array_equal(_path(_fly(scene)).p_world[:100], _path(other).p_world[:100])


def test_the_leader_flies_the_same_whoever_follows() -> None:
    scene = set_scene(SHORT, "pillars_5m", 11)
    alone = _path(_fly(scene, "flock"))
    pressed = _path(_fly(scene, "vpf"))
    both = min(len(alone.t), len(pressed.t))
    np.testing.assert_array_equal(alone.p_world[:both, 0], pressed.p_world[:both, 0])


def test_vehicles_that_touch_end_the_trial_and_are_named() -> None:
    scene = set_scene(SHORT, "none", 1)
    two = _fly(_moved(scene, 2, scene.starts_world[1, 0] + 0.3, scene.starts_world[1, 1])).record
    assert (two.end, two.ended_by, two.t_end_s) == ("uav_uav", (1, 2), 0.0)
    leader = _fly(_moved(scene, 2, scene.starts_world[0, 0] + 0.3, scene.starts_world[0, 1])).record
    assert (leader.end, leader.ended_by) == ("leader_follower", (0, 2))


def test_a_vehicle_that_touches_an_obstacle_ends_the_trial() -> None:
    scene = set_scene(SHORT, "none", 1)
    x, y, _ = scene.starts_world[3]
    pillar = Cylinder(start_world_m=(x + 0.4, y, 0.0), end_world_m=(x + 0.4, y, 4.0), radius_m=0.25)
    record = _fly(replace(scene, world=World.of([pillar]))).record
    assert (record.end, record.ended_by) == ("obstacle", (3,))


def test_a_leader_whom_nobody_sees_for_half_a_second_is_lost() -> None:
    scene = set_scene(SHORT, "none", 1)
    x, y, _ = scene.starts_world[0]
    sides = [(x + 0.5, y, 0.1, 1.1), (x - 0.5, y, 0.1, 1.1), (x, y + 0.5, 1.1, 0.1), (x, y - 0.5, 1.1, 0.1)]
    cabin = World.of([Box(centre_world_m=(a, b, 2.0), size_m=(c, d, 4.0)) for a, b, c, d in sides])
    record = _fly(replace(scene, world=cabin)).record
    assert record.end == "leader_lost"
    assert 0.5 <= record.t_end_s <= 0.9
    assert record.mission_progress_percent < 5.0


def test_too_low_too_late_and_too_far_apart_are_told_apart() -> None:
    scene = set_scene(SHORT, "none", 6)
    low = scene.starts_world.copy()
    low[2, 2] = 0.45
    assert _fly(replace(scene, starts_world=low)).record.end == "altitude"
    late = _fly(replace(scene, timeout_s=3.0)).record
    assert late.end == "timeout"
    assert late.t_end_s == pytest.approx(3.0)
    close = TerminationSettings(gathered_m=0.5)
    apart = fly_abstract(scene, "flock", FollowerSettings(), AbstractSettings(), termination=close).record
    assert apart.end == "scattered"


def test_newcomers_take_several_sightings_and_coasting_outlasts_a_miss() -> None:
    scene = set_scene(SHORT, "none", 2)
    gaps = PerceptionSettings(dropout=0.5)
    coasting = gaps.model_copy(update={"coast_s": 0.5})
    dropped = _path(_fly(scene, perception=gaps)).perceived[:60, 1:].mean()
    coasted = _path(_fly(scene, perception=coasting)).perceived[:60, 1:].mean()
    # Four of five could be known.
    assert dropped == pytest.approx(0.4, abs=0.06)
    assert coasted > 0.7
    slow = _path(_fly(scene, perception=gaps.model_copy(update={"sightings": 3}))).perceived
    # Whoever is in sight at the start is known at once; after a miss it takes three sightings in a row.
    assert slow[0].sum() > 4
    assert slow[10:60, 1:].mean() == pytest.approx(0.8 * 0.5**3, abs=0.05)


def test_the_other_dynamics_wind_and_measured_perception_fly_too() -> None:
    scene = set_scene(SHORT, "none", 3)
    calm = _path(_fly(scene))
    assert _fly(scene, dynamics="lag").record.end == "success"
    blown = _path(_fly(scene, wind=WindSettings(mean_world_mps=(1.0, 0.0, 0.0), gust_mps=0.5)))
    assert np.abs(blown.p_world[20] - calm.p_world[20]).max() > 0.02
    assert _fly(scene, perception=PRESETS["measured"]).record.steps > 50


def test_a_leader_that_hovers_on_the_way_stands_still_there() -> None:
    swarm = SHORT.model_copy(update={"leader": LeaderBehaviourSettings(behaviour="hover")})
    scene = set_scene(swarm, "none", 5)
    path = _path(_fly(scene))
    at_rest = np.linalg.norm(path.v_world[:, 0], axis=1) < 0.1
    near = np.linalg.norm(path.p_world[:, 0] - scene.waypoints_world[0], axis=1) < 0.6
    assert np.sum(at_rest & near) * 0.05 > scene.holds_s[0] - 3.0
