from dataclasses import asdict, replace

import numpy as np
import pytest

from companion.control.followers.settings import FollowerSettings
from companion.control.observation import CONTRACTS, Contract, Observation
from companion.messages import Float32Array
from sitl.abstract.flight import fly_abstract
from sitl.abstract.policy_flight import POLICY, PolicyStep
from sitl.abstract.settings import AbstractSettings
from sitl.abstract.trial import AbstractTrial
from sitl.swarm.record import TrialRecord
from sitl.swarm.scene import SwarmScene, set_scene
from sitl.swarm.settings import SwarmSettings

SHORT = SwarmSettings(goal_distance_m=8.0)
FOLLOWER, PAPER = FollowerSettings(), AbstractSettings.of("paper")


class Scripted:
    """Says what a function of the observation says."""

    def __init__(self, offset: float = 0.0, contract: str = "best-2") -> None:
        self.contract: Contract = CONTRACTS[contract]
        self._offset = np.float32(offset)

    def velocities(self, observation: Observation) -> Float32Array:
        """Return what the law wants, plus a constant."""
        return np.asarray(2.0 * observation.ego[:, 10:13] + self._offset, np.float32)


def _record(scene: SwarmScene, policy: Scripted | None = None) -> TrialRecord:
    return fly_abstract(scene, "flock" if policy is None else POLICY, FOLLOWER, PAPER, policy=policy).record


@pytest.fixture(scope="module")
def scene() -> SwarmScene:
    return set_scene(SHORT, "pillars_5m", 4)


def test_a_policy_without_a_sound_velocity_is_the_law_to_the_last_bit(scene: SwarmScene) -> None:
    broken = _record(scene, Scripted(np.nan))
    assert broken.method == POLICY
    assert asdict(replace(broken, method="flock")) == asdict(_record(scene))


def test_a_policy_that_repeats_the_law_flies_like_it(scene: SwarmScene) -> None:
    law, policy = _record(scene), _record(scene, Scripted())
    assert policy.end == law.end
    assert policy.flock_radius_m == pytest.approx(law.flock_radius_m, abs=0.02)
    assert policy.flock_radius_m != law.flock_radius_m, "single precision is seen"


def test_what_a_policy_says_is_flown_within_the_limits_of_commands(scene: SwarmScene) -> None:
    flight = AbstractTrial(scene, "flock", FOLLOWER, PAPER)
    step = PolicyStep(CONTRACTS["best-2"], [flight])
    last = np.zeros(4)
    for _ in range(20):
        step.begin()
        before = flight.flown.copy()
        step.finish(np.full((4, 3), 9.0, np.float32))
        speeds = np.linalg.norm(flight.wanted[1:], axis=1)
        assert np.all(speeds <= FOLLOWER.command.max_speed_mps + 1e-9)
        assert np.all(np.abs(flight.wanted[1:, 2]) <= FOLLOWER.command.max_vertical_speed_mps + 1e-9)
        # The law goes on from what was flown, not from what it had wanted.
        np.testing.assert_allclose(np.linalg.norm(before[1:], axis=1), last, atol=1e-12)
        last = speeds
    assert last.min() > 1.5
    assert step.fallen == 0


def test_trials_side_by_side_are_the_trials_one_by_one(scene: SwarmScene) -> None:
    scenes = [scene, set_scene(SwarmSettings(goal_distance_m=4.0, followers=2), "none", 5)]
    policy = Scripted(0.1)
    trials = [AbstractTrial(each, "flock", FOLLOWER, PAPER) for each in scenes]
    step = PolicyStep(policy.contract, trials)
    assert step.observation.ego.shape[0] == 6
    while not all(trial.is_over for trial in trials):
        step.begin()
        step.finish(policy.velocities(step.observation))
    for each, trial in zip(scenes, trials, strict=True):
        assert repr(trial.result(POLICY).record) == repr(_record(each, policy))


def test_the_paper_s_observation_is_flown_as_well(scene: SwarmScene) -> None:
    class Still:
        contract = CONTRACTS["paper-1"]

        def velocities(self, observation: Observation) -> Float32Array:
            """Hover, after a look at what is shown."""
            assert np.all(observation.neighbours[:, 0, 6] == 1.0)
            np.testing.assert_allclose(np.linalg.norm(observation.ego[:, 3:7], axis=1), 1.0, atol=1e-5)
            return np.zeros((len(observation.ego), 3), np.float32)

    flight = AbstractTrial(scene, "flock", FOLLOWER, PAPER)
    step = PolicyStep(Still.contract, [flight])
    start = flight.motion[3][1:, :3].copy()
    for _ in range(10):
        step.begin()
        step.finish(Still().velocities(step.observation))
    np.testing.assert_allclose(flight.motion[3][1:, :3], start, atol=0.05)


def test_the_method_policy_needs_one(scene: SwarmScene) -> None:
    with pytest.raises(ValueError, match="needs a policy"):
        fly_abstract(scene, POLICY, FOLLOWER, PAPER)
