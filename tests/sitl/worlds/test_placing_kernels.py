"""Dart throwing against plain definitions: distances between segments, and who is kept."""

import math

import numpy as np

from companion.messages import FloatArray
from sitl.worlds.placing_kernels import KEPT_COLUMNS, place_rods, segment_distance

RNG = np.random.default_rng(4)


def least_distance(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> float:
    """Distance between two segments: the best of a fine grid, then of ever finer ones round it."""
    s_low, s_high, t_low, t_high = 0.0, 1.0, 0.0, 1.0
    best = math.inf
    for _ in range(14):
        s, t = np.meshgrid(np.linspace(s_low, s_high, 9), np.linspace(t_low, t_high, 9), indexing="ij")
        gaps = np.linalg.norm(a + s[..., None] * (b - a) - c - t[..., None] * (d - c), axis=-1)
        best = min(best, float(gaps.min()))
        i, j = np.unravel_index(np.argmin(gaps), gaps.shape)
        ds, dt = 0.3 * (s_high - s_low), 0.3 * (t_high - t_low)
        s_low, s_high = max(s[i, j] - ds, 0.0), min(s[i, j] + ds, 1.0)
        t_low, t_high = max(t[i, j] - dt, 0.0), min(t[i, j] + dt, 1.0)
    return best


def test_segment_distance_is_the_least_over_both_segments() -> None:
    for _ in range(150):
        a, b, c, d = RNG.uniform(-3.0, 3.0, (4, 3))
        assert abs(segment_distance(*a, *b, *c, *d) - least_distance(a, b, c, d)) < 1e-4


def test_segment_distance_of_points_and_parallels() -> None:
    p, q = np.array([1.0, 2.0, 3.0]), np.array([4.0, 6.0, 3.0])
    assert segment_distance(*p, *p, *q, *q) == 5.0
    assert segment_distance(0, 0, 0, 0, 0, 5, 3, 4, 1, 3, 4, 9) == 5.0
    assert segment_distance(0, 0, 0, 0, 0, 5, 0, 0, 7, 0, 0, 9) == 2.0
    assert segment_distance(0, 0, 0, 0, 0, 5, 0, 0, 7, 0, 0, 7) == 2.0
    assert segment_distance(3, 0, 2, 3, 0, 2, 0, 0, 0, 0, 0, 5) == 3.0


def test_only_candidates_that_keep_every_distance_are_kept() -> None:
    candidates = np.zeros((120, 7))
    candidates[:, :2] = RNG.uniform(0.0, 12.0, (120, 2))
    candidates[:, 3:5] = candidates[:, :2] + RNG.uniform(-1.0, 1.0, (120, 2))
    candidates[:, 5], candidates[:, 6] = 4.0, RNG.uniform(0.1, 0.4, 120)
    kept, chosen = np.zeros((120, KEPT_COLUMNS)), np.empty(120, np.int64)
    used, count, failures = place_rods(candidates, kept, 0, 2.0, 0, 1000, chosen)
    assert used == 120
    expected: list[int] = []
    for k, rod in enumerate(candidates):
        others = candidates[expected]
        if all(
            least_distance(rod[:3], rod[3:6], other[:3], other[3:6]) >= 2.0 + rod[6] + other[6]
            for other in others
        ):
            expected.append(k)
    assert chosen[:count].tolist() == expected
    assert failures == 119 - expected[-1]
    assert 5 < count < 60


def test_placing_ends_when_too_many_fail_in_a_row_or_nothing_more_fits_into_the_table() -> None:
    same = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.1], (50, 1))
    kept, chosen = np.zeros((4, KEPT_COLUMNS)), np.empty(4, np.int64)
    assert place_rods(same, kept, 0, 1.0, 0, 7, chosen) == (8, 1, 7)
    apart = same.copy()
    apart[:, 0] = apart[:, 3] = 10.0 * np.arange(50)
    assert place_rods(apart, kept, 0, 1.0, 0, 7, chosen) == (4, 4, 0)
