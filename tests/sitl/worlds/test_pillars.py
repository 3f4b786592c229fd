import math

import numpy as np
import pytest
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


@pytest.mark.parametrize(
    "wrong", [{"radius_max_m": 0.1}, {"size_m": (0.5, 60.0)}, {"reflectivity_max": 0.05}, {"min_gap_m": 0.0}]
)
def test_contradictory_settings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        PillarFieldSettings.model_validate(wrong)
