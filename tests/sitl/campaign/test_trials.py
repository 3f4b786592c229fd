"""Who flies in a trial: every variant with its own number of neighbours, perception and model."""

import json
from pathlib import Path

import numpy as np
import pytest

from companion.config import load_profile
from companion.control.followers.settings import FollowerSettings
from companion.control.observation import CONTRACTS, Contract, Observation
from companion.messages import Float32Array
from sitl.abstract.flight import AbstractFlight
from sitl.campaign import full_trials, trials
from sitl.campaign.conditions import Conditions, conditions_of
from sitl.campaign.definition import load_definition
from sitl.campaign.scenes import scene_of
from sitl.swarm.referee import TrialNames
from sitl.swarm.vehicles import Crew

FIELD_CONFIGS = Path(__file__).parents[3] / "field_configs"


def conditions(folder: Path, text: str) -> Conditions:
    for file in (*FIELD_CONFIGS.glob("uav_*.yaml"), *FIELD_CONFIGS.glob("sitl_swarm_*er.yaml")):
        (folder / file.name).write_bytes(file.read_bytes())
    path = folder / "campaign.yaml"
    path.write_text(f"title: T\nworlds: [none]\nfollowers: [10]\n{text}", encoding="utf-8")
    return conditions_of(load_definition(path), path)


def flown(found: Conditions, label: str, *, record: bool = False) -> AbstractFlight:
    scene = scene_of(found.rules, found.worlds["none"], 10, 0)
    return trials.fly_one(found.rules, "none", found.variants[label], scene, 0, record=record)


def test_more_neighbours_than_companions_take_by_default_count_in_abstract_fidelity(tmp_path: Path) -> None:
    found = conditions(tmp_path, "methods: [flock]\nobservable_neighbours: [2, 6, 9, 10]\n")
    radii = {label: flown(found, label).record.flock_radius_m for label in found.variants}
    assert len(set(radii.values())) == 4


def test_more_neighbours_than_the_followers_profile_says_count_in_full_fidelity(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = conditions(tmp_path, "methods: [flock]\nobservable_neighbours: [3, 10]\nfidelity: full\n")
    crews: list[Crew] = []

    def noted(scene: object, crew: Crew, *rest: object, **more: object) -> None:
        crews.append(crew)

    monkeypatch.setattr(full_trials, "fly_full", noted)
    monkeypatch.setattr(full_trials, "_prepare", lambda: None)
    scene = scene_of(found.rules, found.worlds["none"], 10, 0)
    for label, variant in found.variants.items():
        full_trials.fly_one_fully(found.rules, variant, scene, TrialNames("none", label, 0), tmp_path)
    assert load_profile(tmp_path / "sitl_swarm_follower.yaml").neighbours.count == 12
    assert [crew.follower.neighbours.count for crew in crews] == [3, 10]


def test_a_perception_is_what_followers_fly_with(tmp_path: Path) -> None:
    text = (
        "methods: [flock]\nperceptions:\n  - {name: published}\n  - {name: same, sigma_factor: 1.0}\n"
        "  - {name: noisy, sigma_factor: 4.0}\n  - {name: late, settings: {neighbour_delay_s: 0.4}}\n"
        "  - {name: measured, preset: measured}\n"
    )
    found = conditions(tmp_path, text)
    radii = {label.partition("@")[2]: flown(found, label).record.flock_radius_m for label in found.variants}
    assert radii["published"] == radii["same"]
    assert len(set(radii.values())) == 4


class Upward:
    """A learned law that wants to climb slowly, whatever it sees."""

    contract: Contract = CONTRACTS["paper-1"]

    def velocities(self, observation: Observation) -> Float32Array:
        return np.tile(np.array([0.0, 0.0, 0.1], np.float32), (len(observation.ego), 1))


def test_what_was_learned_flies_as_a_method_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "learned.yaml").write_text(
        json.dumps(
            {"extends": "uav_follower.yaml", "follower": {"controller": "policy", "model": "mine.onnx"}}
        ),
        encoding="utf-8",
    )
    text = "methods: [flock, {name: mine, method: policy, parameters: learned.yaml}]\n"
    found = conditions(tmp_path, text)
    asked: list[FollowerSettings] = []

    def policy_of(follower: FollowerSettings) -> Upward:
        asked.append(follower)
        return Upward()

    monkeypatch.setattr(trials, "policy_of", policy_of)
    law, learned = flown(found, "flock").record, flown(found, "mine").record
    assert [follower.model for follower in asked] == [str(tmp_path / "mine.onnx")]
    assert (learned.method, learned.scene_hash) == ("policy", law.scene_hash)
    assert learned.flock_radius_m != law.flock_radius_m
