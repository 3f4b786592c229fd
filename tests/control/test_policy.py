"""A model flies only if everything about it fits, and a refusal names both sides."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx")

from companion.control.followers.settings import FollowerSettings, with_gains
from companion.control.model_file import MODELS, model_path, pinned
from companion.control.observation import CONTRACTS, Observation
from companion.control.policy import load_policy, read_policy
from companion.control.policy_metadata import read
from companion.errors import ModelError
from tests.control.models import COMMIT, CONFIGURATION_SHA256, metadata, save, with_entry


def flying(path: Path, **changes: object) -> FollowerSettings:
    return FollowerSettings.model_validate({"controller": "policy", "model": str(path), **changes})


def refusal(settings: FollowerSettings) -> str:
    with pytest.raises(ModelError) as caught:
        load_policy(settings)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(settings.model))
    return text


@pytest.mark.parametrize("contract", CONTRACTS)
def test_a_model_that_fits_flies_and_says_what_it_is(contract: str, tmp_path: Path) -> None:
    path = save(tmp_path / "a.onnx", contract=contract, offset=(0.1, 0.2, 0.3))
    policy = load_policy(flying(path))
    assert policy.contract is CONTRACTS[contract]
    assert policy.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert str(policy) == f"a.onnx {policy.sha256[:12]}"
    assert policy.metadata.commit == COMMIT
    assert policy.metadata.configuration_sha256 == CONFIGURATION_SHA256
    assert policy.metadata.evaluation == [{"world": "none", "success_rate": 1.0}]
    velocities = policy.velocities(Observation(policy.contract, 5))
    assert velocities.dtype == np.float32
    np.testing.assert_allclose(velocities, np.tile([0.1, 0.2, 0.3], (5, 1)), rtol=1e-6)


def test_metadata_come_back_as_they_were_written() -> None:
    for contract in CONTRACTS:
        table = metadata(contract).table()
        assert read("a", table).table() == table


def test_a_law_is_known_by_its_gains() -> None:
    settings = FollowerSettings()
    other = with_gains(settings, "flock", {"lead_s": 0.36})
    assert settings.law_sha256() != other.law_sha256()
    assert settings.law_sha256() == with_gains(settings, "flock", {}).law_sha256()
    assert settings.law_sha256() != with_gains(settings, "lloyd", {}).law_sha256()
    # The limits of commands are no gains.
    slow = FollowerSettings.model_validate({"command": {"max_speed_mps": 1.0}})
    assert settings.law_sha256() == slow.law_sha256()


def test_a_missing_model_is_named(tmp_path: Path) -> None:
    assert refusal(flying(tmp_path / "gone.onnx")).endswith("gone.onnx: no such model")
    assert refusal(flying(tmp_path)).endswith("no such model")


def test_a_relative_path_begins_at_the_profile_and_the_shipped_one_is_at_home(tmp_path: Path) -> None:
    settings = FollowerSettings.model_validate({"model": "models/a.onnx"})
    assert model_path(settings.located(tmp_path)) == tmp_path / "models" / "a.onnx"
    assert FollowerSettings.model_validate({"model": "/a.onnx"}).located(tmp_path).model == "/a.onnx"
    assert model_path(FollowerSettings().located(tmp_path)) == MODELS / "follower.onnx"


@pytest.mark.parametrize("data", [b"", b"not a model", b"\x08\x09" * 1000])
def test_what_is_no_model_is_refused(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.onnx"
    path.write_bytes(data)
    assert "not a model that can be run" in refusal(flying(path)) or "no metadata" in refusal(flying(path))


def test_a_model_without_metadata_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "a.onnx", entries=lambda entries: {"opset": entries["opset"]})
    assert "no metadata contract, inputs, limits, configuration_sha256, commit, evaluation" in refusal(
        flying(path)
    )


def test_another_hash_is_refused_with_both(tmp_path: Path) -> None:
    path = save(tmp_path / "a.onnx")
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    text = refusal(flying(path, model_sha256=64 * "0"))
    assert f"sha256 {found}, the profile wants {64 * '0'}" in text
    assert load_policy(flying(path, model_sha256=found)).sha256 == found


def test_what_is_pinned_flies_no_other_model(tmp_path: Path) -> None:
    path = save(tmp_path / "a.onnx")
    settings = pinned(flying(path))
    before = hashlib.sha256(path.read_bytes()).hexdigest()
    assert settings.model_sha256 == before
    save(path, offset=(0.1, 0.0, 0.0))
    after = hashlib.sha256(path.read_bytes()).hexdigest()
    assert f"sha256 {after}, the profile wants {before}" in refusal(pinned(settings))
    # Where there is nothing to pin nothing changes.
    for other in (FollowerSettings(), flying(tmp_path / "gone.onnx")):
        assert pinned(other) == other


def test_another_contract_is_refused_with_both(tmp_path: Path) -> None:
    path = save(tmp_path / "a.onnx", entries=with_entry("contract", "best-9"))
    assert "contract 'best-9', this companion knows paper-1, best-2" in refusal(flying(path))


def test_other_shapes_are_refused_with_both(tmp_path: Path) -> None:
    path = save(tmp_path / "a.onnx", entries=with_entry("inputs", {"ego": [7]}))
    assert """inputs '{"ego": [7]}', contract best-2 has {"ego": [14],""" in refusal(flying(path))
    path = save(tmp_path / "a.onnx", shapes={"neighbours": (6, 8)})
    assert "input neighbours is tensor(float) (batch, 6, 8), wanted tensor(float) (batch, 12, 8)" in refusal(
        flying(path)
    )
    path = save(tmp_path / "a.onnx", shapes={"leader": (3,)})
    assert "inputs ego, grid, leader, memory, neighbours, contract best-2 has ego, grid" in refusal(
        flying(path)
    )
    path = save(tmp_path / "a.onnx", batch=1)
    assert "(1, 14), wanted tensor(float) (batch, 14)" in refusal(flying(path))
    path = save(tmp_path / "a.onnx", output="action")
    assert "outputs action, wanted velocity" in refusal(flying(path))


def test_other_gains_or_another_law_beside_it_are_refused_with_both(tmp_path: Path) -> None:
    path = save(tmp_path / "a.onnx")
    trained = FollowerSettings().law_sha256()
    changed = with_gains(flying(path), "flock", {"lead_s": 0.36})
    text = refusal(changed)
    assert f"gains of sha256 {trained}, the profile's have {changed.law_sha256()}" in text
    assert "flies beside the law flock, the profile has lloyd" in refusal(flying(path, method="lloyd"))
    # A contract that shows nothing of the law does not mind.
    paper = save(tmp_path / "b.onnx", contract="paper-1")
    assert load_policy(flying(paper, method="lloyd")).contract.name == "paper-1"
    assert read_policy(path).metadata.teacher == trained


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("opset", "99", "opset '99', wanted one from 13 to 22"),
        ("opset", "many", "opset 'many'"),
        ("teacher", "", "teacher '', wanted 64 hexadecimal digits"),
        ("configuration_sha256", "abc", "configuration_sha256 'abc', wanted"),
        ("limits", [1.0], "limits '[1.0]', wanted numbers by name"),
        ("limits", "{", "limits '{', wanted JSON"),
        ("inputs", "", "inputs '', wanted JSON"),
        ("observation_low", {"ego": [0.0]}, "observation_low has 1 values for ego, wanted 14 finite numbers"),
        ("observation_high", {"neighbours": []}, "observation_high has nothing for ego"),
        ("observation_low", {"ego": 14 * [2e3], "neighbours": 8 * [0]}, "of ego exceeds observation_high"),
        ("evaluation", None, "no metadata evaluation"),
    ],
)
def test_broken_metadata_are_named(key: str, value: object, says: str, tmp_path: Path) -> None:
    path = save(tmp_path / "a.onnx", entries=with_entry(key, value))
    assert says in refusal(flying(path))


def test_a_model_that_gives_no_velocity_on_the_ground_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "a.onnx", offset=(0.0, float("nan"), 0.0))
    assert "[[0.0, nan, 0.0]] where nothing is seen, wanted a finite velocity" in refusal(flying(path))


def test_what_training_never_showed_is_counted(tmp_path: Path) -> None:
    policy = load_policy(flying(save(tmp_path / "a.onnx", width=1.0)))
    observation = Observation(policy.contract, 2)
    assert policy.unusual(observation) == 0
    observation.ego[0, 3] = 1.9
    assert policy.unusual(observation) == 0
    observation.ego[0, 3:5] = 2.1, -2.1
    assert policy.unusual(observation) == 2
    assert policy.unusual(observation, 1) == 0
    # Rows that stand for nobody count for nothing.
    observation.neighbours[1, 4, 0] = 5.0
    assert policy.unusual(observation, 1) == 0
    observation.neighbours[1, 4, 6] = 1.0
    assert policy.unusual(observation, 1) == 1
