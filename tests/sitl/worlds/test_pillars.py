import math

import numpy as np
import pytest
from numpy.random import Generator
from pydantic import ValidationError

from companion.messages import FloatArray
from sitl.worlds.pillars import PillarFieldSettings, pillar_field
from sitl.worlds.primitives import World
from sitl.worlds.raycast_kernels import CYLINDER, PLANE

SETTINGS = PillarFieldSettings(size_m=(60.0, 60.0), spawn_world_m=(-25.0, 0.0), goal_world_m=(25.0, 0.0))


def _gaps(world: World) -> FloatArray:
    discs = world.discs[1:]
    gaps = (
        np.linalg.norm(discs[:, None, :2] - discs[None, :, :2], axis=2)
        - discs[:, None, 2]
        - discs[None, :, 2]
    )
    np.fill_diagonal(gaps, math.inf)
    return np.asarray(gaps)


@pytest.mark.parametrize(("gap_m", "fewest"), [(5.0, 60), (10.0, 18)])
def test_surfaces_keep_the_gap_and_the_field_is_full(gap_m: float, fewest: int) -> None:
    settings = SETTINGS.model_copy(update={"min_gap_m": gap_m})
    for seed in range(3):
        world = pillar_field(np.random.default_rng(seed), settings)
        gaps = _gaps(world)
        assert gaps.min() >= gap_m
        assert len(world) - 1 >= fewest
        assert np.median(gaps.min(axis=1)) < 1.6 * gap_m  # no large holes: neighbours are about a gap away


def test_spawn_and_goal_are_free() -> None:
    for seed in range(5):
        world = pillar_field(np.random.default_rng(seed), SETTINGS).obstacles()
        spawn, goal = world.clearance([[-25.0, 0.0, 1.0], [25.0, 0.0, 1.0]])
        assert spawn >= 4.0
        assert goal >= 2.5


def test_pillars_have_the_size_asked_for_and_stay_inside() -> None:
    world = pillar_field(np.random.default_rng(1), SETTINGS)
    assert world.kinds[0] == PLANE
    assert np.all(world.kinds[1:] == CYLINDER)
    radii, heights = world.rows[1:, 7], world.rows[1:, 6]
    assert radii.min() >= 0.2
    assert radii.max() <= 0.5
    assert radii.std() > 0.05
    np.testing.assert_allclose(heights, 5.0)
    low, high = world.bounds_xy()
    assert low.min() >= -30.0
    assert high.max() <= 30.0
    assert np.all((world.reflectivity[1:] >= 0.1) & (world.reflectivity[1:] <= 0.8))


def test_equal_generators_give_equal_fields_and_others_differ() -> None:
    first, again, other = (pillar_field(np.random.default_rng(seed), SETTINGS) for seed in (8, 8, 9))
    np.testing.assert_array_equal(first.rows, again.rows)
    np.testing.assert_array_equal(first.reflectivity, again.reflectivity)
    assert first.rows.shape != other.rows.shape or not np.array_equal(first.rows, other.rows)


def placed_one_by_one(rng: Generator, settings: PillarFieldSettings) -> FloatArray:
    """The same rule drawn number by number: (n, 3) x, y and radius in order."""
    low = np.array(settings.centre_world_m) - 0.5 * np.array(settings.size_m)
    high = np.array(settings.centre_world_m) + 0.5 * np.array(settings.size_m)
    kept = [(*settings.spawn_world_m, settings.spawn_clear_m)]
    if settings.goal_world_m is not None:
        kept.append((*settings.goal_world_m, settings.goal_clear_m))
    pillars, failures = [], 0
    while failures < settings.failures_until_full:
        radius = rng.uniform(settings.radius_min_m, settings.radius_max_m)
        x, y = rng.uniform(low + radius, high - radius)
        others = np.array(kept)
        if np.any(np.hypot(others[:, 0] - x, others[:, 1] - y) < others[:, 2] + radius):
            failures += 1
            continue
        failures = 0
        pillars.append((x, y, radius))
        kept.append((x, y, radius + settings.min_gap_m))
    return np.array(pillars)


@pytest.mark.parametrize(
    "settings",
    [
        SETTINGS.model_copy(update={"failures_until_full": 300}),
        PillarFieldSettings(
            min_gap_m=10.0, centre_world_m=(7.0, -3.0), height_m=4.7, failures_until_full=200
        ),
        PillarFieldSettings(min_gap_m=0.5, size_m=(30.0, 22.0), failures_until_full=50),
    ],
    ids=["5 m", "10 m", "0.5 m"],
)
def test_a_field_is_bit_for_bit_the_one_that_slow_placing_gives(settings: PillarFieldSettings) -> None:
    for seed in range(2):
        fast, slow = np.random.default_rng(seed), np.random.default_rng(seed)
        world = pillar_field(fast, settings)
        expected = placed_one_by_one(slow, settings)
        assert len(expected) > 5
        np.testing.assert_array_equal(world.rows[1:, [0, 1, 7]], expected)
        np.testing.assert_array_equal(world.discs[1:], expected)
        shades = slow.uniform(settings.reflectivity_min, settings.reflectivity_max, len(expected))
        np.testing.assert_array_equal(world.reflectivity[1:], shades)
        assert fast.random() == slow.random()


@pytest.mark.parametrize(
    "wrong", [{"radius_max_m": 0.1}, {"size_m": (0.5, 60.0)}, {"reflectivity_max": 0.05}, {"min_gap_m": 0.0}]
)
def test_contradictory_settings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        PillarFieldSettings.model_validate(wrong)
