"""The speed of the training environment is counted in steps of all its UAVs."""

import pytest

from sitl.bench.environment_speed import measure
from sitl.training.settings import PpoSettings, TrainingSettings
from tests.sitl.training.small_batch import OPEN


def test_one_row_for_one_thread_and_one_for_several() -> None:
    settings = TrainingSettings(contract="best-2", environment=OPEN, ppo=PpoSettings(hold=2))
    built: list[tuple[int, int]] = []
    rows = list(measure(settings, 2, 4, lambda done, total: built.append((done, total))))
    assert [row["threads"] for row in rows] == [1, 2]
    assert built == [(1, 2), (2, 2)]
    for row in rows:
        assert (row["followers"], row["uavs"], row["hold"], row["steps"]) == (4, 5, 2, 4)
        for unit in ("s", "cpu_s"):
            of_all, of_followers = row[f"uav_steps_per_{unit}"], row[f"follower_steps_per_{unit}"]
            assert isinstance(of_all, float)
            assert isinstance(of_followers, float)
            assert of_all == pytest.approx(1.25 * of_followers)
            assert of_all > 0.0
