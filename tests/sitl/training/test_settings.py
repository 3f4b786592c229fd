import re
from pathlib import Path

import pytest

from companion.errors import ProfileError
from sitl.training.settings import (
    TrainingSettings,
    configuration_sha256,
    configuration_text,
    load_training,
    read_training,
)

CONFIGS = Path(__file__).parents[3] / "field_configs"


@pytest.mark.parametrize("name", ["best", "paper", "quick"])
def test_the_shipped_files_load_and_survive_being_written(name: str) -> None:
    settings = load_training(CONFIGS / f"train_{name}.yaml")
    assert read_training(configuration_text(settings), "text") == settings


def test_the_published_recipe_has_the_published_numbers() -> None:
    settings = load_training(CONFIGS / "train_paper.yaml")
    ppo, reward = settings.ppo, settings.environment.reward
    assert (ppo.clip, ppo.value, ppo.entropy, ppo.gamma, ppo.lambda_) == (0.1, 1.0, 0.001, 0.99, 0.95)
    assert (ppo.actor_rate, ppo.critic_rate, ppo.schedule) == (1e-3, 1e-3, "fixed")
    assert (reward.flock, reward.obstacle, reward.stable, reward.perception) == (1.5, 2.0, 1.0, 1.0)
    assert reward.collision == 10.0


def test_changes_from_the_command_line_win() -> None:
    settings = load_training(
        CONFIGS / "train_quick.yaml", ["ppo.epochs=3", "ppo.lambda=0.9", "environment.worlds={forest: 1.0}"]
    )
    assert settings.ppo.epochs == 3
    assert settings.ppo.lambda_ == 0.9
    assert settings.environment.worlds["forest"] == 1.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("ppo.epoch=3", "--set ppo.epoch=3"),
        ("ppo.epochs=many", "--set ppo.epochs=many"),
        ("ppo.clip=7.0", "1"),
        ("network.sigma_vertical_mps=1.5", "sigma_vertical_mps"),
        ("contract=paper-1", "residual with paper-1"),
    ],
)
def test_wrong_changes_are_refused_naming_themselves(change: str, said: str) -> None:
    with pytest.raises(ProfileError, match=re.escape(said)):
        load_training(CONFIGS / "train_quick.yaml", [change])


def test_the_hash_tells_what_shapes_the_policy_from_what_does_not() -> None:
    settings = TrainingSettings()
    longer = settings.model_copy(update={"title": "Other", "start": "other.pt"})
    other = settings.model_copy(update={"seed": 2})
    assert configuration_sha256(settings) == configuration_sha256(longer)
    assert configuration_sha256(settings) != configuration_sha256(other)
