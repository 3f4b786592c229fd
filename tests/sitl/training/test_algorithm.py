from pathlib import Path

import numpy as np
import pytest
import torch

from sitl.training.algorithm import ShardedPpo
from sitl.training.gaussian import entropy_of, kl_of, log_density_of
from sitl.training.networks import build
from sitl.training.runner import Limits, Trained, Training
from sitl.training.settings import NetworkSettings, PpoSettings, TrainingSettings
from sitl.training.torch_threads import calm_threads
from sitl.training.vector_environment import VectorEnvironment
from tests.sitl.training.point_mass import PointMass

calm_threads()

SMALL = NetworkSettings(
    action="direct",
    azimuth_channels=[2],
    neighbour_width=8,
    hidden=[32],
    critic_hidden=[32],
    sigma_horizontal_mps=0.4,
    sigma_vertical_mps=0.4,
)


def ppo(**changes: object) -> PpoSettings:
    plain = {
        "steps": 16,
        "epochs": 3,
        "minibatches": 4,
        "clip": 0.2,
        "gamma": 0.95,
        "actor_rate": 1e-3,
        "rate_high": 5e-3,
        "critic_rate": 3e-3,
        "desired_kl": 0.02,
        "critic_warm_up": 2,
        "precision": "float32",
    }
    return PpoSettings.model_validate(plain | changes)


def rolled(algorithm: ShardedPpo, environment: VectorEnvironment) -> None:
    seen = environment.get_observations()
    for _ in range(algorithm.settings.steps):
        seen, reward, done, extras = environment.step(algorithm.act(seen))
        algorithm.process_env_step(seen, reward, done, extras)
    algorithm.compute_returns(seen)


def prepared(settings: PpoSettings, streams: int = 32) -> tuple[ShardedPpo, VectorEnvironment]:
    environment = VectorEnvironment(PointMass(streams, 1), "best-2", channels=1)
    seen = environment.get_observations()
    actor, critic = build("best-2", SMALL, int(seen["privileged"].shape[-1]), 1)
    return ShardedPpo(actor, critic, seen, settings, seed=1), environment


def test_advantages_are_those_of_a_plain_loop() -> None:
    algorithm, environment = prepared(ppo())
    seen = environment.get_observations()
    steps, rewards, dones, values = algorithm.settings.steps, [], [], []
    for _ in range(steps):
        seen_before = seen
        seen, reward, done, extras = environment.step(algorithm.act(seen_before))
        value = algorithm.transition.values[:, 0]
        # An episode that was cut off goes on, in the mind of the critic.
        rewards.append((reward + 0.95 * value * extras["time_outs"]).numpy())
        dones.append(done.numpy())
        values.append(value.numpy())
        algorithm.process_env_step(seen, reward, done, extras)
    algorithm.compute_returns(seen)
    values.append(algorithm.critic(seen).detach().numpy()[:, 0])
    advantage = np.zeros(32)
    expected = np.zeros((steps, 32))
    for t in reversed(range(steps)):
        goes_on = 1.0 - dones[t]
        delta = rewards[t] + 0.95 * goes_on * values[t + 1] - values[t]
        advantage = delta + 0.95 * 0.95 * goes_on * advantage
        expected[t] = advantage
    assert any(done.any() for done in dones)
    np.testing.assert_allclose(
        algorithm.storage.returns[..., 0], expected + np.array(values[:-1]), rtol=1e-4, atol=1e-4
    )
    normalised = (expected - expected.mean()) / expected.std(ddof=1)
    np.testing.assert_allclose(algorithm.storage.advantages[..., 0], normalised, rtol=1e-3, atol=1e-4)


def test_before_the_first_step_ratios_are_one_and_nothing_diverges() -> None:
    algorithm, environment = prepared(ppo(epochs=1, minibatches=1, critic_warm_up=0))
    rolled(algorithm, environment)
    learned = algorithm.update()
    assert learned["kl"] == pytest.approx(0.0, abs=1e-6)
    assert learned["clipped"] == 0.0
    assert learned["policy"] == pytest.approx(0.0, abs=1e-5)  # the mean of normalised advantages


def test_the_actor_rests_while_the_critic_warms_up() -> None:
    algorithm, environment = prepared(ppo(critic_warm_up=1))
    actor = [p.detach().clone() for p in algorithm.actor.parameters()]
    critic = [p.detach().clone() for p in algorithm.critic.parameters()]
    rolled(algorithm, environment)
    algorithm.update()
    assert all(torch.equal(a, b) for a, b in zip(actor, algorithm.actor.parameters(), strict=True))
    assert not all(torch.equal(a, b) for a, b in zip(critic, algorithm.critic.parameters(), strict=True))
    rolled(algorithm, environment)
    algorithm.update()
    assert not all(torch.equal(a, b) for a, b in zip(actor, algorithm.actor.parameters(), strict=True))


def test_shards_add_up_to_the_whole() -> None:
    algorithm, environment = prepared(ppo(shards=3, critic_warm_up=0))
    rolled(algorithm, environment)
    rows = torch.arange(200)
    whole = algorithm._loss(rows, 200, True)
    parts = [algorithm._loss(rows[part], 200, True) for part in (slice(0, 70), slice(70, 200))]
    assert whole.value == pytest.approx(sum(part.value for part in parts), rel=1e-4)
    for index, gradient in enumerate(whole.gradients):
        pieces = [part.gradients[index] for part in parts]
        if gradient is None:
            assert pieces == [None, None]
            continue
        assert pieces[0] is not None
        assert pieces[1] is not None
        torch.testing.assert_close(pieces[0] + pieces[1], gradient, rtol=1e-3, atol=1e-5)


def test_the_rate_follows_the_divergence_within_bounds() -> None:
    algorithm, _ = prepared(ppo(rate_low=9e-4, rate_high=1.05e-3))
    algorithm._adapt(1.0)
    assert algorithm.learning_rate == pytest.approx(9e-4)
    for _ in range(5):
        algorithm._adapt(1e-6)
    assert algorithm.learning_rate == pytest.approx(1.05e-3)


def test_density_entropy_and_divergence_are_those_of_the_normal_distribution() -> None:
    mean, log_sigma, actions = torch.rand(9, 3), torch.rand(3) - 1.0, torch.rand(9, 3)
    old_mean, old_log_sigma = torch.rand(9, 3), torch.rand(3) - 1.0
    new = torch.distributions.Normal(mean, log_sigma.exp())
    old = torch.distributions.Normal(old_mean, old_log_sigma.exp())
    density = new.log_prob(actions).sum(-1)  # type: ignore[no-untyped-call]
    torch.testing.assert_close(log_density_of(actions, mean, log_sigma), density)
    entropy = new.entropy().sum(-1)[0]  # type: ignore[no-untyped-call]
    torch.testing.assert_close(entropy_of(log_sigma), entropy)
    expected = torch.distributions.kl_divergence(old, new).sum(-1)
    torch.testing.assert_close(kl_of(old_mean, old_log_sigma, mean, log_sigma), expected)


def trained(folder: Path, updates: int, *, streams: int = 16, threads: int = 1, seed: int = 1) -> Trained:
    settings = TrainingSettings(network=SMALL, ppo=ppo(epochs=1, minibatches=2), seed=seed)
    training = Training(settings, PointMass(streams, seed), folder, threads=threads)
    try:
        return training.run(Limits(updates))
    finally:
        training.close()


def test_the_same_seed_gives_the_same_policy_on_any_number_of_threads(tmp_path: Path) -> None:
    one = trained(tmp_path / "one", 20)
    again = trained(tmp_path / "again", 20, threads=2)
    other = trained(tmp_path / "other", 20, seed=2)
    assert one.parameters_sha256 == again.parameters_sha256
    assert one.parameters_sha256 != other.parameters_sha256


def test_a_point_on_a_plane_learns_to_fly_to_its_goal(tmp_path: Path) -> None:
    settings = TrainingSettings(network=SMALL, ppo=ppo())
    training = Training(settings, PointMass(64, 1), tmp_path)
    rewards = []
    training.run(Limits(25), on_update=lambda _, row: rewards.append(row["reward"]))
    training.close()
    # Standing still costs 0.77 a step; flying straight to the goal at once about 0.1.
    assert rewards[0] < -0.6
    assert np.mean(rewards[-5:]) > -0.2


def test_an_action_that_lasts_is_flown_and_rewarded_in_every_step_of_its_trial() -> None:
    one, three = (PointMass(4, 3) for _ in range(2))
    slow = VectorEnvironment(three, "best-2", channels=1, hold=3)
    quick = VectorEnvironment(one, "best-2", channels=1)
    action = torch.full((4, 3), 0.3)
    total, over = torch.zeros(4), torch.zeros(4, dtype=torch.bool)
    for _ in range(3):
        seen, reward, done, _ = quick.step(action)
        total += torch.where(over, 0.0, reward)
        over |= done
    held, reward, done, _ = slow.step(action)
    torch.testing.assert_close(reward, total)
    assert torch.equal(done, over)
    assert torch.equal(held["ego"], seen["ego"])
