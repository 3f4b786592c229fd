from collections.abc import Mapping
from pathlib import Path

import pytest
import torch

from companion.errors import LogError, ProfileError
from sitl.training import checkpoints
from sitl.training.networks import Policy
from sitl.training.runner import Limits, Training, load_policy
from sitl.training.settings import NetworkSettings, TrainingSettings
from sitl.training.torch_threads import calm_threads
from tests.sitl.training.point_mass import PointMass

calm_threads()


def settings(**changes: object) -> TrainingSettings:
    plain: dict[str, object] = {
        "network": {
            "azimuth_channels": [2],
            "neighbour_width": 8,
            "hidden": [16],
            "critic_hidden": [16],
        },
        "ppo": {"steps": 4, "epochs": 1, "minibatches": 2, "critic_warm_up": 1, "precision": "float32"},
        "schedule": {"save_every": 2, "evaluate_every": 2},
    }
    return TrainingSettings.model_validate(plain | changes)


def training(folder: Path, wanted: TrainingSettings | None = None, **options: object) -> Training:
    return Training(wanted or settings(), PointMass(8, 1), folder, **options)  # type: ignore[arg-type]


def run(training: Training, limits: Limits, stop_after: int = 1000) -> str:
    asked = iter(range(1, 10_000))
    trained = training.run(limits, stop=lambda: next(asked) >= stop_after)
    training.close()
    return trained.parameters_sha256


def test_a_training_that_was_cut_goes_on_exactly_as_it_would_have(tmp_path: Path) -> None:
    whole = run(training(tmp_path / "whole"), Limits(7))
    first = run(training(tmp_path / "cut"), Limits(7), stop_after=3)
    assert first != whole
    assert run(training(tmp_path / "cut", resume=True), Limits(7)) == whole
    rows = (tmp_path / "cut" / "curve.csv").read_text().splitlines()
    assert [int(row.split(",")[0]) for row in rows[1:]] == [1, 2, 3, 4, 5, 6, 7]


def test_without_the_swarms_state_it_goes_on_with_trials_that_begin_anew(tmp_path: Path) -> None:
    run(training(tmp_path), Limits(3))
    (tmp_path / checkpoints.SWARMS).unlink()
    again = training(tmp_path, resume=True)
    assert again.update == 3
    run(again, Limits(5))
    assert checkpoints.load(tmp_path / checkpoints.LAST).update == 5


def test_rows_after_the_last_checkpoint_are_flown_again(tmp_path: Path) -> None:
    run(training(tmp_path), Limits(2))
    with (tmp_path / "curve.csv").open("a") as file:
        file.write(file_row_after(tmp_path))
    run(training(tmp_path, resume=True), Limits(4))
    rows = (tmp_path / "curve.csv").read_text().splitlines()
    assert [int(row.split(",")[0]) for row in rows[1:]] == [1, 2, 3, 4]


def file_row_after(folder: Path) -> str:
    last = (folder / "curve.csv").read_text().splitlines()[-1]
    return "9" + last[last.index(",") :] + "\n"


def test_the_best_policy_is_kept_with_what_it_was_judged_by(tmp_path: Path) -> None:
    scores = iter([1.0, 5.0, 3.0, 4.0])
    seen = []

    def evaluate(policy: Policy) -> Mapping[str, float]:
        score = next(scores)
        seen.append(policy)
        return {"score": score, "none_SR": 100.0 * score}

    one = training(tmp_path, evaluate=evaluate)
    trained = one.run(Limits(6))
    one.close()
    assert len(seen) == 4
    assert trained.best_score == 5.0
    policy, best = load_policy(tmp_path / checkpoints.BEST)
    assert best.update == 2
    assert best.evaluation == {"score": 5.0, "none_SR": 500.0}
    assert not best.resumable
    with torch.no_grad():
        seen_zero = policy(*(torch.zeros(1, *shape) for shape in ((14,), (12, 8), (2, 72, 12), (72,))))
    assert seen_zero.shape == (1, 3)
    header, *rows = (tmp_path / "curve.csv").read_text().splitlines()
    score = header.split(",").index("evaluation_score")
    assert [row.split(",")[score] for row in rows] == ["1", "", "5", "", "3", "", "4"]


def test_a_folder_with_a_training_is_not_overwritten(tmp_path: Path) -> None:
    run(training(tmp_path), Limits(2))
    with pytest.raises(ProfileError, match="--resume"):
        training(tmp_path)


def test_there_must_be_something_to_resume(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="nothing to resume"):
        training(tmp_path, resume=True)


def test_another_configuration_is_not_resumed_but_a_longer_one_is(tmp_path: Path) -> None:
    run(training(tmp_path), Limits(2))
    with pytest.raises(ProfileError, match="another configuration"):
        training(tmp_path, settings(seed=2), resume=True)
    longer = settings(schedule={"updates": 9999, "evaluate_every": 0})
    assert training(tmp_path, longer, resume=True).update == 2


def test_a_file_that_is_no_checkpoint_is_refused(tmp_path: Path) -> None:
    wrong = tmp_path / "last.pt"
    wrong.write_bytes(b"no checkpoint")
    with pytest.raises(LogError, match=r"last\.pt: not a checkpoint"):
        checkpoints.load(wrong)
    torch.save({"version": 99, "update": 0}, wrong)
    with pytest.raises(LogError, match="version 99"):
        checkpoints.load(wrong)


def test_a_training_starts_from_the_actor_of_another(tmp_path: Path) -> None:
    direct = NetworkSettings.model_validate({**settings().network.model_dump(), "action": "direct"})
    wanted = settings(network=direct.model_dump())
    one = training(tmp_path / "one", wanted)
    one.run(Limits(3))
    state = {name: value.clone() for name, value in one.algorithm.actor.state_dict().items()}
    one.close()
    louder = {**direct.model_dump(), "sigma_horizontal_mps": 0.3}
    other = training(tmp_path / "other", settings(network=louder), start=tmp_path / "one" / "last.pt")
    started = other.algorithm.actor.state_dict()
    assert float(started["distribution.log_std_param"][0].exp()) == pytest.approx(0.3)
    assert all(torch.equal(started[name], state[name]) for name in state if "std" not in name)
    with pytest.raises(ProfileError, match="network"):
        training(tmp_path / "third", settings(), start=tmp_path / "one" / "last.pt")


def test_a_limit_of_time_ends_a_run_with_a_checkpoint(tmp_path: Path) -> None:
    run(training(tmp_path), Limits(1000, wall_s=0.0))
    assert checkpoints.load(tmp_path / checkpoints.LAST).update == 1
