"""The model that comes with the product can be flown as the product is."""

import numpy as np

from companion.control.followers.settings import FollowerSettings
from companion.control.model_file import MODELS
from companion.control.observation import Observation
from companion.control.policy import load_policy


def test_the_shipped_model_flies_beside_the_law_as_it_is_by_default() -> None:
    policy = load_policy(FollowerSettings.model_validate({"controller": "policy"}))
    assert policy.path == MODELS / "follower.onnx"
    seen = Observation(policy.contract, 4)
    velocities = policy.velocities(seen)
    assert velocities.shape == (4, 3)
    # With nothing in sight and a law that wants nothing it hardly moves.
    assert np.abs(velocities).max() < 0.5


def test_the_shipped_model_carries_the_table_of_its_evaluation() -> None:
    policy = load_policy(FollowerSettings.model_validate({"controller": "policy"}))
    assert policy.metadata.evaluation
    assert len(policy.metadata.commit) >= 7
