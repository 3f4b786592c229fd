"""The swarms as `rsl_rl` knows environments: every follower is one of them."""

from typing import Any, Protocol

import numpy as np
import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from companion.control.observation import CONTRACTS
from sitl.training.environment_results import EpisodeSummary, Observation, State, StepResult
from sitl.training.networks import ACTIONS
from sitl.training.reward_settings import TERMS


class Batch(Protocol):
    """A batch of swarms: `sitl.training.environment.SwarmBatch`, its twin on a GPU, or a test's."""

    @property
    def streams(self) -> int:
        """How many followers there are in all swarms together."""
        ...

    def reset(self, update: int = 0) -> Observation:
        """Begin every trial anew, in another way each round."""
        ...

    def step(self, velocity: Any, *, is_shown: bool = True) -> StepResult:
        """Fly one step with velocities (streams, 3) float32, heading frame, m/s.

        If it is not to be shown, only `reference` of the observation need be of the new state.
        """
        ...

    def state(self) -> State:
        """Return everything that `restore` needs."""
        ...

    def restore(self, state: State) -> Observation:
        """Go on from such a state."""
        ...


class VectorEnvironment(VecEnv):  # type: ignore[misc]  # rsl_rl carries no types
    """Hands observations to the algorithm as copies, and adds up what a rollout's log says."""

    def __init__(
        self,
        batch: Batch,
        contract: str,
        device: str = "cpu",
        *,
        channels: int = 2,
        hold: int = 1,
        residual: bool = False,
        update: int = 0,
        state: State | None = None,
    ) -> None:
        """Wrap a batch of swarms.

        Args:
            batch: the swarms.
            contract: that its observations follow.
            device: where the algorithm wants observations.
            channels: of the grid that the network looks at, which are kept.
            hold: how many steps of the swarms an action lasts.
            residual: what lasts is its difference to the law's command, which changes with every step.
            update: after which it goes on; trials begin in another way each time.
            state: of the batch, to go on from exactly.
        """
        self.batch = batch
        self.num_envs = batch.streams
        self.num_actions = ACTIONS
        self.max_episode_length = 1_000_000
        self.episode_length_buf = torch.zeros(batch.streams, dtype=torch.long)
        self.device = device
        self.cfg: dict[str, Any] = {}
        self._groups = [*CONTRACTS[contract].inputs, "privileged"]
        self._terms = np.zeros(len(TERMS))
        self._channels = channels
        self._hold = hold
        self._residual = residual
        self._reference = torch.zeros((batch.streams, ACTIONS), device=device)
        self._reward = 0.0
        self._steps = 0
        self._finished: list[EpisodeSummary] = []
        self._now = self._copied(batch.reset(update) if state is None else batch.restore(state))

    def get_observations(self) -> TensorDict:
        """Return what every stream sees now."""
        return self._now

    def step(
        self, actions: torch.Tensor
    ) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
        """Fly on with velocities (streams, 3) in the heading frame, m/s, for as long as an action lasts.

        A stream whose trial ends in between gets no reward for the next one, which the law begins.
        """
        velocity = actions.to(torch.float32)
        reward = torch.zeros(self.num_envs, device=self.device)
        died = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        cut = torch.zeros_like(died)
        change = velocity - self._reference if self._residual else None
        for step in range(self._hold):
            if change is not None and step > 0:
                velocity = self._reference + change
            stepped = self.batch.step(
                velocity.numpy() if self.device == "cpu" else velocity, is_shown=step == self._hold - 1
            )
            self._reference = torch.as_tensor(stepped.observation.reference, device=self.device).clone()
            over = died | cut
            reward += torch.where(over, 0.0, torch.as_tensor(stepped.reward, device=self.device))
            died |= torch.as_tensor(stepped.terminated, device=self.device).bool() & ~over
            cut |= torch.as_tensor(stepped.truncated, device=self.device).bool() & ~over
            if change is not None:
                change = torch.where((died | cut)[:, None], 0.0, change)
            self._terms += torch.as_tensor(stepped.terms).double().mean(0).cpu().numpy()
            self._reward += float(torch.as_tensor(stepped.reward).mean())
            self._steps += 1
            self._finished.extend(stepped.finished)
        self._now = self._copied(stepped.observation)
        return self._now, reward, died | cut, {"time_outs": cut & ~died}

    def tally(self) -> tuple[dict[str, float], list[EpisodeSummary]]:
        """Return mean reward and unweighted terms since the last call, and the trials that ended."""
        steps = max(self._steps, 1)
        means = {"reward": self._reward / steps}
        means |= {f"term_{name}": float(sum_) / steps for name, sum_ in zip(TERMS, self._terms, strict=True)}
        finished = self._finished
        self._terms, self._reward, self._steps, self._finished = np.zeros_like(self._terms), 0.0, 0, []
        return means, finished

    def _copied(self, seen: Observation) -> TensorDict:
        """Return copies, because the batch writes the next step over its arrays."""
        self._reference = torch.as_tensor(seen.reference, device=self.device).clone()
        copies = {
            name: torch.as_tensor(getattr(seen, name), device=self.device).clone()
            for name in self._groups
            if name != "grid"
        }
        copies["grid"] = torch.as_tensor(seen.grid, device=self.device)[:, : self._channels].clone()
        return TensorDict(copies, batch_size=[self.num_envs])
