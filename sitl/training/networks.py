"""Actor and critic as `rsl_rl` knows them, and the policy that is exported and flown.

The actor says a velocity in the heading frame, m/s, before limits: what its network says itself (`direct`),
or flock's command, which the observation holds, plus what its network says (`residual`). A residual actor's
last layer starts as zeros, so that before any training it is flock.
"""

from collections.abc import Iterator
from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from tensordict import TensorDict
from torch import nn

from companion.control.observation import CONTRACTS, Contract
from sitl.training.encoders import AzimuthEncoder, NeighbourEncoder, PaperEncoder, columns_of
from sitl.training.settings import NetworkSettings

ACTIONS = 3
_REFERENCE = slice(10, 13)
"""Where `best-2` holds flock's command among the numbers of one's own..."""
_REFERENCE_UNIT_MPS = 2.0
"""... and in which unit."""
_PRESENT = 6
"""Column of a neighbour's row that says whether there is one, in every contract."""
_VALUE_RATE = 0.05
"""How fast the scale of values follows what is seen, per update."""


class ActorEncoder(nn.Module):
    """Features of what a follower sees, for either kind of network."""

    def __init__(self, contract: Contract, settings: NetworkSettings) -> None:
        """Make the encoder that the settings ask for."""
        super().__init__()
        ego, rows = contract.ego[0], contract.neighbours
        self.paper: PaperEncoder | None = None
        if settings.kind == "paper":
            self.paper = PaperEncoder(ego, rows[0] * rows[1])
            self.features = self.paper.features
            return
        channels = contract.grid[2] + (1 if contract.memory[0] else 0)
        self.azimuths = AzimuthEncoder(channels, tuple(settings.azimuth_channels), nn.ELU())
        self.neighbours = NeighbourEncoder(rows[1], settings.neighbour_width, _PRESENT, nn.ELU())
        self.features = self.azimuths.features + self.neighbours.features + ego

    def forward(
        self, ego: torch.Tensor, neighbours: torch.Tensor, grid: torch.Tensor, memory: torch.Tensor | None
    ) -> torch.Tensor:
        """Return (batch, features)."""
        if self.paper is not None:
            encoded: torch.Tensor = self.paper(ego, neighbours, grid)
            return encoded
        around = self.azimuths(columns_of(grid, memory))
        return torch.cat([around, self.neighbours(neighbours), ego], -1)


class CriticEncoder(nn.Module):
    """Features for the critic: the truth, and of what is seen the nearest surface in every direction.

    The truth holds the leader and the nearest others already, so neither needs an encoder: this critic costs
    a tenth of the actor.
    """

    def __init__(self, contract: Contract, privileged: int) -> None:
        """Make the encoder; `privileged` is how many numbers of truth there are."""
        super().__init__()
        self.truth = EmpiricalNormalization(privileged)
        self.features = contract.grid[1] + contract.memory[0] + contract.ego[0] + privileged

    def forward(
        self, ego: torch.Tensor, grid: torch.Tensor, memory: torch.Tensor | None, privileged: torch.Tensor
    ) -> torch.Tensor:
        """Return (batch, features)."""
        nearest = grid[:, 0].amax(-1)
        truth = self.truth(privileged).clamp(-10.0, 10.0)
        seen = (nearest, ego, truth) if memory is None else (nearest, memory, ego, truth)
        return torch.cat(seen, -1)


class FollowerActor(MLPModel):  # type: ignore[misc]  # rsl_rl carries no types
    """The stochastic policy."""

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        contract: str,
        settings: NetworkSettings,
    ) -> None:
        """Make the actor for a contract; the other arguments are what `rsl_rl` gives every model."""
        self._features = 0
        encoder = ActorEncoder(CONTRACTS[contract], settings)
        self._features = encoder.features
        hidden = [256] if settings.kind == "paper" else list(settings.hidden)
        bounds = (settings.sigma_low_mps, settings.sigma_high_mps)
        distribution = {"class_name": "GaussianDistribution", "std_type": "log", "std_range": bounds}
        super().__init__(obs, obs_groups, obs_set, output_dim, hidden, "elu", False, distribution)
        self.encoder = encoder
        self.has_memory = CONTRACTS[contract].memory[0] > 0
        self.residual = settings.action == "residual"
        last = self.mlp[-1]
        with torch.no_grad():
            last.weight.mul_(0.0 if self.residual else 0.01)
            last.bias.zero_()
            h, v = settings.sigma_horizontal_mps, settings.sigma_vertical_mps
            self.distribution.log_std_param.copy_(torch.log(torch.tensor([h, h, v])))

    def _get_obs_dim(
        self, obs: TensorDict, obs_groups: dict[str, list[str]], obs_set: str
    ) -> tuple[list[str], int]:
        return obs_groups[obs_set], 0

    def _get_latent_dim(self) -> int:
        return self._features

    def get_latent(
        self, obs: Any, masks: torch.Tensor | None = None, hidden_state: Any = None
    ) -> torch.Tensor:
        """Return the features of observations."""
        memory = obs["memory"] if self.has_memory else None
        features: torch.Tensor = self.encoder(obs["ego"], obs["neighbours"], obs["grid"], memory)
        return features

    def mean_of(self, latent: torch.Tensor, ego: torch.Tensor) -> torch.Tensor:
        """Return the mean velocity (batch, 3) for features; the last layer always counts in float32."""
        said = _head(self.mlp, latent)
        return said + _REFERENCE_UNIT_MPS * ego[:, _REFERENCE] if self.residual else said

    def log_sigma(self) -> torch.Tensor:
        """Return the logarithm of the standard deviations (3,) m/s, within their bounds."""
        low, high = self.distribution.log_std_range
        log_sigma: torch.Tensor = self.distribution.log_std_param.clamp(low, high)
        return log_sigma

    def forward(
        self,
        obs: Any,
        masks: torch.Tensor | None = None,
        hidden_state: Any = None,
        stochastic_output: bool = False,
    ) -> torch.Tensor:
        """Return the mean velocity, or a sample around it."""
        mean = self.mean_of(self.get_latent(obs), obs["ego"])
        if not stochastic_output:
            return mean
        self.distribution.update(mean)
        sample: torch.Tensor = self.distribution.sample()
        return sample


class FollowerCritic(MLPModel):  # type: ignore[misc]
    """The value of a state: on truth and observation, or on the actor's own features (`paper`).

    The network speaks in units of the values seen so far, whose scale it keeps; when the scale moves, the
    last layer moves against it so that no value changes.

    Source: van Hasselt et al., Learning values across many orders of magnitude (Pop-Art), 2016.
    """

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        contract: str,
        settings: NetworkSettings,
        shared: FollowerActor | None = None,
    ) -> None:
        """Make the critic; with `shared` it looks through that actor's encoder and has none itself."""
        privileged = int(obs["privileged"].shape[-1])
        encoder = None if shared is not None else CriticEncoder(CONTRACTS[contract], privileged)
        self._features = shared._features if shared is not None else encoder.features if encoder else 0
        hidden = [256] if settings.kind == "paper" else list(settings.critic_hidden)
        super().__init__(obs, obs_groups, obs_set, output_dim, hidden, "elu")
        self.encoder = encoder
        # In a list, so that parameters and state stay the actor's alone.
        self._shared = [shared]
        self.has_memory = CONTRACTS[contract].memory[0] > 0
        self.register_buffer("value_mean", torch.zeros(()))
        self.register_buffer("value_scale", torch.ones(()))
        self.register_buffer("value_square", torch.ones(()))
        self.register_buffer("value_updates", torch.zeros((), dtype=torch.long))

    def _get_obs_dim(
        self, obs: TensorDict, obs_groups: dict[str, list[str]], obs_set: str
    ) -> tuple[list[str], int]:
        return obs_groups[obs_set], 0

    def _get_latent_dim(self) -> int:
        return self._features

    @property
    def shares(self) -> bool:
        """Whether the actor's features are the critic's too."""
        return self._shared[0] is not None

    def get_latent(
        self, obs: Any, masks: torch.Tensor | None = None, hidden_state: Any = None
    ) -> torch.Tensor:
        """Return the features of observations and truth."""
        actor = self._shared[0]
        if actor is not None:
            shared: torch.Tensor = actor.get_latent(obs)
            return shared
        assert self.encoder is not None
        memory = obs["memory"] if self.has_memory else None
        features: torch.Tensor = self.encoder(obs["ego"], obs["grid"], memory, obs["privileged"])
        return features

    def scaled(self, latent: torch.Tensor) -> torch.Tensor:
        """Return values (batch, 1) in the units of `value_scale`."""
        return _head(self.mlp, latent)

    def forward(
        self,
        obs: Any,
        masks: torch.Tensor | None = None,
        hidden_state: Any = None,
        stochastic_output: bool = False,
    ) -> torch.Tensor:
        """Return values (batch, 1) in units of the reward."""
        return self.valued(self.get_latent(obs))

    def valued(self, latent: torch.Tensor) -> torch.Tensor:
        """Return values (batch, 1) in units of the reward for features."""
        values: torch.Tensor = self.scaled(latent) * self.value_scale + self.value_mean
        return values

    def follow_scale(self, returns: torch.Tensor) -> None:
        """Let mean and scale follow what was seen, without changing any value that the network says."""
        with torch.no_grad():
            self.value_updates += 1
            mean, scale = self.value_mean.clone(), self.value_scale.clone()
            rate = max(_VALUE_RATE, 1.0 / float(self.value_updates))
            first = int(self.value_updates) == 1
            self.value_mean.lerp_(returns.mean(), rate)
            self.value_square.lerp_(returns.square().mean(), rate)
            variance = self.value_square - self.value_mean.square()
            self.value_scale.copy_(variance.clamp(min=1e-4).sqrt())
            if first:
                # What an untrained network says is not worth keeping.
                return
            last = self.mlp[-1]
            last.weight.mul_(scale / self.value_scale)
            last.bias.copy_((last.bias * scale + mean - self.value_mean) / self.value_scale)

    def update_normalization(self, obs: TensorDict) -> None:
        """Let the scales of the truth follow what was seen."""
        if self.encoder is not None:
            self.encoder.truth.update(obs["privileged"])


class Policy(nn.Module):
    """The policy alone, as it is exported and flown: named observations in, mean velocity out."""

    def __init__(self, actor: FollowerActor) -> None:
        """Take an actor's parts; they are shared, not copied."""
        super().__init__()
        self.actor = actor

    def forward(
        self,
        ego: torch.Tensor,
        neighbours: torch.Tensor,
        grid: torch.Tensor,
        memory: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Return (batch, 3) m/s in the heading frame, before limits."""
        latent = self.actor.encoder(ego, neighbours, grid, memory)
        return self.actor.mean_of(latent, ego)


def build(
    contract: str, settings: NetworkSettings, privileged: int, seed: int
) -> tuple[FollowerActor, FollowerCritic]:
    """Return a new actor and critic.

    Args:
        contract: name of the observations' contract.
        settings: of the networks.
        privileged: how many numbers of truth the critic is given.
        seed: of the first weights; the process's own random numbers are left alone.
    """
    groups = {
        "actor": list(CONTRACTS[contract].inputs),
        "critic": [*CONTRACTS[contract].inputs, "privileged"],
    }
    obs = TensorDict({"privileged": torch.zeros(1, privileged)}, batch_size=[1])
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        actor = FollowerActor(obs, groups, "actor", ACTIONS, contract, settings)
        shared = actor if settings.kind == "paper" else None
        critic = FollowerCritic(obs, groups, "critic", 1, contract, settings, shared)
    return actor, critic


def _head(layers: Iterator[nn.Module] | nn.Sequential, latent: torch.Tensor) -> torch.Tensor:
    *first, last = layers
    for layer in first:
        latent = layer(latent)
    with torch.autocast(latent.device.type, enabled=False):
        said: torch.Tensor = last(latent.float())
    return said
