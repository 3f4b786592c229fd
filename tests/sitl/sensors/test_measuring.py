"""The one kernel that measures a step does what its parts do one after the other."""

import math

import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.pose import Pose
from sitl.kinematics import BodyTrajectory
from sitl.sensors.imu_kernels import blur_inertial, shake, turn_rotors
from sitl.sensors.mid360 import Mid360Model, Mid360Settings, Observation
from sitl.sensors.ranging_kernels import place_beams
from sitl.sensors.return_kernels import find_mirrors, form_returns
from sitl.sensors.scan_pattern import usual_pattern
from sitl.slots import PointSlots
from sitl.worlds.primitives import Box, Cylinder, Ground, Sphere, World

WORLD = World.of(
    [
        Ground(reflectivity=0.3),
        Box(centre_world_m=(0.0, 0.0, 3.0), size_m=(20.0, 16.0, 8.0), reflectivity=0.5),
        Cylinder(start_world_m=(3.0, 1.0, 0.0), end_world_m=(3.0, 1.2, 4.0), radius_m=0.3),
        Box(centre_world_m=(-2.0, 0.5, 1.0), size_m=(0.5, 2.0, 2.0), yaw_deg=30.0),
        Sphere(centre_world_m=(4.0, -2.0, 0.6), radius_m=0.4, reflectivity=0.9, retro_reflective=True),
    ]
)
MOUNT = Pose.of([0.05, -0.02, 0.08], rotation.normalize([1.0, 0.02, -0.05, 0.3]))
TRAJECTORY = BodyTrajectory(
    np.array([0, 5_000_000, 10_000_000]),
    np.array([[0.0, 0.0, 1.5], [0.01, 0.0, 1.5], [0.02, 0.01, 1.51]]),
    np.array([[1.0, 0.0, 0.0, 0.0], [0.999, 0.0, 0.02, 0.03], [0.998, 0.0, 0.03, 0.05]]),
)
SLOTS = 2000


def _in_parts(settings: Mid360Settings, first_slot: int) -> Observation:
    """Measure with each part by itself, in the order in which light travels."""
    seed = int(np.random.default_rng(1).integers(2**62))
    directions = usual_pattern().directions_lidar(first_slot, SLOTS)
    origins, axes, rims = (np.empty((SLOTS, 3)) for _ in range(3))
    place_beams(
        seed, first_slot, math.radians(settings.beam_half_width_deg),
        math.radians(settings.halo_half_width_deg), settings.halo_probability, TRAJECTORY.t_sensor_ns,
        TRAJECTORY.p_world + rotation.rotate(TRAJECTORY.q_world_body, MOUNT.p),
        rotation.multiply(TRAJECTORY.q_world_body, MOUNT.q), directions, origins, axes, rims,
    )  # fmt: skip
    hits = WORLD.cast(origins, axes, settings.max_range_m)
    has_width = settings.beam_half_width_deg > 0.0 or settings.halo_probability > 0.0
    rim_hits = WORLD.cast(origins, rims, settings.max_range_m) if has_width else hits
    image_ranges, images = np.full(SLOTS, math.inf), np.full(SLOTS, -1, np.int32)
    image_cosines = np.zeros(SLOTS)
    points, directions_after, numbers = np.empty((SLOTS, 3)), np.empty((SLOTS, 3)), np.empty(SLOTS, np.int64)
    count = find_mirrors(
        seed, first_slot, settings.mirror_probability, origins, axes, WORLD.kinds, hits.ranges, hits.indices,
        hits.cosines, points, directions_after, numbers,
    )  # fmt: skip
    for j in range(count):
        beyond = WORLD.cast(points[j : j + 1], directions_after[j : j + 1], settings.max_range_m)
        image_ranges[numbers[j]] = hits.ranges[numbers[j]] + beyond.ranges[0]
        images[numbers[j]], image_cosines[numbers[j]] = beyond.indices[0], beyond.cosines[0]
    slots = PointSlots(first_slot, np.empty((SLOTS, 3)), np.empty(SLOTS, np.uint8), np.empty(SLOTS, np.uint8))
    sources = np.empty(SLOTS, np.int32)
    form_returns(
        seed, first_slot, settings.packed(), directions, hits.ranges, hits.indices, hits.cosines,
        image_ranges, images, image_cosines, rim_hits.ranges, rim_hits.indices, rim_hits.cosines,
        WORLD.reflectivity, WORLD.retro_reflective, np.zeros(4, np.uint8),
        slots.points_lidar, slots.reflectivity, slots.tags, sources,
    )  # fmt: skip
    return Observation(slots, hits.indices, sources)


@pytest.mark.parametrize(
    "settings",
    [
        Mid360Settings(mirror_probability=0.5),
        Mid360Settings.ideal(),
        Mid360Settings(beam_half_width_deg=0.0, halo_probability=0.0),
    ],
    ids=["usual", "ideal", "thin beams"],
)
def test_all_at_once_is_bit_for_bit_what_the_parts_make(settings: Mid360Settings) -> None:
    model = Mid360Model(np.random.default_rng(1), MOUNT, settings)
    together, parts = model.observe(0, SLOTS, TRAJECTORY, WORLD), _in_parts(settings, 0)
    assert np.array_equal(together.slots.points_lidar, parts.slots.points_lidar)
    assert np.array_equal(together.slots.reflectivity, parts.slots.reflectivity)
    assert np.array_equal(together.slots.tags, parts.slots.tags)
    assert np.array_equal(together.aimed, parts.aimed)
    assert np.array_equal(together.sources, parts.sources)
    assert (together.sources >= 0).mean() > 0.2


def test_a_chip_errs_as_the_formula_says() -> None:
    rng = np.random.default_rng(3)
    errors, truth, vibration = rng.normal(size=(5, 6)), rng.normal(size=6), rng.normal(size=6)
    errors[4] = [0.4, 2.0, 9.0, 9.0, 9.0, 9.0]
    deviates, wander, measured = rng.normal(size=12), rng.normal(size=6), np.empty((2, 3))
    new_wander = 0.9 * wander + math.sqrt(1.0 - 0.9 * 0.9) * errors[1] * deviates[:6]
    wanted = errors[3] * (truth + vibration) + errors[0] + new_wander + errors[2] * deviates[6:]
    blur_inertial(0.9, errors, truth, vibration, deviates, wander, measured)
    np.testing.assert_allclose(wander, new_wander, rtol=1e-14)
    np.testing.assert_allclose(measured.ravel(), np.clip(wanted, -errors[4], errors[4]), rtol=1e-13)


def test_rotors_turn_and_shake_as_the_formula_says() -> None:
    rng = np.random.default_rng(4)
    turns, rotor_hz, offsets = rng.random(4), rng.uniform(50.0, 100.0, 4), rng.random((4, 2))
    new_turns, phases = (turns + 0.005 * rotor_hz) % 1.0, np.empty((4, 2))
    turn_rotors(0.005, rotor_hz, turns, offsets, phases)
    np.testing.assert_allclose(turns, new_turns, rtol=1e-14)
    wanted = 2.0 * math.pi * (np.stack([new_turns, 2.0 * new_turns], axis=1) + offsets)
    np.testing.assert_allclose(phases, wanted, rtol=1e-14)
    mixing, rms, deviates, vibration = rng.normal(size=(6, 8)), rng.random(6), rng.normal(size=6), np.empty(6)
    shake(1.2, 0.3, mixing, np.sin(phases), rms, deviates, vibration)
    tones = mixing @ np.sin(phases).ravel()
    np.testing.assert_allclose(
        vibration, 1.2 * rms * (math.sqrt(0.3) * tones + math.sqrt(0.7) * deviates), rtol=1e-12
    )
