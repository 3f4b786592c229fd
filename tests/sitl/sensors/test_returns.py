import itertools
import math

import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray
from sitl.kinematics import BodyTrajectory
from sitl.sensors.mid360 import Mid360Model, Mid360Settings, Observation
from sitl.sensors.ranging_kernels import distance_probability
from sitl.sensors.return_kernels import reported_reflectivity, strength_of
from sitl.sensors.scan_pattern import ScanPattern
from sitl.worlds.bodies import Bodies, Body
from sitl.worlds.primitives import Box, Ground, Sphere, World
from sitl.worlds.uav_body import UavBodySettings, uav_body

CUTOFF = math.radians(45.0)
IDEAL = Mid360Settings.ideal()


def _slow_strength(retro: bool, reflectivity: float, angle_deg: float, distance: float) -> float:
    """Return the law in words: gain, times entrance, times distance, over a white face."""
    cosine = math.cos(math.radians(angle_deg))
    if not retro:
        return reflectivity * cosine
    entrance = cosine**6
    if angle_deg > 45.0:
        entrance *= 10.0 ** (-0.16 * (angle_deg - 45.0))
    return float(1000.0**reflectivity * entrance / (1.0 + (distance / 8.0) ** 2) + 0.3 * cosine)


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 44.0, 46.0, 60.0, 85.0])
@pytest.mark.parametrize("distance", [0.5, 3.0, 10.0, 40.0])
def test_strength_follows_the_law(angle_deg: float, distance: float) -> None:
    cosine = math.cos(math.radians(angle_deg))
    for retro in (False, True):
        for reflectivity in (0.1, 0.8, 1.0):
            expected = _slow_strength(retro, reflectivity, angle_deg, distance)
            strength = strength_of(int(retro), reflectivity, cosine, distance, 8.0, CUTOFF)
            assert strength == pytest.approx(expected, rel=1e-9)


def _reported(angle_deg: float, distance: float, reflectivity: float = 0.8) -> int:
    cosine = math.cos(math.radians(angle_deg))
    return reported_reflectivity(strength_of(1, reflectivity, cosine, distance, 8.0, CUTOFF), 0.0)


@pytest.mark.parametrize("distance", [1.0, 3.0, 5.0, 8.0, 10.0])
def test_tape_is_bright_to_45_degrees_and_below_the_threshold_soon_after(distance: float) -> None:
    assert all(_reported(angle, distance) > 180 for angle in range(0, 46, 5))
    assert _reported(51.0, distance) < 170
    assert all(_reported(angle, distance) <= 150 for angle in range(56, 90, 5))
    values = [_reported(angle, distance) for angle in range(90)]
    assert all(later <= earlier for earlier, later in itertools.pairwise(values))


def test_tape_darkens_with_range_but_stays_retro_reflective_when_met_squarely() -> None:
    values = [_reported(0.0, distance) for distance in (0.5, 3.0, 5.0, 10.0, 20.0, 40.0)]
    assert all(later < earlier for earlier, later in itertools.pairwise(values))
    assert values[0] > 225
    assert values[-1] > 170


def test_diffuse_surfaces_never_reach_the_numbers_of_retro_reflectors() -> None:
    assert reported_reflectivity(1.0, 5.0) == 150
    assert reported_reflectivity(0.0, -5.0) == 0
    assert reported_reflectivity(1.001, -5.0) == 151
    assert reported_reflectivity(1e6, 5.0) == 255


def _observe(
    world: World,
    settings: Mid360Settings,
    seconds: float = 0.1,
    p_world: tuple[float, float, float] = (0, 0, 0),
) -> Observation:
    still = BodyTrajectory(
        np.array([0, round(seconds * 1e9)]),
        np.tile(p_world, (2, 1)) * 1.0,
        np.tile(rotation.IDENTITY, (2, 1)),
    )
    model = Mid360Model(np.random.default_rng(1), Pose.identity(), settings)
    return model.observe(0, round(seconds * 200_000), still, world)


@pytest.mark.parametrize("yaw_deg", [0.0, 48.0])
def test_sources_tell_tape_from_hull_and_the_numbers_agree(yaw_deg: float) -> None:
    q = [rotation.from_yaw(math.radians(yaw_deg))]
    world = Bodies(World.of([]), [uav_body(UavBodySettings())]).at([[2.0, 0.0, 0.1]], q)
    seen = _observe(world, IDEAL, 0.3)
    hit = seen.sources >= 0
    assert set(np.unique(world.bodies_of(seen.sources[hit]))) == {0}
    np.testing.assert_array_equal(seen.sources[hit], seen.aimed[hit])  # thin beams return from what they meet
    assert hit.sum() > 0.93 * (seen.aimed >= 0).sum()
    tape = hit & (world.retro_reflective[seen.sources] != 0)
    assert tape.sum() > 20
    assert (hit & ~tape).sum() > 20
    assert seen.slots.reflectivity[hit & ~tape].max() <= 150
    assert np.all(seen.slots.reflectivity[tape] > 170) == (yaw_deg == 0.0)
    bare = Bodies(World.of([]), [uav_body(UavBodySettings(tape=False))]).at([[2.0, 0.0, 0.1]], q)
    assert _observe(bare, IDEAL, 0.3).slots.reflectivity.max() < 30


def test_rims_of_a_body_make_glue_points_to_a_near_wall_and_none_to_a_far_one() -> None:
    body = Body.of([Box(centre_world_m=(0.0, 0.0, 0.0), size_m=(0.25, 0.25, 0.25), reflectivity=0.4)])
    settings = IDEAL.model_copy(update={"beam_half_width_deg": 0.4})
    glued = []
    for wall_m in (0.3, 3.0):
        wall = Box(centre_world_m=(3.125 + wall_m, 0.0, 0.0), size_m=(0.01, 30.0, 30.0), reflectivity=0.4)
        world = Bodies(World.of([wall]), [body]).at([[3.0, 0.0, 0.3]], [rotation.IDENTITY])
        seen = _observe(world, settings, 1.0)
        points = seen.slots.points_lidar[seen.sources >= 0]
        beside_body = np.abs(points[:, 1]) < 1.0  # not the rim of the wall itself
        glued.append(int((world.clearance(points[beside_body]) > 0.05).sum()))
    assert glued[0] > 10
    assert glued[1] == 0


def _plate(distance: float, strength: float) -> World:
    return World.of(
        [
            Box(
                centre_world_m=(distance, 0.0, 0.3),
                size_m=(0.01, 0.25, 0.25),
                reflectivity=strength,
                retro_reflective=True,
            )
        ]
    )


def _beside(seen: Observation) -> FloatArray:
    """Return by how many metres returns (n,) lie outside the plate's outline."""
    points = seen.slots.points_lidar[np.any(seen.slots.points_lidar != 0.0, axis=1)]
    return np.asarray(np.maximum(np.abs(points[:, 1]), np.abs(points[:, 2] - 0.3)) - 0.125)


def test_a_near_strong_reflector_has_a_halo_and_a_far_or_dull_one_has_none() -> None:
    settings = IDEAL.model_copy(update={"halo_probability": 1.0})
    near = _beside(_observe(_plate(2.0, 0.95), settings, 1.0))
    assert (near > 0.002).sum() > 10
    assert near.max() < 2.1 * math.radians(0.5) * 1.5
    assert (_beside(_observe(_plate(2.0, 0.95), IDEAL, 0.5)) > 0.002).sum() == 0
    assert (_beside(_observe(_plate(2.0, 0.3), settings, 0.5)) > 0.002).sum() == 0


def test_a_strong_reflector_throws_weak_ghosts_at_twice_its_distance() -> None:
    shell = World.of(
        [Sphere(centre_world_m=(0, 0, 0), radius_m=4.0, reflectivity=0.8, retro_reflective=True)]
    )
    seen = _observe(shell, IDEAL.model_copy(update={"ghost_probability": 0.01}))
    distances = np.linalg.norm(seen.slots.points_lidar, axis=1)
    ghosts = np.abs(distances - 8.0) < 1e-6
    assert ghosts.mean() == pytest.approx(0.01, abs=0.002)
    assert np.all(seen.sources[ghosts] == -1)
    assert seen.slots.reflectivity[ghosts].max() < 60
    np.testing.assert_allclose(distances[~ghosts], 4.0)


def test_smooth_ground_mirrors_strong_reflectors_and_dull_bodies_not() -> None:
    settings = IDEAL.model_copy(update={"mirror_probability": 1.0})
    images = []
    for strength, retro in ((0.9, True), (0.9, False)):
        plate = Box(
            centre_world_m=(8.0, 0.0, 0.5),
            size_m=(0.01, 0.8, 0.4),
            reflectivity=strength,
            retro_reflective=retro,
        )
        ground = Ground(reflectivity=0.2)
        seen = _observe(World.of([ground, plate]), settings, 0.5, (0.0, 0.0, 0.3))
        points = seen.slots.points_lidar + np.array([0.0, 0.0, 0.3])
        below = points[:, 2] < -0.05
        assert np.all(seen.sources[below] == -1)
        images.append(points[below])
    assert len(images[0]) > 5
    np.testing.assert_allclose(images[0][:, 0], 8.0, atol=0.02)
    np.testing.assert_array_less(np.abs(images[0][:, 2] + 0.5), 0.21)  # as far below as it is above
    assert len(images[1]) == 0


def _beams_that_meet(half_size: FloatArray, centre: FloatArray, yaw: float, scans: int) -> float:
    """Count the pattern's beams that meet an upright cuboid by slabs; the mean over scans."""
    back = rotation.from_yaw(-yaw)
    d = rotation.rotate(back, ScanPattern().directions_lidar(0, 20_000 * scans))
    o = rotation.rotate(back, -centre)
    with np.errstate(divide="ignore"):
        low, high = (-half_size - o) / d, (half_size - o) / d
    near, far = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
    return float(((near <= far) & (far > 0.0)).sum() / scans)


@pytest.mark.parametrize("range_m", [3.0, 5.0, 10.0])
def test_a_uav_returns_as_many_points_as_beams_meet_it_falling_with_the_square_of_range(
    range_m: float,
) -> None:
    """The hull alone is the least; scanner, legs, arms and blades add as much again at most."""
    scans, yaw = (60, 0.5) if range_m > 5.0 else (20, 0.5)
    centre = range_m * np.array([math.cos(0.3), math.sin(0.3), 0.05])
    world = Bodies(World.of([]), [uav_body(UavBodySettings())]).at([centre], [rotation.from_yaw(yaw)])
    seen = _observe(world, IDEAL, 0.1 * scans)
    beams, returns = (seen.aimed >= 0).sum() / scans, (seen.sources >= 0).sum() / scans
    expected = _beams_that_meet(0.5 * np.array(UavBodySettings().hull_size_m), centre, yaw, scans)
    assert beams == pytest.approx(110.0 / range_m**2, rel=0.25)
    assert expected <= beams < 2.0 * expected
    assert 0.8 * beams < returns <= beams  # grazing ones are lost


def test_the_chance_of_detection_needs_no_root_where_it_is_certain() -> None:
    for reflectivity in (1e-4, 0.01, 0.0999, 0.1, 0.8, 40.0):
        for exponent in (0.0, 0.269, 1.0, -0.5, 1.5):
            limit = 40.0 * (10.0 * reflectivity) ** exponent
            for share in (0.0, 0.5, 0.84, 0.86, 0.91, 1.0, 1.09, 1.2):
                for distance in (share * limit, share * 40.0 * min(10.0 * reflectivity, 1.0)):
                    expected = min(max((1.1 - distance / limit) * 5.0, 0.0), 1.0)
                    found = distance_probability(distance, reflectivity, 40.0, exponent)
                    assert found == pytest.approx(expected, abs=1e-12)
