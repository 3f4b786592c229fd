"""PPO of `rsl_rl`, with what fine-tuning a working policy on a small CPU needs.

Rollout storage, bootstrapping at time-outs and the advantage estimate are the library's. Different are:
values keep their own scale (`FollowerCritic`), the critic learns alone at first, actor and critic have rates
of their own, and every minibatch is split into shards whose gradients are computed on threads side by side
and added in order: results depend on the number of shards, never on the number of threads.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import nn

from sitl.training.gaussian import entropy_of, kl_of, log_density_of
from sitl.training.networks import ACTIONS, FollowerActor, FollowerCritic
from sitl.training.settings import PpoSettings

_Answer = TypeVar("_Answer")


@dataclass(frozen=True, slots=True)
class ShardLoss:
    """What one shard of a minibatch says.

    Attributes:
        gradients: one for every parameter that learns, in order; None where it has no part.
        policy: surrogate loss, this shard's part of the minibatch's mean; so are all others.
        value: critic's loss in units of the value's scale.
        kl: divergence of the new policy from the one that flew.
        clipped: fraction of samples whose ratio was clipped.
    """

    gradients: tuple[torch.Tensor | None, ...]
    policy: float
    value: float
    kl: float
    clipped: float


class ShardedPpo(PPO):  # type: ignore[misc]  # rsl_rl carries no types
    """The algorithm: `act`, `process_env_step` for every step, then `compute_returns` and `update`."""

    actor: FollowerActor
    critic: FollowerCritic
    learning_rate: float

    def __init__(
        self,
        actor: FollowerActor,
        critic: FollowerCritic,
        observations: TensorDict,
        settings: PpoSettings,
        *,
        seed: int,
        device: str = "cpu",
        threads: int = 1,
    ) -> None:
        """Prepare the first update.

        Args:
            actor: the policy.
            critic: its judge.
            observations: one step's, for their shapes.
            settings: of the optimisation.
            seed: of exploration and of the order of samples.
            device: where the networks live.
            threads: that shards are spread over; on a GPU one is enough.
        """
        streams = int(observations.batch_size[0])
        storage = RolloutStorage("rl", streams, settings.steps, observations, [ACTIONS], device)
        super().__init__(
            actor,
            critic,
            storage,
            num_learning_epochs=settings.epochs,
            num_mini_batches=settings.minibatches,
            clip_param=settings.clip,
            gamma=settings.gamma**settings.hold,
            lam=settings.lambda_,
            value_loss_coef=settings.value,
            entropy_coef=settings.entropy,
            learning_rate=settings.actor_rate,
            max_grad_norm=settings.gradient_norm,
            use_clipped_value_loss=False,
            schedule=settings.schedule,
            desired_kl=settings.desired_kl,
            device=device,
        )
        self.settings = settings
        self.updates = 0
        self.random = torch.Generator(device=device).manual_seed(seed)
        self.use_mixed_precision = settings.precision == "bfloat16" or (
            settings.precision == "auto" and multiplies_bfloat16(device)
        )
        self.parts: tuple[tuple[nn.Parameter, ...], ...] = (
            tuple(actor.parameters()),
            tuple(critic.parameters()),
        )
        rates = (settings.actor_rate, settings.critic_rate)
        self.optimizer = torch.optim.Adam(
            [{"params": list(part), "lr": rate} for part, rate in zip(self.parts, rates, strict=True)],
            eps=1e-5,
        )
        self._threads = ThreadPoolExecutor(threads) if threads > 1 else None
        self.train_mode()

    def act(self, obs: TensorDict) -> torch.Tensor:
        """Return what every stream does now, (streams, 3) m/s, and note it for the update."""
        streams = int(obs.batch_size[0])

        def look(rows: slice) -> tuple[torch.Tensor, torch.Tensor]:
            with torch.no_grad(), self._cast():
                part = {name: obs[name][rows] for name in obs.keys()}  # noqa: SIM118
                latent = self.actor.get_latent(part)
                mean = self.actor.mean_of(latent, part["ego"])
                seen = latent if self.critic.shares else self.critic.get_latent(part)
                return mean.float(), self.critic.valued(seen).float()

        looked = self._on_threads(look, list(_slices(streams, self.settings.shards)))
        mean = torch.cat([part[0] for part in looked])
        with torch.no_grad():
            log_sigma = self.actor.log_sigma()
            noise = torch.randn(mean.shape, generator=self.random, device=mean.device)
            actions = mean + log_sigma.exp() * noise
            self.transition.actions = actions
            self.transition.values = torch.cat([part[1] for part in looked])
            self.transition.actions_log_prob = log_density_of(actions, mean, log_sigma)
            self.transition.distribution_params = (mean, log_sigma.expand_as(mean))
        self.transition.observations = obs
        return actions

    def compute_returns(self, obs: TensorDict) -> None:
        """Estimate advantages from the rollout, bootstrapping from the observations after it."""
        with torch.no_grad():
            super().compute_returns(obs)

    def update(self) -> dict[str, float]:
        """Learn from the rollout.

        Returns:
            Means over all minibatches of policy, value, kl and clipped, and of the whole rollout the entropy,
            the variance that the values explained, the mean value, sigmas and rate.
        """
        storage, count = self.storage, self.storage.num_envs * self.storage.num_transitions_per_env
        values, returns = storage.values.flatten(), storage.returns.flatten()
        explained = 1.0 - float((returns - values).var() / returns.var().clamp(min=1e-8))
        self.critic.follow_scale(returns)
        learns_actor = self.updates >= self.settings.critic_warm_up
        totals = dict.fromkeys(("policy", "value", "kl", "clipped"), 0.0)
        size = count // self.num_mini_batches
        for _ in range(self.num_learning_epochs):
            order = torch.randperm(count, generator=self.random, device=storage.values.device)
            for start in range(0, size * self.num_mini_batches, size):
                rows = order[start : start + size]
                shards = [rows[part] for part in _slices(size, self.settings.shards)]
                losses = self._on_threads(lambda part: self._loss(part, size, learns_actor), shards)
                for name in totals:
                    totals[name] += sum(getattr(loss, name) for loss in losses)
                self._step([loss.gradients for loss in losses], sum(loss.kl for loss in losses), learns_actor)
        with torch.no_grad():
            self.critic.update_normalization(storage.observations.flatten(0, 1))
        storage.clear()
        self.updates += 1
        steps = self.num_learning_epochs * self.num_mini_batches
        sigma = self.actor.log_sigma().detach().exp()
        return {name: total / steps for name, total in totals.items()} | {
            "entropy": float(entropy_of(self.actor.log_sigma().detach())),
            "explained_variance": explained,
            "value_mean": float(values.mean()),
            "sigma_horizontal": float(sigma[:2].mean()),
            "sigma_vertical": float(sigma[2]),
            "actor_rate": self.learning_rate if learns_actor else 0.0,
        }

    def save(self) -> dict[str, Any]:
        """Return everything that the next update depends on."""
        return {**super().save(), "updates": self.updates, "random": self.random.get_state()}

    def load(self, loaded_dict: dict[str, Any], load_cfg: Any = None, strict: bool = True) -> bool:
        """Go on from what `save` returned."""
        loaded: bool = super().load(loaded_dict, load_cfg, strict)
        self.updates = int(loaded_dict["updates"])
        self.random.set_state(loaded_dict["random"].cpu())
        return loaded

    def close(self) -> None:
        """End the threads."""
        if self._threads is not None:
            self._threads.shutdown()

    def _loss(self, rows: torch.Tensor, size: int, learns_actor: bool) -> ShardLoss:
        """Return losses and gradients of the samples `rows`, as parts of a minibatch of `size`."""
        storage = self.storage
        obs = {name: storage.observations[name].flatten(0, 1)[rows] for name in storage.observations.keys()}  # noqa: SIM118
        advantages = storage.advantages.flatten()[rows]
        returns = storage.returns.flatten()[rows]
        old_mean, old_log_sigma = (part.flatten(0, 1)[rows] for part in storage.distribution_params)
        actions = storage.actions.flatten(0, 1)[rows]
        old_density = storage.actions_log_prob.flatten()[rows]
        learning = [p for part in (self.parts if learns_actor else self.parts[1:]) for p in part]
        policy_loss = kl = clipped = torch.zeros((), device=rows.device)
        with torch.enable_grad(), self._cast():
            latent = self.actor.get_latent(obs) if learns_actor or self.critic.shares else None
            shared = latent if self.critic.shares else None
            values = self.critic.scaled(self.critic.get_latent(obs) if shared is None else shared)
            scaled = (returns - self.critic.value_mean) / self.critic.value_scale
            value_loss = (values[:, 0].float() - scaled).square().sum() / size
            loss = self.value_loss_coef * value_loss
            if learns_actor and latent is not None:
                mean, log_sigma = self.actor.mean_of(latent, obs["ego"]), self.actor.log_sigma()
                ratio = torch.exp(log_density_of(actions, mean, log_sigma) - old_density)
                bounded = ratio.clamp(1.0 - self.clip_param, 1.0 + self.clip_param)
                policy_loss = -torch.min(advantages * ratio, advantages * bounded).sum() / size
                entropy = entropy_of(log_sigma) * (rows.shape[0] / size)
                loss = loss + policy_loss - self.entropy_coef * entropy
                with torch.no_grad():
                    kl = kl_of(old_mean, old_log_sigma, mean, log_sigma).sum() / size
                    clipped = ((ratio - 1.0).abs() > self.clip_param).sum() / size
        gradients = torch.autograd.grad(loss, learning, allow_unused=True)
        told = (float(number.detach()) for number in (policy_loss, value_loss, kl, clipped))
        return ShardLoss(gradients, *told)

    def _step(
        self, gradients: Sequence[tuple[torch.Tensor | None, ...]], kl: float, learns_actor: bool
    ) -> None:
        """Add the shards' gradients in order and take one step."""
        parts = self.parts if learns_actor else self.parts[1:]
        learning = [parameter for part in parts for parameter in part]
        self.optimizer.zero_grad(set_to_none=True)
        for parameter, pieces in zip(learning, zip(*gradients, strict=True), strict=True):
            given = [piece for piece in pieces if piece is not None]
            if given:
                parameter.grad = sum(given[1:], given[0])
        for part in parts:
            nn.utils.clip_grad_norm_(part, self.max_grad_norm)
        if learns_actor and self.schedule == "adaptive":
            self._adapt(kl)
        self.optimizer.param_groups[0]["lr"] = self.learning_rate
        self.optimizer.step()

    def _adapt(self, kl: float) -> None:
        """Let the actor's rate follow the divergence of this minibatch, within bounds."""
        if kl > 2.0 * self.desired_kl:
            self.learning_rate = max(self.settings.rate_low, self.learning_rate / 1.5)
        elif 0.0 < kl < 0.5 * self.desired_kl:
            self.learning_rate = min(self.settings.rate_high, self.learning_rate * 1.1)

    def _cast(self) -> torch.autocast:
        """Return the precision for flying and learning: with the same in both, the first ratios are one."""
        device = torch.device(self.device).type
        return torch.autocast(device, torch.bfloat16, enabled=self.use_mixed_precision)

    def _on_threads(self, work: Callable[[Any], _Answer], parts: Sequence[Any]) -> list[_Answer]:
        if self._threads is None:
            return [work(part) for part in parts]
        return list(self._threads.map(work, parts))


def multiplies_bfloat16(device: str) -> bool:
    """Return whether matrices of bfloat16 are multiplied in hardware there."""
    if device != "cpu":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    # Older releases cannot say, and then nothing is assumed.
    asks = (getattr(torch.cpu, f"_is_{name}_supported", None) for name in ("avx512_bf16", "amx_tile"))
    return any(ask is not None and ask() for ask in asks)


def _slices(count: int, parts: int) -> Iterator[slice]:
    """Split a range into parts that differ by one at most; empty ones are left out."""
    for index in range(parts):
        start, stop = index * count // parts, (index + 1) * count // parts
        if stop > start:
            yield slice(start, stop)
