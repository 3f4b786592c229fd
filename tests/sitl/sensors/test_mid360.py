import math

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.geometry import rotation
from companion.geometry.pose import Pose, interpolate
from companion.messages import FloatArray
from sitl.kinematics import BodyTrajectory, Kinematics
from sitl.sensors.mid360 import Mid360Model, Mid360Settings
from sitl.sensors.scan_pattern import ScanPattern
from sitl.slots import PointSlots
from sitl.worlds.pillars import PillarFieldSettings, pillar_field
from sitl.worlds.primitives import Box, Cylinder, Ground, Sphere, World

MOUNT = Pose.of([0.05, -0.02, 0.08], rotation.exp([0.02, 0.1, -0.3]))
ROOM = World.of(
    [
        Ground(),
        Box(centre_world_m=(0.0, 8.0, 2.0), size_m=(20.0, 0.2, 4.0)),
        Box(centre_world_m=(0.0, -8.0, 2.0), size_m=(20.0, 0.2, 4.0)),
        Box(centre_world_m=(10.0, 0.0, 2.0), size_m=(0.2, 16.0, 4.0)),
        Box(centre_world_m=(-10.0, 0.0, 2.0), size_m=(0.2, 16.0, 4.0)),
        Box(centre_world_m=(0.0, 0.0, 4.1), size_m=(20.0, 16.0, 0.2)),
        Cylinder(start_world_m=(3.0, 1.0, 0.0), end_world_m=(3.0, 1.0, 4.0), radius_m=0.3),
        Cylinder(start_world_m=(-2.0, 3.0, 0.0), end_world_m=(-2.0, 3.0, 4.0), radius_m=0.2),
    ]
)


def _still(seconds: float, p_world: tuple[float, float, float] = (0.0, 0.0, 1.5)) -> BodyTrajectory:
    return BodyTrajectory(
        np.array([0, round(seconds * 1e9)]), np.tile(p_world, (2, 1)), np.tile(rotation.IDENTITY, (2, 1))
    )


def _moving(steps: int) -> BodyTrajectory:
    t = np.arange(steps + 1) * 5_000_000
    s = t / 1e9
    p_world = np.stack([3.0 * s, np.sin(5.0 * s), 1.5 + 0.5 * s], axis=1)
    q = rotation.exp(np.stack([0.3 * np.sin(8.0 * s), 0.2 * s, 2.0 * s], axis=1))
    return BodyTrajectory(t, p_world, q)


def _model(settings: Mid360Settings, seed: int = 1, mount: Pose = MOUNT) -> Mid360Model:
    return Mid360Model(np.random.default_rng(seed), mount, settings)


def _returned(slots: PointSlots) -> NDArray[np.bool_]:
    return np.asarray(np.any(slots.points_lidar != 0.0, axis=1))


def _in_world(slots: PointSlots, trajectory: BodyTrajectory) -> FloatArray:
    """Place each point with the pose of its own firing, one by one."""
    points = []
    for i, point in enumerate(slots.points_lidar):
        t = (slots.first_slot + i) // 4 * 20_000
        k = min(max(int(np.searchsorted(trajectory.t_sensor_ns, t)) - 1, 0), len(trajectory.p_world) - 2)
        before, after = (Pose(trajectory.p_world[j], trajectory.q_world_body[j]) for j in (k, k + 1))
        start, end = trajectory.t_sensor_ns[k : k + 2]
        points.append((interpolate(before, after, (t - start) / (end - start)) @ MOUNT).transform(point))
    return np.array(points)


def test_points_of_a_turning_vehicle_lie_on_the_walls_when_each_is_placed_at_its_own_instant() -> None:
    trajectory = _moving(20)
    slots = _model(Mid360Settings.ideal()).measure(0, 2000, trajectory, ROOM)
    returned = _returned(slots)
    assert returned.mean() > 0.9
    points_world = _in_world(slots, trajectory)
    assert np.abs(ROOM.clearance(points_world[returned])).max() < 2e-5


def test_ignoring_the_motion_bends_the_walls() -> None:
    trajectory = _moving(20)
    slots = _model(Mid360Settings.ideal()).measure(0, 20_000, trajectory, ROOM)
    start = Pose(trajectory.p_world[0], trajectory.q_world_body[0]) @ MOUNT
    points_world = start.transform(slots.points_lidar[_returned(slots)])
    assert np.percentile(np.abs(ROOM.clearance(points_world)), 90) > 0.1


def test_noise_and_blanking_do_not_depend_on_how_the_slots_are_divided() -> None:
    near = ROOM.joined(World.of([Sphere(centre_world_m=(0.6, 0.0, 1.6), radius_m=0.15)]))
    trajectory = _moving(20)
    whole = _model(Mid360Settings()).measure(0, 20_000, trajectory, near)
    model, parts = _model(Mid360Settings()), []
    for first, count in ((0, 1), (1, 6), (7, 993), (1000, 5000), (6000, 14_000)):
        parts.append(model.measure(first, count, trajectory, near))
    np.testing.assert_allclose(
        np.concatenate([part.points_lidar for part in parts]), whole.points_lidar, atol=1e-9
    )
    np.testing.assert_array_equal(np.concatenate([part.tags for part in parts]), whole.tags)
    np.testing.assert_array_equal(np.concatenate([part.reflectivity for part in parts]), whole.reflectivity)


def test_equal_seeds_give_equal_bytes_and_others_differ() -> None:
    first, again, other = (
        _model(Mid360Settings(), seed).measure(0, 4000, _still(0.1), ROOM) for seed in (1, 1, 2)
    )
    assert first.points_lidar.tobytes() == again.points_lidar.tobytes()
    assert first.tags.tobytes() == again.tags.tobytes()
    assert not np.array_equal(first.points_lidar, other.points_lidar)


def test_range_noise_has_the_measured_deviation_and_no_bias() -> None:
    ball = World.of([Sphere(centre_world_m=(0.0, 0.0, 0.0), radius_m=10.0, reflectivity=0.5)])
    centred = BodyTrajectory(
        np.array([0, 10**9]), np.tile(-MOUNT.p, (2, 1)), np.tile(rotation.IDENTITY, (2, 1))
    )
    settings = Mid360Settings.ideal().model_copy(update={"range_noise_scale": 1.0})
    slots = _model(settings).measure(0, 40_000, centred, ball)
    errors = np.linalg.norm(slots.points_lidar, axis=1) - 10.0
    assert errors.std() == pytest.approx(math.hypot(0.0034, 0.0073), rel=0.03)
    assert abs(errors.mean()) < 2e-4
    assert errors.std() < 0.02  # the datasheet's bound at 10 m
    assert np.abs(np.corrcoef(errors[:-1], errors[1:])[0, 1]) < 0.02


def test_angle_noise_has_its_deviation_across_the_beam() -> None:
    settings = Mid360Settings.ideal().model_copy(update={"angle_noise_deg": 0.1})
    slots = _model(settings).measure(0, 20_000, _still(0.1), ROOM)
    returned = _returned(slots)
    points = slots.points_lidar[returned]
    nominal = ScanPattern().directions_lidar(0, 20_000)[returned]
    off = np.linalg.norm(np.cross(points / np.linalg.norm(points, axis=1, keepdims=True), nominal), axis=1)
    assert np.degrees(np.sqrt(np.mean(off**2) / 2.0)) == pytest.approx(0.1, rel=0.03)


def _share_seen(world: World, settings: Mid360Settings | None = None) -> float:
    slots = _model(settings or Mid360Settings.ideal(), mount=Pose.identity()).measure(
        0, 20_000, _still(0.1, (0.0, 0.0, 0.0)), world
    )
    return float(_returned(slots).mean())


@pytest.mark.parametrize(
    ("reflectivity", "distance_m", "least", "most"),
    [(0.1, 30.0, 0.99, 1.0), (0.1, 40.0, 0.45, 0.55), (0.1, 46.0, 0.0, 0.0), (0.8, 60.0, 0.99, 1.0),
     (0.8, 70.0, 0.45, 0.55), (0.8, 80.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)],
)  # fmt: skip
def test_dark_surfaces_vanish_nearer_than_bright_ones(
    reflectivity: float, distance_m: float, least: float, most: float
) -> None:
    shell = Sphere(centre_world_m=(0.0, 0.0, 0.0), radius_m=distance_m, reflectivity=reflectivity)
    assert least <= _share_seen(World.of([shell])) <= most


def test_grazing_surfaces_are_missed_as_measured() -> None:
    slots = _model(Mid360Settings.ideal(), mount=Pose.identity()).measure(
        0, 60_000, _still(0.3, (0.0, 0.0, 0.5)), World.of([Ground(reflectivity=1.0)])
    )
    downwards = -ScanPattern().directions_lidar(0, 60_000)[:, 2]
    incidence = 90.0 - np.degrees(np.arcsin(downwards))
    seen = _returned(slots)
    assert seen[(incidence > 82.4) & (incidence < 83.4)].mean() == pytest.approx(0.46, abs=0.12)
    assert seen[(incidence > 84.5) & (incidence < 85.5)].mean() == pytest.approx(0.23, abs=0.06)
    assert seen[(incidence > 87.5) & (incidence < 88.5)].mean() == pytest.approx(0.08, abs=0.04)
    assert not seen[incidence >= 90.0].any()


def test_a_return_from_very_near_costs_the_line_its_next_firing() -> None:
    ball = World.of([Sphere(centre_world_m=(0.0, 0.0, 0.0), radius_m=0.4, reflectivity=0.5)])
    assert _share_seen(ball) == 1.0
    blanking = Mid360Settings.ideal().model_copy(update={"near_range_blanking": True})
    assert _share_seen(ball, blanking) == 0.5
    farther = World.of([Sphere(centre_world_m=(0.0, 0.0, 0.0), radius_m=0.66, reflectivity=0.5)])
    assert _share_seen(farther, blanking) == pytest.approx(1.0 / 1.43, abs=0.02)
    far = World.of([Sphere(centre_world_m=(0.0, 0.0, 0.0), radius_m=0.9, reflectivity=0.5)])
    assert _share_seen(far, blanking) == 1.0


def test_nothing_is_reported_from_the_blind_zone() -> None:
    assert (
        _share_seen(World.of([Sphere(centre_world_m=(0.0, 0.0, 0.0), radius_m=0.09, reflectivity=0.9)]))
        == 0.0
    )


def test_slots_without_return_are_kept_as_zeros() -> None:
    slots = _model(Mid360Settings.ideal()).measure(4, 996, _still(0.1), World.of([]))
    assert slots.first_slot == 4
    assert slots.points_lidar.shape == (996, 3)
    assert not slots.points_lidar.any()
    assert not slots.reflectivity.any()
    assert not slots.tags.any()


def test_reflectivity_follows_lamberts_law_and_tape_shines() -> None:
    world = World.of([Sphere(centre_world_m=(0.0, 0.0, 0.0), radius_m=5.0, reflectivity=0.4)])
    tape = World.of([Sphere(centre_world_m=(0, 0, 0), radius_m=5.0, reflectivity=0.4, retro_reflective=True)])
    model = _model(Mid360Settings.ideal(), mount=Pose.identity())
    still = _still(0.1, (0.0, 0.0, 0.0))
    assert model.measure(0, 4000, still, world).reflectivity.mean() == pytest.approx(60.0, abs=0.5)
    assert model.measure(0, 4000, still, tape).reflectivity.min() >= 151


def test_most_returns_in_a_room_are_trusted_and_the_tags_are_as_recorded_indoors() -> None:
    slots = _model(Mid360Settings()).measure(0, 200_000, _still(1.0), ROOM)
    tags = slots.tags[_returned(slots)]
    share = np.bincount(tags, minlength=64) / len(tags)
    assert share[0] == pytest.approx(0.9835, abs=0.004)
    assert share[16] == pytest.approx(0.0046, abs=0.001)
    assert share[4] == pytest.approx(0.0040, abs=0.001)
    assert 0.002 < share[1] < 0.01
    assert 0.0005 < share[2] < 0.006
    assert share[8] == pytest.approx(0.0006, abs=0.0004)


def test_points_between_two_near_surfaces_carry_the_glue_tag() -> None:
    world = World.of(
        [
            Box(centre_world_m=(6.0, 0.0, 0.0), size_m=(0.2, 40.0, 40.0)),
            Cylinder(start_world_m=(5.3, 0.0, -5.0), end_world_m=(5.3, 0.0, 5.0), radius_m=0.1),
        ]
    )
    settings = Mid360Settings.ideal().model_copy(update={"beam_half_width_deg": 0.2})
    model = _model(settings, mount=Pose.identity())
    slots = model.measure(0, 200_000, _still(1.0, (0.0, 0.0, 0.0)), world)
    glued = np.isin(slots.tags, [1, 2])
    assert glued.sum() > 30
    points = slots.points_lidar
    np.testing.assert_array_less(np.abs(points[glued, 1]), 0.15)
    between = world.clearance(points) > 0.05
    assert between[glued].mean() > 0.5
    sharp = _returned(slots) & ~glued & (np.abs(points[:, 1]) < 5.0)  # not the rim of the wall itself
    assert not between[sharp].any()


def test_edges_between_far_surfaces_make_no_points_in_the_air() -> None:
    world = World.of(
        [
            Box(centre_world_m=(12.0, 0.0, 0.0), size_m=(0.2, 60.0, 60.0)),
            Cylinder(start_world_m=(4.0, 0.0, -5.0), end_world_m=(4.0, 0.0, 5.0), radius_m=0.2),
        ]
    )
    settings = Mid360Settings.ideal().model_copy(update={"beam_half_width_deg": 0.2})
    slots = _model(settings).measure(0, 40_000, _still(0.2, (0.0, 0.0, 0.0)), world)
    mounted = Pose.of([0.0, 0.0, 0.0], rotation.IDENTITY) @ MOUNT
    clearance = np.abs(world.clearance(mounted.transform(slots.points_lidar[_returned(slots)])))
    assert clearance.max() < 0.1


def test_spurious_points_appear_as_often_as_asked_and_are_tagged_low() -> None:
    settings = Mid360Settings.ideal().model_copy(update={"spurious_probability": 0.01})
    slots = _model(settings).measure(0, 40_000, _still(0.2), World.of([]))
    returned = _returned(slots)
    assert returned.mean() == pytest.approx(0.01, abs=0.002)
    assert np.all(slots.tags[returned] == 32)


def test_another_vehicle_is_seen_where_it_is() -> None:
    body = World.of([Sphere(centre_world_m=(2.0, 0.0, 1.8), radius_m=0.15, reflectivity=0.5)])
    model = _model(Mid360Settings.ideal(), mount=Pose.identity())
    slots = model.measure(0, 20_000, _still(0.1), World.of([Ground()]).joined(body))
    seen = slots.points_lidar[np.linalg.norm(slots.points_lidar - [2.0, 0.0, 0.3], axis=1) < 0.2]
    assert len(seen) > 10
    np.testing.assert_allclose(np.linalg.norm(seen - [2.0, 0.0, 0.3], axis=1), 0.15, atol=1e-6)


def test_slots_outside_the_trajectory_are_refused() -> None:
    model = _model(Mid360Settings())
    model.measure(0, 1004, _still(0.005), ROOM)  # the last firing is exactly at the end
    with pytest.raises(ValueError, match="outside the trajectory"):
        model.measure(0, 1005, _still(0.005), ROOM)
    with pytest.raises(ValueError, match="slots must exist"):
        model.measure(0, 0, _still(0.005), ROOM)


def test_a_pillar_field_fills_a_fifth_of_the_slots_at_flying_height() -> None:
    world = pillar_field(np.random.default_rng(1), PillarFieldSettings())
    slots = _model(Mid360Settings(), mount=Pose.identity()).measure(0, 20_000, _still(0.1), world)
    assert 0.1 < _returned(slots).mean() < 0.35


def test_one_step_of_motion_is_a_trajectory() -> None:
    start = Kinematics(np.zeros(3), np.zeros(3), rotation.IDENTITY, np.zeros(3))
    end = Kinematics(np.ones(3), np.zeros(3), rotation.IDENTITY, np.zeros(3))
    trajectory = BodyTrajectory.between(5, start, 10, end)
    np.testing.assert_array_equal(trajectory.t_sensor_ns, [5, 10])
    np.testing.assert_array_equal(trajectory.p_world, [[0, 0, 0], [1, 1, 1]])
    with pytest.raises(ValueError, match="must increase"):
        BodyTrajectory.between(10, start, 10, end)
    with pytest.raises(ValueError, match="needs k >= 2"):
        BodyTrajectory(np.array([0]), np.zeros((1, 3)), np.zeros((1, 4)))
