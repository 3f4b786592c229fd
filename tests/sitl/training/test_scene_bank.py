import numpy as np
import pytest

from sitl.training.scene_bank import SceneBank
from sitl.worlds.seeds import is_held_out
from tests.sitl.training.small_batch import MIXED, mixed_bank


def test_equal_settings_give_equal_banks_and_other_numbers_other_scenes() -> None:
    bank, again = mixed_bank(), SceneBank.build(MIXED)
    np.testing.assert_array_equal(bank.rows, again.rows)
    np.testing.assert_array_equal(bank.flights, again.flights)
    assert [scene.seed for scene in bank.scenes] == [scene.seed for scene in again.scenes]
    other = SceneBank.build(MIXED.model_copy(update={"first_scene": 1000, "scenes": 2}))
    assert not {scene.seed for scene in other.scenes} & {scene.seed for scene in bank.scenes}


def test_scenes_are_never_those_held_out_for_tests() -> None:
    assert not any(is_held_out(scene.seed) for scene in mixed_bank().scenes)


def test_every_leader_arrives_at_its_goal_and_stays_free_of_obstacles() -> None:
    bank = mixed_bank()
    for scene in bank.scenes:
        flight = bank.flights[slice(*scene.flight)]
        assert np.linalg.norm(flight[-1, :3] - scene.goal) < 1.0
        assert flight[0, 2] == scene.height
        assert 0.05 * (len(flight) - 1) < scene.timeout_s
        steps = np.linalg.norm(np.diff(flight[:, :3], axis=0), axis=1)
        assert steps.max() < 0.05 * 2.5


def test_cells_are_apart_from_each_other_and_from_the_leader() -> None:
    bank = mixed_bank()
    for scene in bank.scenes:
        assert len(scene.cells) >= scene.vehicles - 1
        points = np.vstack([bank.flights[scene.flight[0], :2], scene.cells])
        apart = np.linalg.norm(points[:, None] - points[None], axis=2)
        assert apart[~np.eye(len(points), dtype=np.bool_)].min() > 1.4


def test_swarms_fly_scenes_laid_out_for_grids_of_their_own_size() -> None:
    large = SceneBank.build(MIXED.model_copy(update={"followers": [4, 10], "scenes": 3}))
    assert {large.scenes[k].vehicles for k in large.for_swarm(11)} == {11}
    assert {large.scenes[k].vehicles for k in large.for_swarm(3)} == {5}
    assert large.most_primitives == max(np.diff(scene.obstacles)[0] for scene in large.scenes)


def test_progress_is_told_scene_by_scene() -> None:
    told: list[tuple[int, int]] = []
    settings = MIXED.model_copy(update={"scenes": 3, "worlds": {"pillars_4m": 1.0}})
    bank = SceneBank.build(settings, lambda done, total: told.append((done, total)))
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert {scene.world for scene in bank.scenes} == {"pillars_4m"}


def test_a_bank_that_cannot_be_built_says_so() -> None:
    strict = MIXED.swarm.termination.model_copy(update={"goal_tolerance_m": 1e-9})
    swarm = MIXED.swarm.model_copy(update={"termination": strict})
    with pytest.raises(ValueError, match="can be flown"):
        SceneBank.build(MIXED.model_copy(update={"swarm": swarm, "scenes": 1, "worlds": {"none": 1.0}}))
