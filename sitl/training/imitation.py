"""A network learns a law by flying itself and being told at every step what the law would have flown."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.random import Generator, SeedSequence
from torch.nn import functional

from companion.clock import SystemClock
from companion.control.observation import CONTRACTS, Contract
from companion.errors import ProfileError
from companion.messages import Float32Array
from sitl.training import checkpoints
from sitl.training.checkpoints import Checkpoint
from sitl.training.curve import Curve
from sitl.training.environment_results import Observation, StepResult
from sitl.training.networks import Policy, build
from sitl.training.settings import TrainingSettings, configuration_text
from sitl.training.torch_threads import calm_threads

IMITATED = "imitated.pt"
_NOISE_STEPS = 20
_LAST_RATE = 0.05
_GRADIENT_NORM = 1.0
_STREAM = 7


class Swarms(Protocol):
    """As much of a batch of swarms as imitation needs."""

    @property
    def streams(self) -> int:
        """How many followers there are."""
        ...

    def reset(self) -> Observation:
        """Begin every trial anew."""
        ...

    def step(self, velocity: Any) -> StepResult:
        """Fly one step."""
        ...


class Seen:
    """The newest observations and the law's answers, small enough to keep many.

    The grid's second channel is left out: it says where the first is above zero.
    """

    def __init__(self, contract: Contract, capacity: int) -> None:
        """Take the memory."""
        self._contract, self._capacity = contract, capacity
        self._arrays: dict[str, Any] = {
            name: np.zeros((capacity, *shape), np.float32)
            for name, shape in contract.inputs.items()
            if name != "grid"
        }
        self._arrays["grid"] = np.zeros((capacity, *contract.grid[1:]), np.float16)
        self._arrays["answer"] = np.zeros((capacity, 3), np.float32)
        self._next, self._count = 0, 0

    def __len__(self) -> int:
        return self._count

    def add(self, seen: Observation, rows: Any) -> None:
        """Keep the given rows of an observation."""
        for start in range(0, len(rows), self._capacity):
            some = rows[start : start + self._capacity]
            places = (self._next + np.arange(len(some))) % self._capacity
            for name, array in self._arrays.items():
                source = seen.reference if name == "answer" else getattr(seen, name)
                array[places] = source[some, 0] if name == "grid" else source[some]
            self._next = int((self._next + len(some)) % self._capacity)
            self._count = min(self._count + len(some), self._capacity)

    def draw(self, rng: Generator, size: int) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        """Return a random minibatch: inputs by name, and the law's answers."""
        rows = rng.integers(0, self._count, size)
        drawn = {name: array[rows] for name, array in self._arrays.items()}
        near = drawn.pop("grid").astype(np.float32)
        answer = torch.from_numpy(drawn.pop("answer"))
        drawn["grid"] = np.stack([near, (near > 0.0).astype(np.float32)], axis=1)
        return {name: torch.from_numpy(drawn[name]) for name in self._contract.inputs}, answer


@dataclass(frozen=True, slots=True)
class Imitated:
    """What imitation leaves.

    Attributes:
        rounds: made.
        samples: flown.
        error_mps: root mean square difference from the law in the last round, of what was new in it.
        score: of the evaluation at the end, None if there was none.
        files: what was written.
        stopped: whether it was asked to stop before its end.
    """

    rounds: int
    samples: int
    error_mps: float
    score: float | None
    files: list[Path]
    stopped: bool


class Imitation:
    """One network, one batch of swarms, one law to learn."""

    def __init__(
        self,
        settings: TrainingSettings,
        batch: Swarms,
        out: Path,
        *,
        evaluate: Callable[[Policy], Mapping[str, float]] | None = None,
        clock: SystemClock | None = None,
    ) -> None:
        """Prepare network and files.

        Args:
            settings: of the training that the network is for.
            batch: the swarms.
            out: folder of checkpoint and curve, made if it is not there.
            evaluate: judges the network at the end.
            clock: measures how long things take.

        Raises:
            ProfileError: if the folder holds an imitation already, or the network is flock from the start.
        """
        if settings.network.action == "residual" and settings.imitation.sight == "own":
            raise ProfileError(
                "network.action: found residual, allowed direct, or imitation.sight clear: a network that "
                "adds to flock's command flies like flock before it has learned anything"
            )
        if (out / IMITATED).exists():
            raise ProfileError(f"{out}: holds an imitation already; name another folder")
        calm_threads()
        self.settings, self.out, self._batch, self._evaluate = settings, out, batch, evaluate
        self._clock = clock or SystemClock()
        self._plan = settings.imitation
        self.actor, _ = build(settings.contract, settings.network, 1, settings.seed)
        self._module = Policy(self.actor)
        self._rng = np.random.default_rng(SeedSequence(settings.seed, spawn_key=(_STREAM,)))
        self._seen = Seen(CONTRACTS[settings.contract], self._plan.capacity)
        self._optimiser = torch.optim.Adam(self.actor.encoder.parameters(), self._plan.rate)
        self._optimiser.add_param_group({"params": list(self.actor.mlp.parameters())})
        out.mkdir(parents=True, exist_ok=True)
        (out / "configuration.yaml").write_text(configuration_text(settings), encoding="utf-8")
        self._curve = Curve(out)

    def run(
        self,
        stop: Callable[[], bool] = lambda: False,
        on_round: Callable[[int, Mapping[str, float]], None] = lambda number, row: None,
    ) -> Imitated:
        """Fly and learn; the network is written after every round.

        Args:
            stop: asked after every round.
            on_round: told after every round, with its row of the curve.
        """
        began_ns = self._clock.now_ns()
        observation = self._batch.reset()
        samples, error, stopped, number = 0, math.nan, False, 0
        while number < self._plan.rounds and not stopped:
            share = max(0.0, 1.0 - number / self._plan.teacher_rounds) if self._plan.teacher_rounds else 0.0
            observation, error = self._fly(observation, share)
            samples += self._plan.steps * self._batch.streams
            loss = self._learn(number)
            number += 1
            wall_s = (self._clock.now_ns() - began_ns) * 1e-9
            row: dict[str, float] = {
                "update": number,
                "samples": samples,
                "wall_s": wall_s,
                "teacher_share": share,
                "error_mps": error,
                "loss": loss,
            }
            if self._evaluate is not None and number == self._plan.rounds:
                judged = dict(self._evaluate(self._module.eval()))
                row |= {f"evaluation_{name}": value for name, value in judged.items()}
            else:
                judged = {}
            self._curve.add(row)
            checkpoints.save(self.out / IMITATED, self._checkpoint(number, samples, wall_s, judged))
            on_round(number, row)
            stopped = stop() and number < self._plan.rounds
        files = [self.out / name for name in (IMITATED, "curve.csv", "configuration.yaml")]
        return Imitated(number, samples, error, judged.get("score"), files, stopped)

    def close(self) -> None:
        """Close the curve."""
        self._curve.close()

    def _fly(self, observation: Observation, share: float) -> tuple[Observation, float]:
        """Fly a round; return the newest observation and how far the network was from the law."""
        plan, streams = self._plan, self._batch.streams
        taught = (self._rng.random(streams) < share)[:, None]
        noise: Float32Array = np.zeros((streams, 3), np.float32)
        square = 0.0
        for step in range(plan.steps):
            if step % _NOISE_STEPS == 0:
                noise = (plan.noise_mps * self._rng.standard_normal((streams, 3))).astype(np.float32)
                noise[:, 2] *= 0.3
            self._seen.add(observation, np.flatnonzero(self._rng.random(streams) < plan.keep))
            with torch.inference_mode():
                said = self._module(**self._inputs(observation)).numpy()
            square += float(np.square(said - observation.reference).sum(1).mean())
            velocity = np.where(taught, observation.reference, said) + noise
            observation = self._batch.step(velocity.astype(np.float32)).observation
        return observation, math.sqrt(square / plan.steps)

    def _learn(self, number: int) -> float:
        """Make the gradient steps of a round; return their mean loss."""
        plan = self._plan
        total = plan.rounds * plan.gradient_steps
        losses = 0.0
        for index in range(plan.gradient_steps):
            done = (number * plan.gradient_steps + index) / total
            falling = 0.5 * (1.0 + math.cos(math.pi * done))
            for group in self._optimiser.param_groups:
                group["lr"] = plan.rate * (_LAST_RATE + (1.0 - _LAST_RATE) * falling)
            inputs, answer = self._seen.draw(self._rng, plan.minibatch)
            loss = functional.huber_loss(self._module(**inputs), answer, delta=plan.huber_mps)
            self._optimiser.zero_grad(set_to_none=True)
            torch.autograd.backward(loss)
            torch.nn.utils.clip_grad_norm_(self._module.parameters(), _GRADIENT_NORM)
            self._optimiser.step()
            losses += float(loss.detach())
        return losses / plan.gradient_steps

    def _inputs(self, observation: Observation) -> dict[str, torch.Tensor]:
        names = CONTRACTS[self.settings.contract].inputs
        return {name: torch.from_numpy(getattr(observation, name)) for name in names}

    def _checkpoint(
        self, number: int, samples: int, wall_s: float, judged: Mapping[str, float]
    ) -> Checkpoint:
        return Checkpoint(
            settings=self.settings,
            update=number,
            samples=samples,
            wall_s=wall_s,
            best_score=judged.get("score"),
            algorithm={"actor_state_dict": self.actor.state_dict()},
            evaluation=dict(judged),
        )
