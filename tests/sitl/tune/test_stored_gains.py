"""Stored gains of the laws of others still give the flocks that they were tuned to."""

from pathlib import Path

import numpy as np
import pytest

from companion.config import load_profile
from sitl.abstract.flight import fly_abstract
from sitl.abstract.settings import AbstractSettings
from sitl.campaign.tasks import trial_seed
from sitl.swarm.scene import set_scene
from sitl.swarm.settings import SwarmSettings
from sitl.tune.exam import target_of

FIELD_CONFIGS = Path(__file__).parents[3] / "field_configs"
TRIALS = 50


@pytest.mark.parametrize("method", ["pacnav", "vpf", "reynolds_apf"])
def test_radius_and_separation_in_free_space_are_the_published_ones(method: str) -> None:
    """Scenes that no tuning has seen, leaders as fast as in the campaigns, perception as published."""
    follower = load_profile(FIELD_CONFIGS / f"follower_{method}_T1.yaml").follower
    assert follower is not None
    assert follower.method == method
    settings, target = AbstractSettings.of("paper"), target_of(method, "paper")
    records = []
    for trial in range(TRIALS):
        scene = set_scene(SwarmSettings(), "none", trial_seed(1, "none", 4, trial, held_out=True))
        records.append(fly_abstract(scene, method, follower, settings).record)
    radius = float(np.mean([record.flock_radius_m for record in records]))
    separation = float(np.mean([record.minimum_separation_m for record in records]))
    assert radius == pytest.approx(target.flock_radius_m, abs=0.15)
    assert separation == pytest.approx(target.minimum_separation_m, abs=0.07)
