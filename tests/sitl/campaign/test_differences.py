import math

import pytest
from scipy import stats

from sitl.campaign.cases import CaseKey
from sitl.campaign.differences import metric_difference
from tests.sitl.campaign.made_up_trials import trial

OURS: CaseKey = ("pillars_5m", "policy", 4, "abstract")
LAW: CaseKey = ("pillars_5m", "flock", 4, "abstract")


def test_metrics_are_compared_on_common_scenes_alone() -> None:
    ours, theirs = [1.5, 1.4, 1.8, 1.2, 9.0], [1.7, 1.5, 1.7, 1.6]
    records = [trial(k, method="policy", FR=value) for k, value in enumerate(ours)]
    records += [trial(k, FR=value) for k, value in enumerate(theirs)]
    records.append(trial(0, world="none", FR=50.0))
    found = metric_difference(records, OURS, LAW, "FR")
    assert found.pairs == 4
    assert found.mean == pytest.approx(-0.15)
    assert found.p == pytest.approx(float(stats.ttest_rel(ours[:4], theirs).pvalue))


def test_other_scenes_of_the_same_number_are_no_pair() -> None:
    records = [trial(0, method="policy", scene="a"), trial(0, scene="b")]
    found = metric_difference(records, OURS, LAW, "FR")
    assert (found.pairs, math.isnan(found.mean), math.isnan(found.p)) == (0, True, True)
    assert found.as_dict() == {"mean": None, "p": None, "pairs": 0}


def test_what_never_differs_is_no_difference() -> None:
    records = [trial(k, method=name, MS=1.5) for name in ("policy", "flock") for k in range(3)]
    found = metric_difference(records, OURS, LAW, "MS")
    assert (found.mean, found.p) == (0.0, 1.0)
