import json
import math

import pytest

from sitl.campaign.cases import compare_all, compare_methods, summarise, summarise_case
from tests.sitl.campaign.made_up_trials import campaign, trial

KEYS = [
    "world", "method", "followers", "fidelity", "trials", "SR", "SR_ci95",
    "MP", "FR", "MS", "AL", "MDO", "failures",
]  # fmt: skip


def test_a_case_is_summed_up_by_hand() -> None:
    trials = [
        trial(0, FR=1.0, MDO=2.0),
        trial(1, "obstacle", MP=20.0, FR=2.0, MDO=math.nan),
        trial(2, "uav_uav", MP=60.0, FR=3.0, AL=math.nan, MDO=1.0),
        trial(3, "obstacle", MP=40.0, FR=4.0, MDO=math.nan),
    ]
    row = summarise_case(trials).as_dict()
    assert row["SR"] == pytest.approx(25.0)
    assert row["SR_ci95"] == pytest.approx([4.56, 69.94], abs=0.01)
    assert row["MP"] == pytest.approx((100 + 20 + 60 + 40) / 4)
    assert row["FR"] == pytest.approx(2.5)
    assert row["FR_sd"] == pytest.approx(math.sqrt(5.0 / 3.0))
    assert row["AL"] == pytest.approx(0.94)
    assert row["MDO"] == pytest.approx(1.5)
    assert row["failures"] == {
        "uav_uav": 1, "leader_follower": 0, "obstacle": 2, "altitude": 0,
        "leader_lost": 0, "scattered": 0, "timeout": 0, "failsafe": 0,
    }  # fmt: skip
    assert sum(row["failures"].values()) + row["successes"] == row["trials"] == 4


def test_a_row_has_the_agreed_keys_first_and_is_json() -> None:
    row = summarise(campaign(worlds=("none",)))[0].as_dict()
    assert list(row)[: len(KEYS)] == KEYS
    assert row["MDO"] is None
    assert row["MDO_sd"] is None
    assert row["world"] == "none"
    json.dumps(row, allow_nan=False)


def test_the_order_of_trials_changes_nothing_and_cases_keep_theirs() -> None:
    records = campaign()
    assert [case.key for case in summarise(records)] == [
        (world, method, 4, "abstract")
        for world in ("none", "pillars_10m", "pillars_5m")
        for method in ("pacnav", "flock")
    ]
    forwards = {case.key: repr(case) for case in summarise(records)}
    backwards = {case.key: repr(case) for case in summarise(records[::-1])}
    assert forwards == backwards


def test_what_is_no_case_is_refused() -> None:
    with pytest.raises(ValueError, match="trials of 0 cases"):
        summarise_case([])
    with pytest.raises(ValueError, match="trials of 2 cases"):
        summarise_case([trial(0), trial(1, world="none")])
    with pytest.raises(ValueError, match="there twice"):
        summarise_case([trial(0), trial(0)])


def test_methods_are_compared_in_common_scenes_only() -> None:
    records = [
        *(trial(n, "success" if n != 3 else "obstacle") for n in range(6)),
        *(trial(n, "success" if n < 2 else "timeout", method="vpf") for n in range(5)),
        trial(9, method="vpf"),
    ]
    # Trial 4 of the second method flew in another scene: it has no partner.
    records = [
        trial(4, "timeout", method="vpf", scene="another") if r.method == "vpf" and r.trial == 4 else r
        for r in records
    ]
    found = compare_methods(records, "flock", "vpf", world="pillars_5m", followers=4, fidelity="abstract")
    assert (found.pairs, found.both, found.only_first, found.only_second, found.neither) == (4, 2, 1, 0, 1)
    assert found.unpaired == 4
    assert found.difference_percent == pytest.approx(25.0)
    assert found.p == 1.0


def test_a_clear_difference_has_a_small_p_and_its_sign_follows_the_order() -> None:
    records = [trial(n) for n in range(20)] + [trial(n, "obstacle", method="vpf") for n in range(20)]
    case = {"world": "pillars_5m", "followers": 4, "fidelity": "abstract"}
    found = compare_methods(records, "flock", "vpf", **case)  # type: ignore[arg-type]
    turned = compare_methods(records, "vpf", "flock", **case)  # type: ignore[arg-type]
    assert found.p == turned.p == pytest.approx(2.0**-19)
    assert found.difference_percent == -turned.difference_percent == 100.0


def test_methods_without_a_common_scene_are_not_compared() -> None:
    assert compare_all([trial(0), trial(0, method="vpf", scene="other")]) == []
    nothing = compare_methods([], "flock", "vpf", world="none", followers=4, fidelity="abstract")
    assert nothing.pairs == 0
    assert nothing.as_dict()["difference_percent"] is None


def test_every_two_methods_are_compared_in_every_world() -> None:
    pairs = compare_all(campaign(methods=("pacnav", "vpf", "flock")))
    assert len(pairs) == 3 * 3
    assert all(pair.pairs == 20 for pair in pairs)
