from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from companion.control.followers.settings import FollowerSettings
from companion.control.leader.settings import LeaderSettings
from sitl.abstract.course import flight_plane, plan_course
from sitl.abstract.flight import fly_abstract
from sitl.abstract.settings import AbstractSettings
from sitl.swarm.scene import SwarmScene, set_scene
from sitl.swarm.settings import SwarmSettings, TerminationSettings
from sitl.worlds.primitives import Box, World
from tests.sitl.abstract.leader_oracle import fly_leader

ALONE = TerminationSettings(gathered_m=100.0, leader_unseen_s=60.0)


def _scene(site: str, seed: int, distance_m: float = 12.0) -> SwarmScene:
    return set_scene(SwarmSettings(goal_distance_m=distance_m, followers=1), site, seed)


def _without_follower(scene: SwarmScene) -> SwarmScene:
    """Put the follower where nothing can happen to it, so that only the leader counts."""
    starts = scene.starts_world.copy()
    starts[1] = [60.0, 60.0, 1.5]
    return replace(scene, starts_world=starts)


@pytest.mark.parametrize(("site", "seed"), [("none", 1), ("pillars_5m", 2), ("pillars_5m", 7), ("forest", 3)])
def test_the_leader_of_the_abstract_swarm_flies_like_the_real_one(site: str, seed: int) -> None:
    scene = _scene(site, seed)
    flight = fly_abstract(
        _without_follower(scene),
        "flock",
        FollowerSettings(),
        AbstractSettings(),
        termination=ALONE,
        record=True,
    )
    assert flight.record.end == "success"
    assert flight.trajectory is not None
    ours, real = flight.trajectory.p_world[:, 0], fly_leader(scene)
    goal = scene.waypoints_world[-1]
    assert np.linalg.norm(real[-1] - goal) < 1.0
    assert np.linalg.norm(ours[-1] - goal) < 1.0
    # One knows the world and the other discovers it, so their paths differ a little, not their manner.
    assert len(ours) == pytest.approx(len(real), rel=0.15)
    if site == "none":
        assert np.abs(ours[: len(real)] - real[: len(ours)]).max() < 0.05
    else:
        obstacles = scene.world.obstacles()
        assert obstacles.clearance(ours).min() > 0.3
        assert obstacles.clearance(real).min() > 0.3


def test_the_flight_plane_knows_how_near_obstacles_are_at_the_leaders_height() -> None:
    scene = _scene("pillars_5m", 5, 30.0)
    field = flight_plane(scene, LeaderSettings())
    points = np.random.default_rng(0).uniform(-12.0, 12.0, (400, 2)) + 0.5 * scene.waypoints_world[-1, :2]
    heights = np.full(400, scene.starts_world[0, 2])
    room = scene.world.obstacles().clearance(np.column_stack([points, heights]))
    free = (room > 0.3) & (room < 2.5)
    assert free.sum() > 50
    found = np.array([field.clearance(point) for point in points])
    # Distances are those to the middle of a cell that an obstacle fills at least half way.
    assert np.abs(found[free] - room[free]).max() < 0.2


def test_a_route_keeps_clear_of_obstacles_and_ends_at_each_waypoint() -> None:
    way = SwarmSettings(waypoints_m=[(15.0, 5.0), (20.0, -10.0)])
    for seed in range(5):
        scene = set_scene(way, "pillars_5m", seed)
        course = plan_course(scene, LeaderSettings(), np.random.default_rng(seed))
        assert course.reached.all()
        np.testing.assert_allclose(course.legs[:, -1], scene.waypoints_world[:, :2])
        np.testing.assert_allclose(course.legs[0, 0], scene.starts_world[0, :2])
        for leg in course.legs:
            along = np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(leg)])
            heights = np.full(len(along), scene.starts_world[0, 2])
            assert scene.world.obstacles().clearance(np.column_stack([along, heights])).min() > 0.4


def test_a_walled_in_goal_leaves_a_straight_line_and_a_trial_that_runs_out_of_time() -> None:
    scene = _scene("none", 1)
    x, y, _ = scene.waypoints_world[-1]
    sides = [(x + 2.0, y, 0.4, 4.4), (x - 2.0, y, 0.4, 4.4), (x, y + 2.0, 4.4, 0.4), (x, y - 2.0, 4.4, 0.4)]
    fort = World.of([Box(centre_world_m=(a, b, 2.0), size_m=(c, d, 4.0)) for a, b, c, d in sides])
    scene = _without_follower(replace(scene, world=fort, timeout_s=30.0))
    flight = fly_abstract(scene, "flock", FollowerSettings(), AbstractSettings(), termination=ALONE)
    assert not flight.course.reached.any()
    assert flight.record.end == "timeout"
    assert flight.record.mission_progress_percent < 100.0
