import math
from dataclasses import replace

import numpy as np
import pytest

from sitl.abstract.policy_flight import POLICY
from sitl.training.evaluation import CASES, Evaluated, Evaluation, TorchPolicy
from sitl.worlds.seeds import is_held_out
from tests.sitl.training.small_policy import NEAR, policy


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    return Evaluation(2, cases=NEAR)


@pytest.fixture(scope="module")
def flown(evaluation: Evaluation) -> Evaluated:
    return evaluation.judge(TorchPolicy.of(policy(0.05), "best-2"))


def test_flock_as_a_network_is_judged_like_flock(evaluation: Evaluation) -> None:
    network, law = evaluation.judge(TorchPolicy.of(policy(), "best-2")), evaluation.judge_law("flock")
    assert [record.end for record in network.records] == [record.end for record in law.records]
    assert network.score == pytest.approx(law.score, abs=0.5)
    pairs = network.against(law)
    assert [(pair.world, pair.first, pair.second, pair.pairs) for pair in pairs] == [
        ("near_2", POLICY, "flock", 2),
        ("near_4", POLICY, "flock", 2),
    ]
    for case, ours, theirs in zip(network.differences(law), network.cases, law.cases, strict=True):
        assert {name: each.pairs for name, each in case.items()} == {"FR": 2, "MS": 2, "AL": 2}
        assert case["FR"].mean == pytest.approx(ours.metric("FR").mean - theirs.metric("FR").mean)


def test_scenes_are_never_those_held_out_nor_those_of_training(flown: Evaluated) -> None:
    seeds = [record.seed for record in flown.records]
    assert not any(map(is_held_out, seeds))
    assert min(seeds) > 1_000_000, "scenes of a training are numbered from its first one on"
    assert len(set(seeds)) == len(seeds) == 4


def test_threads_change_nothing(flown: Evaluated) -> None:
    again = Evaluation(2, cases=NEAR, workers=2).judge(TorchPolicy.of(policy(0.05), "best-2"))
    assert repr(again) == repr(flown)


def test_a_curve_gets_every_case_and_one_score(evaluation: Evaluation, flown: Evaluated) -> None:
    numbers = evaluation(policy(0.05))
    assert numbers == flown.numbers()
    assert next(iter(numbers)) == "score"
    assert {f"{case.name}_{name}" for case in NEAR for name in ("SR", "FR", "MS", "AL")} < set(numbers)
    assert np.isfinite(list(numbers.values())).all()


def test_the_score_rises_with_what_is_asked_for(flown: Evaluated) -> None:
    def scored(**changes: float) -> float:
        cases = []
        for case in flown.cases:
            changed = replace(case, SR=changes.get("SR", case.SR))
            fr, ms, al = (replace(case.metric(name), mean=changes[name]) for name in ("FR", "MS", "AL"))
            cases.append(replace(changed, FR=fr, MS=ms, AL=al))
        return replace(flown, cases=tuple(cases)).score

    plain = scored(SR=90.0, FR=1.6, MS=1.5, AL=0.9)
    assert scored(SR=91.0, FR=1.6, MS=1.5, AL=0.9) == pytest.approx(plain + 1.0)
    assert scored(SR=90.0, FR=1.4, MS=1.5, AL=0.9) == pytest.approx(plain + 1.0)
    assert scored(SR=90.0, FR=1.6, MS=1.5, AL=0.95) == pytest.approx(plain + 1.0)
    assert scored(SR=90.0, FR=1.6, MS=1.35, AL=0.9) == pytest.approx(plain - 3.0)
    assert scored(SR=90.0, FR=1.6, MS=1.5, AL=math.nan) == pytest.approx(plain - 18.0)


def test_trainings_are_judged_in_crowds_and_forests_too() -> None:
    assert max(case.followers for case in CASES) == 8
    assert {"forest", "none", "pillars_5m"} <= {case.site for case in CASES}
    assert any(case.behaviour != "straight" for case in CASES)
