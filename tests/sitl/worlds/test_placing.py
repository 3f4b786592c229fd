"""Filling an area: what callers of `fill` may rely on."""

import numpy as np

from companion.messages import FloatArray
from sitl.worlds.placing import fill


def _balls(numbers: FloatArray) -> FloatArray:
    rods = np.zeros((len(numbers), 7))
    rods[:, :2] = rods[:, 3:5] = 36.0 * numbers
    rods[:, 6] = 0.1
    return rods


def test_the_generator_moves_on_by_the_candidates_looked_at_and_no_more() -> None:
    rng, twin = np.random.default_rng(5), np.random.default_rng(5)
    fill(rng, 2, _balls, free=[], gap_m=12.0, failures_until_full=10)
    following = rng.random()
    looked_at = 0
    while twin.random(2)[0] != following and looked_at < 5000:
        looked_at += 1
        twin = np.random.default_rng(5)
        twin.random((looked_at, 2))
    assert 10 < looked_at < 5000


def test_many_more_than_one_batch_or_table_can_hold_are_placed() -> None:
    rods, numbers = fill(
        np.random.default_rng(1), 2, _balls, free=[(18.0, 18.0, 5.0)], gap_m=0.5, failures_until_full=200
    )
    assert len(rods) > 900
    np.testing.assert_array_equal(rods, _balls(numbers))
    assert np.hypot(*(rods[:, :2] - 18.0).T).min() >= 5.1
    gaps = np.hypot(*(rods[:, None, :2] - rods[None, :, :2]).transpose(2, 0, 1))
    np.fill_diagonal(gaps, np.inf)
    assert gaps.min() >= 0.7


def test_no_more_than_asked_for_are_placed() -> None:
    rods, _ = fill(
        np.random.default_rng(1), 2, _balls, free=[(0.0, 0.0, 1.0)], gap_m=1.0, failures_until_full=50, most=7
    )
    assert len(rods) == 7
