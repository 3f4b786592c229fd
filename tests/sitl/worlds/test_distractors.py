import numpy as np
import pytest

from companion.messages import FloatArray
from sitl.worlds.bodies import Bodies
from sitl.worlds.distractors import Distractors, DistractorSettings, no_distractors, person, place_distractors
from sitl.worlds.pillars import PillarFieldSettings, pillar_field
from sitl.worlds.primitives import World
from sitl.worlds.raycast_kernels import BOX, CYLINDER

FIELD = pillar_field(np.random.default_rng(1), PillarFieldSettings(size_m=(30.0, 30.0)))
ANGLES = np.linspace(0.0, 2.0 * np.pi, 60)
PATH = np.column_stack([5.0 * np.cos(ANGLES), 5.0 * np.sin(ANGLES), np.full(60, 1.6)])
SETTINGS = DistractorSettings()


def _placed(seed: int, settings: DistractorSettings = SETTINGS, path: FloatArray = PATH) -> Distractors:
    return place_distractors(np.random.default_rng(seed), FIELD, path, settings)


def test_equal_seeds_give_equal_distractors_and_other_seeds_others() -> None:
    one, same, other = _placed(1), _placed(1), _placed(2)
    np.testing.assert_array_equal(one.fixed.rows, same.fixed.rows)
    np.testing.assert_array_equal(one.poses(3.0)[0], same.poses(3.0)[0])
    assert not np.array_equal(one.fixed.rows, other.fixed.rows)


def test_each_kind_comes_as_often_as_asked_for() -> None:
    fixed = _placed(3).fixed
    shining = fixed.retro_reflective != 0
    assert (shining & (fixed.kinds == BOX)).sum() == 8
    assert (shining & (fixed.kinds == CYLINDER)).sum() == 8
    assert len(_placed(3).people) == 3
    none = DistractorSettings(signs=0, plates=0, taped_poles=0, taped_pillars=0, people=0)
    assert len(_placed(3, none).fixed) == 0
    assert len(no_distractors().fixed) == 0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_distractors_leave_the_flight_its_room(seed: int) -> None:
    placed = _placed(seed)
    standing = World(
        placed.fixed.kinds[:-4], placed.fixed.rows[:-4], placed.fixed.discs[:-4],
        placed.fixed.reflectivity[:-4], placed.fixed.retro_reflective[:-4],
    )  # the last four are bands on pillars of the field  # fmt: skip
    assert standing.clearance(PATH).min() >= SETTINGS.room_m
    bodies = Bodies(World.of([]), placed.people)
    for t in np.linspace(0.0, 40.0, 60):
        assert bodies.at(*placed.poses(float(t))).clearance(PATH).min() > 0.8 * SETTINGS.room_m


def test_bands_lie_just_outside_the_pillars_they_are_on() -> None:
    bands = _placed(4, DistractorSettings(signs=0, plates=0, taped_poles=0, people=0)).fixed
    middles = bands.rows[:, :3] + 0.5 * bands.rows[:, 6:7] * bands.rows[:, 3:6]
    depths = FIELD.obstacles().clearance(middles)
    np.testing.assert_allclose(-depths, bands.rows[:, 7] - 0.001, atol=1e-9)


def test_people_walk_slowly_and_every_third_stands() -> None:
    placed = _placed(5)
    times = np.arange(0.0, 20.0, 0.1)
    places = np.array([placed.poses(float(t))[0] for t in times])
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=0) / 0.1
    assert np.all(speeds[:2] > 0.2)
    assert np.all(speeds <= SETTINGS.walking_mps + 1e-6)
    assert speeds[2] < 1e-6


def test_a_vest_shines_at_the_height_of_a_flying_uav() -> None:
    parts = person(np.random.default_rng(0)).parts
    heights = parts.rows[parts.retro_reflective != 0, 2]
    assert len(heights) == 2
    assert heights.min() > 0.9
    assert heights.max() < 1.5


def test_where_there_is_no_room_fewer_are_placed() -> None:
    everywhere = np.random.default_rng(0).uniform(-15.0, 15.0, (400, 3))
    assert len(_placed(1, DistractorSettings(room_m=4.0), everywhere).people) == 0
