from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from companion.control.followers.settings import FollowerSettings
from companion.messages import Float32Array
from sitl.abstract.flight import fly_abstract
from sitl.dynamics_kernels import P, Q
from sitl.swarm.scene import set_scene
from sitl.training import batch_layout_kernels as at
from sitl.training.cohort import Cohort
from sitl.training.environment import TERMS, EpisodeSummary, SwarmBatch
from sitl.training.environment_kernels import begin_swarms
from sitl.training.environment_settings import EnvironmentSettings, ReplaySettings
from sitl.training.privileged_kernels import LEADER_P
from sitl.training.randomisation import WIDE
from sitl.training.reward_settings import RewardSettings
from tests.sitl.training.small_batch import MIXED, SHORT, copied, flown, mixed_bank, mixed_batch, open_batch

_SPEED_MPS = 2.0
_UNHELD = "paper-1"
"""What a policy of this contract says is not held to what flock allows: it may collide."""
_COLLISION, _LOSS = TERMS.index("collision"), TERMS.index("loss")


def _only(batch: SwarmBatch) -> Cohort:
    (cohort,) = batch.cohorts
    return cohort


def _hovering(batch: SwarmBatch) -> Float32Array:
    return np.zeros((batch.streams, 3), np.float32)


def _towards_leader(batch: SwarmBatch, stream: int) -> Float32Array:
    velocity = _hovering(batch)
    to_leader = batch.observation.privileged[stream, LEADER_P : LEADER_P + 3]
    velocity[stream] = _SPEED_MPS * to_leader / np.linalg.norm(to_leader)
    return velocity


@pytest.mark.parametrize("index", range(4))
def test_a_swarm_flown_by_its_law_flies_as_a_trial_does(index: int) -> None:
    bank = mixed_bank()
    scene = bank.scenes[index]
    followers = scene.vehicles - 1
    settings = MIXED.model_copy(update={"swarms": 1, "followers": [followers], "end_on_loss": False})
    batch = SwarmBatch(settings, "best-2", 5, bank=bank)
    batch.reset()
    cohort = _only(batch)
    # The trial of this very scene: chance in it comes from the scene's own seed, as in a campaign.
    cohort.set_rules(0, scene, batch._conditions.draw(scene.perception, batch._rng), scene.seed, 100_000)
    cohort.start(0, scene, bank.flights[scene.flight[0]], settings, batch._rng)
    begin_swarms(
        np.zeros(1, np.int64), batch._number, batch.sites, batch.rays, batch._law, cohort.swarm,
        cohort.motion, cohort.views, cohort.acts, batch._shown, cohort.snapshots,
    )  # fmt: skip
    state = cohort.motion[3][0]
    starts, quaternions = state[:, P : P + 3].copy(), state[:, Q : Q + 4].copy()
    swarm = SHORT.model_copy(
        update={
            "followers": followers,
            "leader": SHORT.leader.model_copy(update={"behaviour": scene.behaviour}),
        }
    )
    trial = replace(
        set_scene(swarm, scene.world, scene.seed),
        starts_world=starts,
        yaws=2.0 * np.arctan2(quaternions[:, 3], quaternions[:, 0]),
    )
    rules = swarm.termination.model_copy(update={"leader_unseen_s": 60.0})
    expected = fly_abstract(
        trial,
        "flock",
        FollowerSettings(),
        settings.abstract(scene.perception),
        termination=rules,
        record=True,
    )
    assert expected.trajectory is not None
    # Without a velocity the law's own command is flown, unrounded.
    nothing = np.full((batch.streams, 3), np.nan, np.float32)
    for step in range(1, len(expected.trajectory.t)):
        result = batch.step(nothing)
        if step < len(expected.trajectory.t) - 1:
            now = step % cohort.motion[0].shape[1]
            np.testing.assert_allclose(
                cohort.motion[0][0, now, :, :3], expected.trajectory.p_world[step], rtol=0.0, atol=1e-9
            )
    (summary,) = result.finished
    assert summary.end == expected.record.end
    assert summary.steps == len(expected.trajectory.t) - 1
    assert summary.flock_radius_m == pytest.approx(expected.record.flock_radius_m, abs=1e-9)
    assert summary.minimum_separation_m == pytest.approx(expected.record.minimum_separation_m, abs=1e-9)
    assert summary.alignment == pytest.approx(expected.record.alignment, abs=1e-9)


def _history(batch: SwarmBatch, steps: int) -> list[list[np.ndarray]]:
    noise = np.random.default_rng(3)
    batch.reset()
    history = []
    for _ in range(steps):
        off = noise.normal(0.0, 0.5, (batch.streams, 3)).astype(np.float32)
        history.append(copied(batch.step(batch.observation.reference + off)))
    return history


def _same(first: list[list[np.ndarray]], second: list[list[np.ndarray]]) -> bool:
    return all(
        np.array_equal(a, b)
        for here, there in zip(first, second, strict=True)
        for a, b in zip(here, there, strict=True)
    )


def test_what_is_shown_and_paid_does_not_depend_on_steps_that_nobody_looks_at() -> None:
    batch = mixed_batch(1, 1, episode_s=1.0, stagger_s=1.0)
    off = np.random.default_rng(3).normal(0.0, 0.5, (60, batch.streams, 3)).astype(np.float32)
    batch.reset()
    looked = [copied(batch.step(batch.observation.reference + change)) for change in off]
    batch.reset()
    for step, change in enumerate(off):
        is_shown = step % 3 == 2
        seen = copied(batch.step(batch.observation.reference + change, is_shown=is_shown))
        from_here = 0 if is_shown else 5  # the reference, and all that is paid
        assert _same([looked[step][from_here:]], [seen[from_here:]])


def test_results_depend_on_the_seed_and_not_on_the_number_of_threads() -> None:
    changes: dict[str, Any] = {
        "randomisation": WIDE,
        "replay": ReplaySettings(share=0.5),
        "episode_s": 3.0,
        "stagger_s": 1.0,
    }
    once = _history(mixed_batch(1, 1, **changes), 100)
    batch = mixed_batch(1, 3, **changes)
    again = _history(batch, 100)
    batch.close()
    assert _same(once, again)
    assert not _same(once, _history(mixed_batch(2, 1, **changes), 100))


def test_it_goes_on_from_a_state_as_if_nothing_had_happened() -> None:
    changes: dict[str, Any] = {"randomisation": WIDE, "replay": ReplaySettings(share=0.5), "episode_s": 2.0}
    batch = mixed_batch(1, 1, **changes)
    batch.reset()
    flown(batch, 30)
    state = batch.state()
    expected = [copied(flown(batch, 1)) for _ in range(60)]
    other = mixed_batch(9, 1, **changes)
    other.reset()
    other.restore(state)
    assert _same(expected, [copied(flown(other, 1)) for _ in range(60)])


def test_another_update_begins_other_trials_and_the_same_one_the_same() -> None:
    batch = mixed_batch(1)
    first = batch.reset(4).ego.copy()
    assert not np.array_equal(first, batch.reset(5).ego)
    flown(batch, 5)
    np.testing.assert_array_equal(first, batch.reset(4).ego)


def test_a_collision_ends_the_life_of_those_in_it_and_only_the_trial_of_the_others() -> None:
    batch = open_batch(contract=_UNHELD, reward=RewardSettings(collision=25.0))
    batch.reset()
    for _ in range(200):
        result = batch.step(_towards_leader(batch, 2))
        if result.finished:
            break
    (summary,) = result.finished
    assert summary.end in ("leader_follower", "uav_uav")
    assert 3 in summary.ended_by
    hit = np.isin(np.arange(1, 5), summary.ended_by)
    assert result.terminated.tolist() == hit.tolist()
    assert result.truncated.tolist() == (~hit).tolist()
    assert result.terms[:, _COLLISION].tolist() == (-1.0 * hit).tolist()
    assert result.terms[:, _LOSS].tolist() == [0.0] * 4
    without = result.terms[2] @ np.where(np.arange(len(TERMS)) == _COLLISION, 0.0, RewardSettings().weights)
    assert result.reward[2] == pytest.approx(without - 25.0, abs=1e-4)


def test_who_leaves_the_altitudes_is_lost_and_pays_for_it() -> None:
    batch = open_batch(reward=RewardSettings(loss=7.0))
    batch.reset()
    sinking = _hovering(batch)
    sinking[1, 2] = -1.0
    for _ in range(100):
        result = batch.step(sinking)
        if result.finished:
            break
    (summary,) = result.finished
    assert (summary.end, summary.ended_by) == ("altitude", (2,))
    assert result.terminated.tolist() == [False, True, False, False]
    assert result.terms[1, _LOSS] == -1.0


def test_everybody_pays_for_a_lost_leader_unless_that_does_not_end_the_trial() -> None:
    batch = open_batch()
    batch.reset()
    away = np.full((batch.streams, 3), np.nan, np.float32)
    for _ in range(600):
        to_leader = batch.observation.privileged[:, LEADER_P : LEADER_P + 3]
        away = -_SPEED_MPS * to_leader / np.linalg.norm(to_leader, axis=1, keepdims=True)
        away[:, 2] = 0.0
        result = batch.step(away.astype(np.float32))
        if result.finished:
            break
    assert result.finished[0].end in ("leader_lost", "scattered")
    assert result.terminated.any()
    assert result.terms[result.terminated, _LOSS].tolist() == [-1.0] * int(result.terminated.sum())


def test_a_trial_that_is_cut_off_is_truncated_for_all() -> None:
    batch = open_batch(episode_s=1.0)
    batch.reset()
    result = flown(batch, 20)
    assert result.finished[0].end == "timeout"
    assert result.truncated.all()
    assert not result.terminated.any()
    assert not flown(batch, 1).truncated.any()


def test_where_a_velocity_is_no_number_the_laws_own_is_flown() -> None:
    batch, other = open_batch(), open_batch()
    batch.reset(), other.reset()
    flown(batch, 10, np.full((batch.streams, 3), np.nan, np.float32))
    flown(other, 10)
    np.testing.assert_allclose(batch.observation.ego, other.observation.ego, atol=1e-5)
    assert np.isfinite(batch.step(_hovering(batch)).reward).all()


def test_terms_of_smoothness_and_residual_are_squares_of_differences() -> None:
    batch = open_batch()
    batch.reset()
    flown(batch, 40)
    reference = batch.observation.reference.copy()
    before = 2.0 * batch.observation.ego[:, 7:10]
    result = batch.step(reference + np.float32(0.1))
    np.testing.assert_allclose(result.terms[:, TERMS.index("residual")], -0.03, atol=1e-6)
    # The acceleration allows a change of 0.2 m/s in a step.
    expected = -np.minimum(((reference + 0.1 - before) ** 2).sum(axis=1), 0.04)
    np.testing.assert_allclose(result.terms[:, TERMS.index("smoothness")], expected, atol=1e-4)


def test_a_crash_is_flown_again_from_some_time_before() -> None:
    batch = open_batch(contract=_UNHELD, replay=ReplaySettings(share=0.95, before_s=1.0, uses=50))
    batch.reset()
    begun: list[tuple[EpisodeSummary, int, bool]] = []
    for _ in range(40):
        for _ in range(400):
            result = batch.step(
                _towards_leader(batch, 2) if not begun else batch.observation.reference.copy()
            )
            if result.finished:
                break
        begun.append((result.finished[0], int(_only(batch).places[0, at.STEP]), bool(batch._replayed[0])))
        if begun[-1][2]:
            break
    first, step, replayed = begun[-1]
    assert replayed
    crashed = begun[0][0]
    assert crashed.end in ("leader_follower", "uav_uav")
    assert step % at.SNAPSHOT_STEPS == 0
    assert step <= crashed.steps - 20
    assert first.steps > 0


def test_swarms_are_at_different_points_of_their_trials_after_a_staggered_reset() -> None:
    batch = mixed_batch(1, 1, stagger_s=2.0, swarms=8)
    batch.reset()
    steps = np.concatenate([cohort.places[:, at.STEP] for cohort in batch.cohorts])
    assert len(set(steps.tolist())) >= 4
    assert steps.max() <= 40


def test_velocities_of_another_shape_are_refused() -> None:
    batch = open_batch()
    batch.reset()
    with pytest.raises(ValueError, match="velocity is"):
        batch.step(np.zeros((3, 3), np.float32))


def test_the_papers_contract_has_no_memory_and_the_same_reference() -> None:
    plain = SwarmBatch(MIXED, "paper-1", 1, bank=mixed_bank())
    seen = plain.reset()
    best = mixed_batch(1).reset()
    assert seen.memory.shape == (plain.streams, 0)
    assert seen.ego.shape == (plain.streams, 7)
    np.testing.assert_array_equal(seen.reference, best.reference)
    np.testing.assert_array_equal(seen.grid, best.grid)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("followers", [0]),
        ("followers", [21]),
        ("worlds", {"jungle": 1.0}),
        ("worlds", {"none": 0.0}),
        ("behaviours", {"straight": 0.0}),
    ],
)
def test_impossible_settings_are_refused(key: str, value: object) -> None:
    with pytest.raises(ValueError, match="allowed"):
        EnvironmentSettings.model_validate({key: value})
