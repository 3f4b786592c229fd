"""How sure a table can be: intervals of rates and means, and paired comparison of two methods."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean and how sure it is.

    Attributes:
        mean: of what is finite; NaN if nothing is.
        sd: standard deviation with n - 1 in the denominator; NaN for less than two values.
        low, high: t interval of the mean; NaN for less than two values.
        count: finite values.
    """

    mean: float
    sd: float
    low: float
    high: float
    count: int


def wilson_interval(successes: int, trials: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the score interval of a rate, as two shares between 0 and 1.

    Args:
        successes: how many of the trials succeeded.
        trials: at least one.
        confidence: probability that the interval holds the true rate.

    Raises:
        ValueError: if there is no trial, more successes than trials, or no such probability.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", 1927.
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes of {trials} trials have no rate")
    z = float(stats.norm.ppf(0.5 + 0.5 * _probability(confidence)))
    rate = successes / trials
    spread = z * z / trials
    centre = (rate + spread / 2.0) / (1.0 + spread)
    half = z / (1.0 + spread) * math.sqrt(rate * (1.0 - rate) / trials + spread / (4.0 * trials))
    # At the ends the formula gives 0 and 1 but for rounding.
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    high = 1.0 if successes == trials else min(1.0, centre + half)
    return low, high


def mean_interval(values: Sequence[float], confidence: float = CONFIDENCE) -> Mean:
    """Return mean, standard deviation and t interval of what is finite in `values`.

    Raises:
        ValueError: if `confidence` is no probability.
    """
    array = np.asarray(values, dtype=np.float64)
    known = array[np.isfinite(array)]
    count = len(known)
    mean = float(known.mean()) if count else math.nan
    if count < 2:
        return Mean(mean, math.nan, math.nan, math.nan, count)
    sd = float(known.std(ddof=1))
    half = float(stats.t.ppf(0.5 + 0.5 * _probability(confidence), count - 1)) * sd / math.sqrt(count)
    return Mean(mean, sd, mean - half, mean + half, count)


def mcnemar_exact(only_first: int, only_second: int) -> float:
    """Return the two-sided p of McNemar's exact test on paired trials.

    Args:
        only_first: pairs in which the first method alone succeeded.
        only_second: pairs in which the second method alone did.

    Returns:
        The probability of a split at least as uneven, were both methods equally good; 1 without any such
        pair.

    Raises:
        ValueError: if a count is negative.
    """
    if only_first < 0 or only_second < 0:
        raise ValueError(f"{min(only_first, only_second)} is no number of pairs")
    total = only_first + only_second
    if total == 0:
        return 1.0
    tail = float(stats.binom.cdf(min(only_first, only_second), total, 0.5))
    return min(1.0, 2.0 * tail)


def _probability(confidence: float) -> float:
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"a confidence of {confidence:g} is no probability between 0 and 1")
    return confidence
