import itertools
import math
from functools import cache

import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray, ImuSample, LidarScan
from sitl.bench.swarm_scenes import (
    PLAN_START_S,
    SCENES,
    MapFrame,
    SwarmScene,
    SwarmSettings,
    SwarmStep,
    move,
    scene,
    stream,
)
from sitl.bench.swarm_truth import NeighbourSights, SightCounter, look
from sitl.bench.synthetic_flights import SCAN_NS
from sitl.worlds.bodies import Bodies
from sitl.worlds.distractors import DistractorSettings
from sitl.worlds.primitives import Cylinder, World
from sitl.worlds.uav_body import UavBodySettings, uav_body

BODY = UavBodySettings()
AT_ORIGIN = Pose.of([0.0, 0.0, 0.0], rotation.IDENTITY)


@cache
def _flown(name: str, seconds: float, settings: SwarmSettings, seed: int = 1) -> tuple[SwarmStep, ...]:
    return tuple(stream(scene(name, seed, settings), seconds, np.random.default_rng(seed)))


def _sights(steps: tuple[SwarmStep, ...], after_s: float) -> list[NeighbourSights]:
    return [
        step.sights for step in steps if step.sights is not None and step.t_sensor_ns > round(after_s * 1e9)
    ]


def test_equal_seeds_give_equal_streams_and_others_differ() -> None:
    settings = SwarmSettings(uavs=3, distractors=DistractorSettings())
    wanted = scene("weave", 1, settings)
    first, again = (list(stream(wanted, 0.3, np.random.default_rng(1))) for _ in range(2))
    other = list(stream(scene("weave", 2, settings), 0.3, np.random.default_rng(1)))
    for one, same in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.p_world, same.p_world)
        for ours, theirs in zip(one.events, same.events, strict=True):
            if isinstance(ours, LidarScan) and isinstance(theirs, LidarScan):
                assert ours.points_lidar.tobytes() == theirs.points_lidar.tobytes()
                assert ours.reflectivity.tobytes() == theirs.reflectivity.tobytes()
    assert not np.array_equal(first[-1].p_world, other[-1].p_world)


def test_events_come_as_from_a_single_flight_with_sights_at_the_end_of_every_scan() -> None:
    steps = _flown("ring", 0.5, SwarmSettings(uavs=3, range_m=3.0))
    events = [event for step in steps for event in step.events]
    assert all(after.t_ns >= before.t_ns for before, after in itertools.pairwise(events))
    assert sum(isinstance(event, ImuSample) for event in events) == 100
    for step in steps[1:]:
        scans = [event for event in step.events if isinstance(event, LidarScan)]
        assert len(scans) == (step.t_sensor_ns % SCAN_NS == 0)
        if scans:
            assert step.sights is not None
            assert step.sights.t_sensor_ns == scans[0].t_sensor_end_ns
            assert step.sights.sequence == scans[0].sequence
            np.testing.assert_array_equal(step.sights.p_world, step.p_world)
        else:
            assert step.sights is None


@pytest.mark.parametrize("name", SCENES)
def test_the_ego_vehicle_rests_first_and_the_others_hover(name: str) -> None:
    steps = _flown(name, 0.5, SwarmSettings(uavs=4))
    assert steps[0].truth.p_world[2] == pytest.approx(0.1)
    assert np.linalg.norm(steps[-1].truth.v_world) == 0.0
    assert steps[0].p_world.shape == (3, 3)
    assert np.all(steps[-1].p_world[:, 2] > 0.8)


def _moved(wanted: SwarmScene, seconds: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times (k,), positions (k, n, 3) and velocities (k, n, 3) every 50 ms after the plan began."""
    states = list(move(wanted, seconds, np.random.default_rng(3)))[::10]
    times = np.linspace(0.0, seconds, len(states))
    later = times > PLAN_START_S + 1.0
    p_world: FloatArray = np.array([state.p_world for state in states])
    v_world: FloatArray = np.array([state.v_world for state in states])
    return times[later], p_world[later], v_world[later]


@pytest.mark.parametrize(
    ("name", "uavs"), [("ring", 6), ("weave", 5), ("aggressive", 5), ("crowd", 20), ("pass", 5)]
)
def test_nobody_touches_anything(name: str, uavs: int) -> None:
    wanted = scene(name, 3, SwarmSettings(uavs=uavs, range_m=2.0, distractors=DistractorSettings()))
    times, p_world, _ = _moved(wanted, 14.0)
    gaps = np.linalg.norm(p_world[:, :, None] - p_world[:, None], axis=3) + 9.0 * np.eye(uavs)
    assert gaps.min() > 0.8
    assert wanted.world.obstacles().clearance(p_world).min() > 0.35
    people = Bodies(World.of([]), wanted.distractors.people)
    for t, places in zip(times, p_world, strict=True):
        assert people.at(*wanted.distractors.poses(t)).clearance(places).min() > 0.35


def test_neighbours_of_a_ring_keep_their_range_at_up_to_two_metres_a_second() -> None:
    _, p_world, v_world = _moved(scene("ring", 1, SwarmSettings(uavs=5, range_m=4.0)), 15.0)
    away = np.linalg.norm(p_world[:, 1:] - p_world[:, :1], axis=2)
    speeds = np.linalg.norm(v_world[:, 1:] - v_world[:, :1], axis=2)
    assert away.min() > 3.3
    assert away.max() < 4.8
    assert 1.6 < np.percentile(speeds, 98) < 2.4


def test_those_who_pass_do_so_at_two_metres_a_second_and_turn_out_of_reach() -> None:
    times, p_world, v_world = _moved(scene("pass", 3, SwarmSettings(uavs=5, range_m=2.0)), 25.0)
    away = np.linalg.norm(p_world[:, 1:] - p_world[:, :1], axis=2)
    speeds = np.linalg.norm(v_world[:, 1:] - v_world[:, :1], axis=2)
    accelerations = np.linalg.norm(np.diff(v_world[:, 1:], axis=0), axis=2) / np.diff(times)[:, None]
    inside = (away[1:] < 12.0) & (times[1:, None] > PLAN_START_S + 2.5)
    assert 1.5 < away.min() < 2.5
    assert away.max() > 13.0
    assert speeds[1:][inside].mean() == pytest.approx(2.0, abs=0.1)
    assert np.percentile(accelerations[inside], 95) < 0.4


def test_the_aggressive_ego_vehicle_flies_fast_and_turns_at_ninety_degrees_a_second() -> None:
    states = list(move(scene("aggressive", 2), 14.0, np.random.default_rng(1)))[-1200:]
    assert np.percentile([np.linalg.norm(state.v_world[0]) for state in states], 50) > 2.9
    assert np.degrees(np.mean([state.omega_body[0, 2] for state in states])) > 75.0


def test_tape_off_gives_no_tape_returns() -> None:
    steps = _flown("ring", 0.5, SwarmSettings(uavs=3, range_m=2.0, body=UavBodySettings(tape=False)))
    sights = _sights(steps, 0.0)
    assert sum(int(sight.tape_returns.sum()) for sight in sights) == 0
    assert sum(int(sight.diffuse_returns.sum()) for sight in sights) > 0


def _bodies_at(world: World, places: FloatArray) -> World:
    level = np.tile(rotation.IDENTITY, (len(places), 1))
    return Bodies(world, [uav_body(BODY)] * len(places)).at(places, level)


def test_pillars_and_other_uavs_stop_the_test_rays() -> None:
    pillar = Cylinder(start_world_m=(2.0, 0.0, -3.0), end_world_m=(2.0, 0.0, 3.0), radius_m=0.3)
    thin = Cylinder(start_world_m=(0.0, 2.0, -3.0), end_world_m=(0.0, 2.0, 3.0), radius_m=0.02)
    places = np.array(
        [[4.0, 0.0, 0.5], [0.0, 4.0, 0.5], [-2.0, 0.0, 0.3], [-4.0, 0.0, 0.6], [3.0, -3.0, 0.5]]
    )
    world = _bodies_at(World.of([pillar, thin]), places)
    in_field, clear = look(AT_ORIGIN, world, places, 0.125, 0.06)
    assert in_field.all()
    assert clear[0] == 0  # behind the pillar
    assert clear[1] == 2  # a thin pole hides the vertical middle
    assert clear[2] == 5
    assert clear[3] <= 1  # in the shadow of the nearer one
    assert clear[4] == 5


def test_the_field_of_view_tilts_with_the_body() -> None:
    places = np.array([[4.0, 0.0, 0.0], [-4.0, 0.0, 0.0], [0.0, 0.0, 3.0], [4.0, 0.0, -1.0]])
    world = _bodies_at(World.of([]), places)
    level, _ = look(AT_ORIGIN, world, places, 0.125, 0.06)
    assert level.tolist() == [True, True, False, False]
    nose_down = Pose.of([0.0, 0.0, 0.0], rotation.exp([0.0, math.radians(10.0), 0.0]))
    tilted, _ = look(nose_down, world, places, 0.125, 0.06)
    assert tilted.tolist() == [True, False, False, True]


def test_a_neighbour_counts_as_visible_only_if_it_was_at_every_check() -> None:
    counter = SightCounter(1, 0.125, 0.06)
    place = np.array([[4.0, 0.0, 0.5]])
    pillar = Cylinder(start_world_m=(2.0, 0.0, -3.0), end_world_m=(2.0, 0.0, 3.0), radius_m=0.3)
    for world in (World.of([]), World.of([pillar]), World.of([])):
        counter.check(AT_ORIGIN, _bodies_at(world, place), place)
    args = np.zeros(3), place, np.zeros((1, 3)), np.array([rotation.IDENTITY])
    assert not counter.close(100, 0, *args).visible[0]
    counter.check(AT_ORIGIN, _bodies_at(World.of([]), place), place)
    sights = counter.close(200, 1, *args)
    assert sights.visible[0]
    assert sights.range_m[0] == pytest.approx(math.hypot(4.0, 0.5))


def test_what_nobody_can_see_returns_nothing() -> None:
    steps = _flown("crowd", 0.5, SwarmSettings(uavs=20))
    for sights in _sights(steps, 0.0):
        returns = sights.tape_returns + sights.diffuse_returns
        assert returns.shape == (19,)
        assert np.all(returns[sights.range_m > 30.0] == 0)
        assert returns[sights.visible].sum() > 0


def test_the_map_frame_is_the_start_turned_by_its_heading() -> None:
    steps = _flown("ring", 0.5, SwarmSettings(uavs=3, range_m=3.0))
    frame = MapFrame.of(steps[0].truth)
    np.testing.assert_allclose(frame.positions(steps[0].truth.p_world), 0.0, atol=1e-12)
    ahead = rotation.rotate(steps[0].truth.q_world_body, [2.0, 0.0, 0.0])
    np.testing.assert_allclose(frame.positions(steps[0].truth.p_world + ahead), [2.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(frame.velocities(ahead), [2.0, 0.0, 0.0], atol=1e-9)
    assert rotation.angle_between(frame.attitudes(steps[0].truth.q_world_body), rotation.IDENTITY) < 1e-9


def test_a_ring_without_room_and_an_unknown_scene_are_refused() -> None:
    with pytest.raises(ValueError, match="no room"):
        scene("ring", 1, SwarmSettings(uavs=15, range_m=1.0))
    with pytest.raises(KeyError):
        scene("nowhere", 1)


def test_one_uav_alone_is_a_scene_too() -> None:
    alone: SwarmScene = scene("ring", 1, SwarmSettings(uavs=1))
    steps = list(stream(alone, 0.2, np.random.default_rng(0)))
    assert steps[-1].sights is not None
    assert len(steps[-1].sights.visible) == 0
