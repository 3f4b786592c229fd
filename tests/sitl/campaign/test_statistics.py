import math
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from sitl.campaign.statistics import mcnemar_exact, mean_interval, wilson_interval


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        (100, 100, 96.3, 100.0),
        (99, 100, 94.6, 99.8),
        (97, 100, 91.5, 99.0),
        (72, 100, 62.5, 79.9),
        (980, 1000, 96.9, 98.7),
        (990, 1000, 98.2, 99.5),
        (0, 10, 0.0, 27.8),
    ],
)
def test_the_interval_of_a_rate_is_the_published_one(
    successes: int, trials: int, low: float, high: float
) -> None:
    found = wilson_interval(successes, trials)
    assert 100.0 * found[0] == pytest.approx(low, abs=0.051)
    assert 100.0 * found[1] == pytest.approx(high, abs=0.051)


@given(st.integers(1, 500), st.floats(0.5, 0.999), st.data())
def test_the_interval_of_a_rate_is_scipys(trials: int, confidence: float, data: st.DataObject) -> None:
    successes = data.draw(st.integers(0, trials))
    expected = stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    low, high = wilson_interval(successes, trials, confidence)
    assert low == pytest.approx(expected.low, abs=1e-12)
    assert high == pytest.approx(expected.high, abs=1e-12)
    assert 0.0 <= low <= successes / trials <= high <= 1.0


@pytest.mark.parametrize(("successes", "trials"), [(0, 0), (5, 4), (-1, 4)])
def test_impossible_counts_have_no_interval(successes: int, trials: int) -> None:
    with pytest.raises(ValueError, match="have no rate"):
        wilson_interval(successes, trials)


def test_a_confidence_is_a_probability() -> None:
    with pytest.raises(ValueError, match="no probability"):
        wilson_interval(1, 2, 95.0)


def split_is_as_uneven(first: int, second: int) -> float:
    """Count all ways in which fair coins fall at least as unevenly."""
    total = first + second
    ways = [sum(coins) for coins in product((0, 1), repeat=total)]
    return sum(abs(2 * heads - total) >= abs(first - second) for heads in ways) / len(ways)


@pytest.mark.parametrize(("first", "second"), list(product(range(6), range(6))))
def test_mcnemars_p_is_what_counting_all_coins_gives(first: int, second: int) -> None:
    assert mcnemar_exact(first, second) == pytest.approx(split_is_as_uneven(first, second), abs=1e-12)


@given(st.integers(0, 300), st.integers(0, 300))
def test_mcnemars_p_is_a_two_sided_binomial_test(first: int, second: int) -> None:
    p = mcnemar_exact(first, second)
    assert p == mcnemar_exact(second, first)
    if first + second:
        assert p == pytest.approx(stats.binomtest(first, first + second).pvalue, abs=1e-12)
    else:
        assert p == 1.0


def test_a_negative_number_of_pairs_is_refused() -> None:
    with pytest.raises(ValueError, match="no number of pairs"):
        mcnemar_exact(-1, 2)


def test_the_interval_of_a_mean_is_students() -> None:
    values = [1.2, 1.9, 1.4, math.nan, 1.7, math.inf]
    found = mean_interval(values)
    known = [1.2, 1.9, 1.4, 1.7]
    expected = stats.ttest_1samp(known, 0.0).confidence_interval(0.95)
    assert found.count == 4
    assert found.mean == pytest.approx(1.55)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))
    assert found.sd == pytest.approx(stats.tstd(known))


def test_one_value_has_a_mean_and_no_spread_and_no_value_has_neither() -> None:
    assert mean_interval([2.0]).mean == 2.0
    assert math.isnan(mean_interval([2.0]).sd)
    assert math.isnan(mean_interval([]).mean)
    assert mean_interval([math.nan]).count == 0
