"""The loop of a training: fly, learn, write down, and go on where an earlier run stopped."""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from companion.clock import SystemClock
from companion.errors import LogError, ProfileError
from sitl.training import checkpoints
from sitl.training.algorithm import ShardedPpo
from sitl.training.checkpoints import BEST, LAST, SWARMS, Checkpoint, parameters_sha256
from sitl.training.curve import Curve
from sitl.training.episodes import summarise
from sitl.training.networks import Policy, build
from sitl.training.settings import TrainingSettings, configuration_sha256, configuration_text
from sitl.training.vector_environment import Batch, VectorEnvironment

Evaluate = Callable[[Policy], Mapping[str, float]]
"""Judges a policy on fixed scenes; `score` decides which policy is the best, the higher the better."""


@dataclass(frozen=True, slots=True)
class Limits:
    """When one run ends; a training can take many.

    Attributes:
        updates: number of the last update, counted from the beginning of the training.
        wall_s: of this run, None for no limit.
    """

    updates: int
    wall_s: float | None = None


@dataclass(frozen=True, slots=True)
class Trained:
    """What a run leaves.

    Attributes:
        update: how many updates the training has made.
        samples: that it has seen.
        wall_s: that it took, all runs together.
        samples_per_s: of this run, by the clock on the wall.
        samples_per_cpu_s: of this run, by the processor time of all threads.
        parameters_sha256: of actor and critic.
        best_score: of the evaluations, None if there was none.
        files: what was written.
        stopped: whether it was asked to stop before its limits.
    """

    update: int
    samples: int
    wall_s: float
    samples_per_s: float
    samples_per_cpu_s: float
    parameters_sha256: str
    best_score: float | None
    files: list[Path]
    stopped: bool


class Training:
    """One training on one batch of swarms."""

    def __init__(
        self,
        settings: TrainingSettings,
        batch: Batch,
        out: Path,
        *,
        resume: bool = False,
        start: Path | None = None,
        device: str = "cpu",
        threads: int = 1,
        evaluate: Evaluate | None = None,
        clock: SystemClock | None = None,
    ) -> None:
        """Prepare networks and files.

        Args:
            settings: of the training.
            batch: the swarms.
            out: folder of checkpoints and curve, made if it is not there.
            resume: go on from the folder's last checkpoint.
            start: checkpoint whose actor a new training starts from.
            device: where the networks live.
            threads: for the networks.
            evaluate: judges policies, None for no evaluations.
            clock: measures how long things take.

        Raises:
            ProfileError: if the folder holds a training and it is not to be resumed, or another one.
            LogError: if a checkpoint cannot be read.
        """
        self.settings, self.out, self._evaluate = settings, out, evaluate
        self._clock = clock or SystemClock()
        known = _known(out / LAST, settings) if resume else None
        if known is None:
            must_be_free(out)
        self.update = 0 if known is None else known.update
        self.environment = VectorEnvironment(
            batch,
            settings.contract,
            device,
            channels=2 if settings.network.kind == "paper" else 1,
            hold=settings.ppo.hold,
            residual=settings.network.action == "residual",
            update=self.update,
            state=None if known is None else checkpoints.load_swarms(out / SWARMS, known.update),
        )
        observations = self.environment.get_observations()
        actor, critic = build(
            settings.contract, settings.network, int(observations["privileged"].shape[-1]), settings.seed
        )
        if start is not None and known is None:
            _load_actor(actor, start, settings)
        self.algorithm = ShardedPpo(
            actor, critic, observations, settings.ppo, seed=settings.seed, device=device, threads=threads
        )
        self._on_cpu = device == "cpu"
        self.samples, self._wall_before_s = 0, 0.0
        self.best_score: float | None = None
        if known is not None:
            self.algorithm.load(known.algorithm)
            self.samples, self._wall_before_s = known.samples, known.wall_s
            self.best_score = known.best_score
        out.mkdir(parents=True, exist_ok=True)
        (out / "configuration.yaml").write_text(configuration_text(settings), encoding="utf-8")
        self.curve = Curve(out, self.update)

    def run(
        self,
        limits: Limits,
        stop: Callable[[], bool] = lambda: False,
        on_update: Callable[["Training", Mapping[str, float]], None] = lambda training, row: None,
    ) -> Trained:
        """Train until a limit or until asked to stop; a checkpoint is written in either case.

        Args:
            limits: when to end.
            stop: asked after every update.
            on_update: told after every update, with the new row of the curve.
        """
        began_ns, began_cpu_ns = self._clock.now_ns(), self._clock.process_cpu_ns()
        before = self.samples
        saved = self.update
        longest_s, stopped = 0.0, False
        every = self.settings.schedule.evaluate_every
        if self._evaluate is not None and every and self.update == 0:
            # What the training starts from, to compare with.
            self.curve.add({"update": 0, "samples": 0, "wall_s": 0.0, **self._judged()})
        while self.update < limits.updates:
            update_ns = self._clock.now_ns()
            row = self._one_update(began_ns)
            if self._evaluate is not None and every and self.update % every == 0:
                row |= self._judged()
            self.curve.add(row)
            if self.update % self.settings.schedule.save_every == 0:
                self._save(began_ns)
                saved = self.update
            on_update(self, row)
            longest_s = max(longest_s, (self._clock.now_ns() - update_ns) * 1e-9)
            stopped = stop()
            if stopped or (
                limits.wall_s is not None and self._seconds_since(began_ns) + longest_s > limits.wall_s
            ):
                break
        if saved != self.update:
            self._save(began_ns)
        wall_s = max(self._seconds_since(began_ns), 1e-9)
        cpu_s = max((self._clock.process_cpu_ns() - began_cpu_ns) * 1e-9, 1e-9)
        files = [self.out / name for name in (LAST, BEST, "curve.csv", "configuration.yaml")]
        return Trained(
            update=self.update,
            samples=self.samples,
            wall_s=self._wall_before_s + wall_s,
            samples_per_s=(self.samples - before) / wall_s,
            samples_per_cpu_s=(self.samples - before) / cpu_s,
            parameters_sha256=self.parameters_sha256,
            best_score=self.best_score,
            files=[file for file in files if file.exists()],
            stopped=stopped,
        )

    @property
    def parameters_sha256(self) -> str:
        """Hash of actor and critic as they are now."""
        return parameters_sha256(self.algorithm.actor.state_dict(), self.algorithm.critic.state_dict())

    def close(self) -> None:
        """Close files and end threads."""
        self.curve.close()
        self.algorithm.close()

    def checkpoint(self, wall_s: float, evaluation: Mapping[str, float]) -> Checkpoint:
        """Return everything as it is now."""
        return Checkpoint(
            settings=self.settings,
            update=self.update,
            samples=self.samples,
            wall_s=wall_s,
            best_score=self.best_score,
            algorithm=self.algorithm.save(),
            evaluation=dict(evaluation),
        )

    def _one_update(self, began_ns: int) -> dict[str, float]:
        """Fly, learn, and return a row of the curve."""
        algorithm, environment = self.algorithm, self.environment
        start_ns, start_cpu_ns = self._clock.now_ns(), self._clock.process_cpu_ns()
        observations = environment.get_observations()
        flying_ns = 0
        for _ in range(self.settings.ppo.steps):
            actions = algorithm.act(observations)
            step_ns = self._clock.now_ns()
            observations, rewards, dones, extras = environment.step(actions)
            flying_ns += self._clock.now_ns() - step_ns
            algorithm.process_env_step(observations, rewards, dones, extras)
        algorithm.compute_returns(observations)
        rollout_ns = self._clock.now_ns()
        learned = algorithm.update()
        end_ns = self._clock.now_ns()
        self.update += 1
        samples = self.settings.ppo.steps * environment.num_envs
        self.samples += samples
        means, finished = environment.tally()
        cpu_s = (self._clock.process_cpu_ns() - start_cpu_ns) * 1e-9
        return {
            "update": self.update,
            "samples": self.samples,
            "wall_s": self._wall_before_s + self._seconds_since(began_ns),
            "samples_per_s": samples / max((end_ns - start_ns) * 1e-9, 1e-9),
            "samples_per_cpu_s": samples / max(cpu_s, 1e-9),
            "environment_share": flying_ns / max(end_ns - start_ns, 1),
            "rollout_share": (rollout_ns - start_ns) / max(end_ns - start_ns, 1),
            **learned,
            **means,
            **{f"episode_{name}": value for name, value in summarise(finished).items()},
        }

    def _judged(self) -> dict[str, float]:
        """Evaluate the policy as it is, and keep it if it is the best."""
        assert self._evaluate is not None
        with torch.no_grad():
            # Evaluations fly on the processor.
            actor = self.algorithm.actor
            judged = dict(self._evaluate(Policy(actor if self._on_cpu else copy.deepcopy(actor).cpu())))
        if "score" in judged and (self.best_score is None or judged["score"] > self.best_score):
            self.best_score = judged["score"]
            policy = self.checkpoint(self._wall_before_s, judged).policy_only()
            checkpoints.save(self.out / BEST, policy)
        return {f"evaluation_{name}": value for name, value in judged.items()}

    def _save(self, began_ns: int) -> None:
        wall_s = self._wall_before_s + self._seconds_since(began_ns)
        checkpoints.save_swarms(self.out / SWARMS, self.update, self.environment.batch.state())
        checkpoints.save(self.out / LAST, self.checkpoint(wall_s, {}))

    def _seconds_since(self, began_ns: int) -> float:
        return (self._clock.now_ns() - began_ns) * 1e-9


def must_be_free(folder: Path) -> None:
    """Make sure that a new training would not overwrite another.

    Raises:
        ProfileError: if the folder holds one.
    """
    if (folder / LAST).exists():
        raise ProfileError(f"{folder}: holds a training already; go on with --resume, or name another folder")


def load_policy(path: Path) -> tuple[Policy, Checkpoint]:
    """Return the policy of a checkpoint, and the checkpoint.

    Raises:
        LogError: if the file is no checkpoint.
        FileNotFoundError: if there is none.
    """
    checkpoint = checkpoints.load(path)
    settings = checkpoint.settings
    actor, _ = build(settings.contract, settings.network, 1, settings.seed)
    actor.load_state_dict(checkpoint.algorithm["actor_state_dict"])
    return Policy(actor).eval(), checkpoint


def _known(path: Path, settings: TrainingSettings) -> Checkpoint:
    """Return the checkpoint to go on from."""
    if not path.exists():
        raise ProfileError(f"{path}: there is nothing to resume; start without --resume")
    known = checkpoints.load(path)
    if not known.resumable:
        raise LogError(f"{path}: holds a policy alone, from which nothing can go on")
    ours, theirs = configuration_sha256(settings), configuration_sha256(known.settings)
    if ours != theirs:
        raise ProfileError(
            f"{path}: was made with another configuration ({theirs[:12]}, now {ours[:12]}); "
            "compare the configuration.yaml beside it"
        )
    return known


def _load_actor(actor: Any, path: Path, settings: TrainingSettings) -> None:
    """Take over the actor of another training, with the same contract and network; sigmas are set anew."""
    known = checkpoints.load(path)
    for name in ("contract", "network"):
        ours, theirs = getattr(settings, name), getattr(known.settings, name)
        shapes = (ours, theirs) if name == "contract" else tuple(map(_shape_of, (ours, theirs)))
        if shapes[0] != shapes[1]:
            raise ProfileError(f"{path}: its {name} is {theirs}, this training's is {ours}")
    state = dict(known.algorithm["actor_state_dict"])
    state["distribution.log_std_param"] = actor.distribution.log_std_param.detach()
    actor.load_state_dict(state)


def _shape_of(network: Any) -> dict[str, Any]:
    plain: dict[str, Any] = network.model_dump()
    return {key: value for key, value in plain.items() if "sigma" not in key and "critic" not in key}
