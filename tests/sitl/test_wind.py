import numpy as np
import pytest

from sitl.wind import Wind, WindSettings


def test_gusts_have_the_deviation_and_memory_asked_for() -> None:
    settings = WindSettings(
        mean_world_mps=(1.0, -2.0, 0.0), gust_mps=0.8, vertical_gust_mps=0.3, gust_time_s=1.0,
        vertical_gust_time_s=0.5,
    )  # fmt: skip
    wind = Wind(np.random.default_rng(1), 50, settings)
    samples = np.array([wind.step(0.1) for _ in range(2000)])
    np.testing.assert_allclose(samples.mean(axis=(0, 1)), [1.0, -2.0, 0.0], atol=0.05)
    np.testing.assert_allclose(samples.std(axis=(0, 1)), [0.8, 0.8, 0.3], rtol=0.05)
    deviations = samples - samples.mean(axis=(0, 1))
    after_one_second = (deviations[:-10, :, 0] * deviations[10:, :, 0]).mean() / deviations[:, :, 0].var()
    assert after_one_second == pytest.approx(np.exp(-1.0), abs=0.05)


def test_still_air_does_not_move() -> None:
    wind = Wind(np.random.default_rng(1), 2, WindSettings())
    np.testing.assert_array_equal(wind.step(0.005), np.zeros((2, 3)))


def test_equal_generators_give_equal_wind() -> None:
    settings = WindSettings(gust_mps=0.5)
    first, again, other = (Wind(np.random.default_rng(seed), 3, settings).step(0.005) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
