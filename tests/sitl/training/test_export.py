from pathlib import Path

import numpy as np
import pytest
import torch

from companion.control.followers.settings import FollowerSettings
from companion.control.observation import CONTRACTS
from companion.control.policy import load_policy, read_policy
from companion.errors import ModelError
from sitl.training import export as exporting
from sitl.training.export import OBSERVATIONS, TOLERANCE_MPS, Exported, export
from sitl.training.settings import NetworkSettings, TrainingSettings, configuration_sha256
from tests.sitl.training.small_policy import NEAR, SETTINGS, policy


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    path = tmp_path_factory.mktemp("model") / "follower.onnx"
    return export(policy(0.05), SETTINGS, path, evaluation=[{"SR": 99.0}], commit="c0ffee", cases=NEAR)


def test_the_file_says_what_the_network_says_on_a_thousand_observations_of_flights(
    exported: Exported,
) -> None:
    assert exported.observations >= OBSERVATIONS == 1000
    assert exported.difference_mps <= TOLERANCE_MPS == 1e-5
    assert exported.size == exported.path.stat().st_size


def test_a_companion_loads_the_file_and_knows_where_it_comes_from(exported: Exported) -> None:
    model = load_policy(FollowerSettings(controller="policy", model=str(exported.path)))
    said = model.metadata
    assert model.sha256 == exported.sha256
    assert said.contract == "best-2"
    assert said.configuration_sha256 == configuration_sha256(SETTINGS)
    assert (said.commit, said.evaluation) == ("c0ffee", [{"SR": 99.0}])
    assert said.limits["max_speed_mps"] == FollowerSettings().command.max_speed_mps
    assert said.observation_low["neighbours"][6] == said.observation_high["neighbours"][6] == 1.0
    assert np.all(said.observation_high["ego"] >= said.observation_low["ego"])


def test_what_followers_see_in_such_flights_is_usual(
    exported: Exported, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = read_policy(exported.path)
    monkeypatch.setattr(exporting, "OBSERVATIONS", 10)
    seen = exporting.record_observations(policy(0.05), SETTINGS, NEAR)
    unusual = [model.unusual(seen, row) for row in range(len(seen.ego))]
    assert np.mean(np.array(unusual) > 0) < 0.02
    seen.ego[0, 0] = 5.0
    assert model.unusual(seen, 0) == 1


def test_equal_networks_give_equal_files_and_stay_as_they_are(exported: Exported) -> None:
    network, contract = policy(0.05), CONTRACTS["best-2"]
    before = {name: value.clone() for name, value in network.state_dict().items()}
    metadata = read_policy(exported.path).metadata
    assert exporting.model_bytes(network, contract, metadata) == exported.path.read_bytes()
    assert all(torch.equal(value, before[name]) for name, value in network.state_dict().items())


def test_a_file_that_says_something_else_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = exporting.model_bytes
    monkeypatch.setattr(exporting, "OBSERVATIONS", 10)
    monkeypatch.setattr(exporting, "model_bytes", lambda module, *rest: right(policy(0.06), *rest))
    with pytest.raises(ModelError, match="differ from the network's by"):
        export(policy(0.05), SETTINGS, tmp_path / "wrong.onnx", cases=NEAR)
    assert list(tmp_path.iterdir()) == []


def test_the_paper_s_network_is_exported_as_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exporting, "OBSERVATIONS", 10)
    settings = TrainingSettings(contract="paper-1", network=NetworkSettings(kind="paper", action="direct"))
    done = export(policy(settings=settings), settings, tmp_path / "paper.onnx", cases=NEAR[:1])
    model = read_policy(done.path)
    assert model.contract == CONTRACTS["paper-1"]
    assert model.metadata.teacher == ""
    assert done.difference_mps <= TOLERANCE_MPS
