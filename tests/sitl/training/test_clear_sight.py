from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sitl.abstract.settings import PRESETS, PerceptionSettings
from sitl.training.clear_sight import ClearSight
from sitl.training.environment import SwarmBatch
from sitl.training.environment_settings import ReplaySettings
from sitl.training.privileged_kernels import LEADER_P
from tests.sitl.training.small_batch import copied, mixed_batch, open_batch

_CLEAR = PerceptionSettings(
    scan_period_s=0.05, obstacle_delay_s=0.0, neighbour_delay_s=0.0, ego_delay_s=0.0, position_sigma_m=0.0,
    velocity_sigma_mps=0.0,
)  # fmt: skip
_REFERENCE = 5
"""Place of flock's command among the arrays of a result."""


def _wandering(batch: SwarmBatch, step: int) -> Any:
    """Return flock's own velocities and what sends followers astray, into trials that end."""
    shake = np.random.default_rng(step // 20).normal(0.0, 1.0, (batch.streams, 3))
    return (batch.observation.reference + shake).astype(np.float32)


def test_who_sees_all_as_it_is_by_himself_wants_what_his_teacher_wants(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for preset in ("paper", "measured"):
        monkeypatch.setitem(PRESETS, preset, _CLEAR)
    batch = mixed_batch()
    clear = ClearSight(batch)
    assert np.array_equal(clear.reset().reference, batch.observation.reference)
    ended = 0
    for step in range(400):
        stepped = clear.step(_wandering(batch, step))
        ended += len(stepped.finished)
        assert np.array_equal(stepped.observation.reference, batch.observation.reference), step
    assert ended >= 3, "trials began anew"


def test_a_teacher_sees_more_than_his_pupils_and_changes_nothing_for_them() -> None:
    alone, watched = mixed_batch(), mixed_batch()
    clear = ClearSight(watched)
    alone.reset()
    clear.reset()
    differences = []
    for step in range(100):
        velocity = _wandering(alone, step)
        expected, got = copied(alone.step(velocity)), clear.step(velocity)
        for index, array in enumerate(copied(got)):
            assert index == _REFERENCE or np.array_equal(array, expected[index])
        assert np.array_equal(watched.observation.reference, expected[_REFERENCE])
        differences.append(np.abs(got.observation.reference - expected[_REFERENCE]).max())
    assert np.median(differences) > 0.02


@pytest.mark.parametrize("workers", [1, 3])
def test_equal_batches_have_equal_teachers_on_any_number_of_threads(workers: int) -> None:
    def taught(make: Callable[[], SwarmBatch]) -> list[Any]:
        batch = make()
        clear = ClearSight(batch)
        clear.reset()
        return [clear.step(_wandering(batch, step)).observation.reference.copy() for step in range(60)]

    replay = ReplaySettings(share=0.5)
    first = taught(lambda: mixed_batch(replay=replay))
    assert np.array_equal(first, taught(lambda: mixed_batch(workers=workers, replay=replay)))


@pytest.mark.parametrize(
    ("room_m", "trust", "share"), [(0.7, 1.0, 0.0), (1.3, 1.0, 0.5), (1.8, 1.0, 1.0), (1.3, 0.4, 0.2)]
)
def test_the_nearer_an_obstacle_the_more_a_pupil_keeps_to_what_he_wants_himself(
    room_m: float, trust: float, share: float
) -> None:
    def taught(room_m: float, trust: float = 1.0) -> Any:
        batch = mixed_batch()
        clear = ClearSight(batch, trust=trust)
        clear.reset()
        stepped = batch.step(_wandering(batch, 0))
        for cohort in batch.cohorts:
            cohort.motion[7][:] = room_m
        return clear.look(stepped.observation).reference - batch.observation.reference

    whole = taught(100.0)
    assert np.abs(whole).max() > 0.02
    assert taught(room_m, trust) == pytest.approx(share * whole, abs=1e-6)


def test_a_teacher_of_more_cohesion_draws_nearer() -> None:
    """Followers all round the leader want to go inwards: the law with more cohesion more so."""

    def inwards(cohesion: float) -> float:
        batch = open_batch()
        clear = ClearSight(batch, cohesion=cohesion)
        clear.reset()
        stepped = clear.step(np.zeros((4, 3), np.float32))
        leader = batch.observation.privileged[:, LEADER_P : LEADER_P + 3]
        return float(np.sum(stepped.observation.reference * leader))

    assert inwards(3.0) > inwards(1.0) + 0.1
