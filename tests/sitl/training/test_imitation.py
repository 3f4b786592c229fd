import csv
from pathlib import Path

import numpy as np
import pytest

from companion.control.observation import CONTRACTS
from companion.errors import ProfileError
from sitl.training.checkpoints import parameters_sha256
from sitl.training.clear_sight import ClearSight
from sitl.training.environment_results import Observation
from sitl.training.imitation import IMITATED, Imitated, Imitation, Seen
from sitl.training.imitation_settings import ImitationSettings
from sitl.training.networks import Policy, build
from sitl.training.runner import load_policy
from sitl.training.settings import TrainingSettings
from tests.sitl.training.small_batch import OPEN, open_batch
from tests.sitl.training.small_policy import SMALL

PLAN = ImitationSettings(
    rounds=8, steps=60, teacher_rounds=3, keep=0.5, capacity=1000, gradient_steps=100, minibatch=64, rate=3e-3
)
DIRECT = TrainingSettings(
    environment=OPEN, network=SMALL.model_copy(update={"action": "direct"}), imitation=PLAN
)


def imitated(folder: Path, rounds: int = 8) -> tuple[Imitated, str]:
    plan = PLAN.model_copy(update={"rounds": rounds})
    imitation = Imitation(
        DIRECT.model_copy(update={"imitation": plan}), open_batch(), folder, evaluate=lambda _: {"score": 7.0}
    )
    done = imitation.run()
    imitation.close()
    return done, parameters_sha256(imitation.actor.state_dict())


def test_a_network_comes_to_fly_like_the_law(tmp_path: Path) -> None:
    done, _ = imitated(tmp_path / "one")
    with (tmp_path / "one" / "curve.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    errors = [float(row["error_mps"]) for row in rows]
    assert errors[-1] < 0.5 * errors[0]
    assert [float(row["teacher_share"]) for row in rows[:4]] == pytest.approx(
        [1.0, 2 / 3, 1 / 3, 0.0], abs=1e-5
    )
    assert (done.rounds, done.samples, done.score, done.stopped) == (8, 8 * 60 * 4, 7.0, False)
    _, checkpoint = load_policy(tmp_path / "one" / IMITATED)
    assert (checkpoint.update, checkpoint.evaluation, checkpoint.resumable) == (8, {"score": 7.0}, False)


def test_equal_seeds_give_equal_networks(tmp_path: Path) -> None:
    assert imitated(tmp_path / "one", 1)[1] == imitated(tmp_path / "two", 1)[1]


def test_a_network_that_adds_to_flock_s_command_has_nothing_to_learn(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"network\.action: found residual, allowed direct"):
        Imitation(TrainingSettings(environment=OPEN, network=SMALL), open_batch(), tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_a_network_that_adds_to_flock_s_command_learns_from_one_who_sees_all_as_it_is(tmp_path: Path) -> None:
    settings = TrainingSettings(
        environment=OPEN, network=SMALL, imitation=PLAN.model_copy(update={"sight": "clear"})
    )
    imitation = Imitation(settings, ClearSight(open_batch(), cohesion=3.0), tmp_path)
    imitation.run()
    imitation.close()
    inputs, answer = imitation._seen.draw(np.random.default_rng(5), 500)
    learned = Policy(imitation.actor)(**inputs).detach() - answer
    flock = Policy(build("best-2", SMALL, 1, 1)[0])(**inputs).detach() - answer
    assert learned.square().mean() < 0.7 * flock.square().mean()


def test_an_imitation_is_not_overwritten(tmp_path: Path) -> None:
    imitated(tmp_path, rounds=1)
    with pytest.raises(ProfileError, match="holds an imitation already"):
        imitated(tmp_path)


def test_whoever_is_stopped_keeps_what_was_learned(tmp_path: Path) -> None:
    imitation = Imitation(DIRECT, open_batch(), tmp_path)
    done = imitation.run(stop=lambda: True)
    imitation.close()
    assert (done.rounds, done.stopped, done.score) == (1, True, None)
    assert (tmp_path / IMITATED) in done.files


def test_what_was_seen_is_drawn_as_it_was() -> None:
    contract = CONTRACTS["best-2"]
    rng = np.random.default_rng(4)
    seen = Observation.room("best-2", 5)
    kept = Seen(contract, 4)
    seen.ego[:] = rng.normal(size=seen.ego.shape)
    seen.reference[:] = rng.normal(size=(5, 3))
    seen.grid[:, 0] = np.maximum(rng.uniform(-1.0, 1.0, seen.grid[:, 0].shape), 0.0)
    seen.grid[:, 1] = seen.grid[:, 0] > 0.0
    kept.add(seen, np.array([0, 3]))
    assert len(kept) == 2
    kept.add(seen, np.array([1, 2, 4]))
    assert len(kept) == 4
    inputs, answers = kept.draw(np.random.default_rng(1), 50)
    assert list(inputs) == list(contract.inputs)
    found = set()
    for row in range(50):
        [stream] = np.flatnonzero((seen.ego == inputs["ego"][row].numpy()).all(1))
        found.add(int(stream))
        np.testing.assert_array_equal(answers[row], seen.reference[stream])
        np.testing.assert_allclose(inputs["grid"][row], seen.grid[stream], atol=5e-4)
        np.testing.assert_array_equal(inputs["grid"][row, 1], seen.grid[stream, 1])
    assert found == {1, 2, 3, 4}, "the oldest has made room"
