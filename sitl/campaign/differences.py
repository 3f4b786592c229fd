"""How far the metrics of two methods are apart on the scenes that both have flown."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy import stats

from sitl.campaign.cases import MEANS, CaseKey
from sitl.swarm.record import TrialRecord


@dataclass(frozen=True, slots=True)
class Difference:
    """Means of one metric over common scenes.

    Attributes:
        mean: of the first method minus the second; NaN without common scenes.
        p: two-sided, of the paired t test; NaN for less than two scenes, 1 where nothing differs.
        pairs: scenes in which both have a value.
    """

    mean: float
    p: float
    pairs: int

    def as_dict(self) -> dict[str, float | None]:
        """Return plain values for JSON, None for what is not a number."""
        values = asdict(self)
        return {name: value if math.isfinite(value) else None for name, value in values.items()}


def metric_difference(
    records: Sequence[TrialRecord], first: CaseKey, second: CaseKey, metric: str
) -> Difference:
    """Compare a metric of two cases over the scenes that both have flown.

    Args:
        records: trials of both cases, others besides.
        first: key of one case.
        second: key of the other.
        metric: its name in `MEANS`.
    """
    ours, theirs = (_values(records, key, MEANS[metric]) for key in (first, second))
    apart = np.array([ours[scene] - theirs[scene] for scene in ours if scene in theirs])
    apart = apart[np.isfinite(apart)]
    if len(apart) < 2:
        return Difference(float(apart.mean()) if len(apart) else math.nan, math.nan, len(apart))
    spread = float(apart.std(ddof=1))
    mean = float(apart.mean())
    if spread == 0.0:
        return Difference(mean, 1.0 if mean == 0.0 else 0.0, len(apart))
    t = mean / (spread / math.sqrt(len(apart)))
    return Difference(mean, 2.0 * float(stats.t.sf(abs(t), len(apart) - 1)), len(apart))


def _values(records: Sequence[TrialRecord], key: CaseKey, field: str) -> dict[tuple[int, str], float]:
    return {
        (record.trial, record.scene_hash): getattr(record, field)
        for record in records
        if (record.world, record.method, record.followers, record.fidelity) == key
    }
