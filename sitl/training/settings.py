"""The file of a training: network, optimisation, and how long; read strictly."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import Field, model_validator

from companion.control.observation import CONTRACTS
from companion.settings import Settings
from companion.yaml_problems import misfit
from companion.yaml_source import loads, merged, read_tree, validated
from companion.yaml_tree import parse_tree
from sitl.training.environment_settings import EnvironmentSettings
from sitl.training.imitation_settings import ImitationSettings

Layers = Annotated[list[Annotated[int, Field(ge=1, le=2048)]], Field(min_length=1, max_length=6)]


class NetworkSettings(Settings):
    """Shape of actor and critic, and how the actor's output becomes a velocity."""

    kind: Literal["best", "paper"] = "best"
    """`paper` is the published one: a CNN over the grid, a trunk shared by two heads."""
    action: Literal["residual", "direct"] = "residual"
    """`residual`: what the network says is added to the command of flock, so that it starts as flock."""
    azimuth_channels: Layers = Field(default=[32, 32, 32])
    """Of the convolutions over the circle of azimuths, each of stride 2. Kind best only."""
    neighbour_width: int = Field(default=64, ge=8, le=512)
    """Of the two layers that every neighbour goes through. Kind best only."""
    hidden: Layers = Field(default=[256, 128])
    """Of the actor's last layers. Kind best only."""
    critic_hidden: Layers = Field(default=[256, 128])
    """Of the critic's last layers. Kind best only."""
    sigma_horizontal_mps: float = Field(default=0.15, gt=0.0, le=2.0)
    """Exploration at the start, on x and y."""
    sigma_vertical_mps: float = Field(default=0.05, gt=0.0, le=2.0)
    """Exploration at the start, on z."""
    sigma_low_mps: float = Field(default=0.02, gt=0.0, le=2.0)
    """Exploration never falls below."""
    sigma_high_mps: float = Field(default=0.6, gt=0.0, le=2.0)
    """Exploration never rises above."""

    @model_validator(mode="after")
    def _sigmas_are_ordered(self) -> "NetworkSettings":
        low, high = self.sigma_low_mps, self.sigma_high_mps
        for key in ("sigma_horizontal_mps", "sigma_vertical_mps"):
            if not low <= getattr(self, key) <= high:
                raise misfit((key,), str(getattr(self, key)), f"from {low} to {high}")
        return self


class PpoSettings(Settings):
    """Proximal policy optimisation."""

    steps: int = Field(default=32, ge=2, le=1024)
    """Actions of every stream between two updates."""
    hold: int = Field(default=1, ge=1, le=20)
    """Steps of 0.05 s for which an action lasts while it is learned what it is worth: the lag of a vehicle
    swallows what is tried out for a single step. In flight every step has its own."""
    epochs: int = Field(default=2, ge=1, le=20)
    """How often each sample is learned from."""
    minibatches: int = Field(default=8, ge=1, le=1024)
    """Gradient steps in an epoch."""
    clip: float = Field(default=0.15, gt=0.0, le=1.0)
    """Of the probability ratio."""
    gamma: float = Field(default=0.99, gt=0.0, lt=1.0)
    """Discount a step of 0.05 s."""
    lambda_: float = Field(default=0.95, ge=0.0, le=1.0, alias="lambda")
    """Of the generalised advantage estimate."""
    entropy: float = Field(default=0.0005, ge=0.0, le=1.0)
    """Weight of the entropy."""
    value: float = Field(default=1.0, gt=0.0, le=10.0)
    """Weight of the critic's loss."""
    actor_rate: float = Field(default=3e-4, gt=0.0, le=0.1)
    """Learning rate of the actor, and of an encoder that both share; at the start if it adapts."""
    critic_rate: float = Field(default=5e-4, gt=0.0, le=0.1)
    """Learning rate of the critic."""
    schedule: Literal["adaptive", "fixed"] = "adaptive"
    """`adaptive`: the actor's rate follows the divergence between the old and the new policy."""
    desired_kl: float = Field(default=0.008, gt=0.0, le=1.0)
    """Divergence that the rate aims at."""
    rate_low: float = Field(default=2e-5, gt=0.0, le=0.1)
    """The actor's rate never adapts below."""
    rate_high: float = Field(default=1e-3, gt=0.0, le=0.1)
    """The actor's rate never adapts above."""
    gradient_norm: float = Field(default=1.0, gt=0.0, le=100.0)
    """Longest gradient of each part."""
    critic_warm_up: int = Field(default=10, ge=0, le=10_000)
    """Updates at the start in which only the critic learns, so that what the actor can do survives."""
    precision: Literal["float32", "bfloat16", "auto"] = "auto"
    """Of the update. `auto`: bfloat16 where the processor multiplies it in hardware, where it is faster."""
    shards: int = Field(default=2, ge=1, le=64)
    """Parts of a minibatch whose gradients are computed side by side and added in order. Part of the
    configuration, because sums depend on it: the number of threads does not change results."""

    @model_validator(mode="after")
    def _rates_are_ordered(self) -> "PpoSettings":
        if self.schedule == "adaptive" and not self.rate_low <= self.actor_rate <= self.rate_high:
            allowed = f"from {self.rate_low} to {self.rate_high}"
            raise misfit(("actor_rate",), str(self.actor_rate), allowed)
        return self


class ScheduleSettings(Settings):
    """How long, and what is done on the way."""

    updates: int = Field(default=2000, ge=1, le=10_000_000)
    """Of the whole training."""
    save_every: int = Field(default=10, ge=1, le=100_000)
    """Updates between two checkpoints; one is also written at the end and on Ctrl-C."""
    evaluate_every: int = Field(default=100, ge=0, le=100_000)
    """Updates between two evaluations on fixed scenes; 0 for none."""
    evaluation_trials: int = Field(default=40, ge=1, le=10_000)
    """Scenes of an evaluation in each of its worlds, from training seeds."""


class TrainingSettings(Settings):
    """A whole training: same file, seed and processor, same policy."""

    title: str = Field(default="Training", min_length=1, max_length=120)
    """Shown with progress."""
    contract: Literal["best-2", "paper-1"] = "best-2"
    """What the policy is given to see."""
    seed: int = Field(default=1, ge=0, le=2**31 - 1)
    """Of everything random."""
    start: str | None = Field(default=None, min_length=1, max_length=256)
    """Checkpoint whose actor this training starts from, relative to this file."""
    environment: EnvironmentSettings = EnvironmentSettings()
    """The swarms."""
    network: NetworkSettings = NetworkSettings()
    """Actor and critic."""
    ppo: PpoSettings = PpoSettings()
    """Optimisation."""
    schedule: ScheduleSettings = ScheduleSettings()
    """Length, checkpoints, evaluation."""
    imitation: ImitationSettings = ImitationSettings()
    """What comes before, where a network that says velocities itself is to start from a law."""

    @model_validator(mode="after")
    def _parts_fit(self) -> "TrainingSettings":
        contract = CONTRACTS[self.contract]
        if self.network.action == "residual" and contract.law != "flock":
            raise misfit(
                ("network", "action"),
                f"residual with {self.contract}",
                "a contract that sees flock's command",
            )
        return self


def load_training(path: Path, changes: Sequence[str] = ()) -> TrainingSettings:
    """Read the file of a training.

    Args:
        path: of the YAML file.
        changes: ``key.path=value`` each, said over what the file says.

    Raises:
        ProfileError: if anything is wrong, naming file or change, line and column.
    """
    tree = read_tree(path)
    for change in changes:
        key, _, text = change.partition("=")
        nested = "".join("{" + part + ": " for part in key.split("."))
        tree = merged(tree, parse_tree(f"{nested}{text}{'}' * (key.count('.') + 1)}", f"--set {change}"))
    return validated(tree, TrainingSettings)


def read_training(text: str, name: str) -> TrainingSettings:
    """Read a training's configuration from text.

    Args:
        text: as `configuration_text` writes it.
        name: of where it came from, for errors.

    Raises:
        ProfileError: if anything is wrong.
    """
    return loads(text, TrainingSettings, name)


def configuration_text(settings: TrainingSettings) -> str:
    """Return a training's complete configuration as YAML, which `read_training` reads again."""
    return yaml.safe_dump(_plain(settings), sort_keys=False, width=100)


def configuration_sha256(settings: TrainingSettings) -> str:
    """Return the hash of all that shapes a training; what it starts from and its length are left out."""
    beside = ("title", "start", "schedule", "imitation")
    plain = {key: value for key, value in _plain(settings).items() if key not in beside}
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def _plain(settings: TrainingSettings) -> dict[str, object]:
    plain: dict[str, object] = settings.model_dump(mode="json", by_alias=True)
    return plain
