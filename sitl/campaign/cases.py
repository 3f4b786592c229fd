"""Trials summed up: a row for every world, method, swarm size and fidelity; methods beside each other."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from itertools import combinations
from typing import Any, get_args

from companion.logs.metrics import success_rate_percent
from sitl.campaign.conditions import AT
from sitl.campaign.statistics import Mean, mcnemar_exact, mean_interval, wilson_interval
from sitl.swarm.record import End, Fidelity, TrialRecord

SUCCESS: End = "success"
FAILURES: tuple[End, ...] = tuple(end for end in get_args(End) if end != SUCCESS)
MEANS = {
    "MP": "mission_progress_percent",
    "FR": "flock_radius_m",
    "MS": "minimum_separation_m",
    "AL": "alignment",
    "MDO": "obstacle_distance_m",
}
"""The averaged metrics and the fields of a trial that hold them."""

CaseKey = tuple[str, str, int, Fidelity]


@dataclass(frozen=True, slots=True)
class CaseSummary:
    """What the trials of one case came to.

    Attributes:
        trials: how many.
        successes: how many of them succeeded.
        SR: success rate, percent.
        SR_ci95: its 95 % Wilson interval, percent.
        MP: mission progress over all trials, percent, failed ones included; so are the others.
        FR, MS: flock radius and minimum separation, m.
        AL: alignment, over the trials in which anybody moved.
        MDO: minimum distance to obstacles, m, over the trials in which any was within the cap.
        failures: how many trials ended in which other way; every way is listed.
    """

    world: str
    method: str
    followers: int
    fidelity: Fidelity
    trials: int
    successes: int
    SR: float
    SR_ci95: tuple[float, float]
    MP: Mean
    FR: Mean
    MS: Mean
    AL: Mean
    MDO: Mean
    failures: dict[str, int]

    @property
    def key(self) -> CaseKey:
        """What tells this case from the others."""
        return (self.world, self.method, self.followers, self.fidelity)

    def metric(self, name: str) -> Mean:
        """Return one of the averaged metrics by its name in `MEANS`."""
        value: Mean = getattr(self, name)
        return value

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: means as numbers, their spread and interval in keys of their own.

        None stands where there is no such number.
        """
        row: dict[str, Any] = {
            "world": self.world,
            "method": self.method,
            "followers": self.followers,
            "fidelity": self.fidelity,
            "trials": self.trials,
            "SR": self.SR,
            "SR_ci95": list(self.SR_ci95),
        }
        row |= {name: _plain(self.metric(name).mean) for name in MEANS}
        perception = self.method.partition(AT)[2]
        if perception:
            row["perception"] = perception
        row["failures"] = dict(self.failures)
        row["successes"] = self.successes
        row |= {f"{name}_sd": _plain(self.metric(name).sd) for name in MEANS}
        row |= {
            f"{name}_ci95": [_plain(self.metric(name).low), _plain(self.metric(name).high)] for name in MEANS
        }
        return row


@dataclass(frozen=True, slots=True)
class PairedComparison:
    """Two methods on the same scenes.

    Attributes:
        pairs: trials that both flew, in one and the same scene each.
        unpaired: trials of one method that have no partner, or one in another scene.
        both, only_first, only_second, neither: in how many pairs which of them succeeded.
        difference_percent: success rate of the first minus that of the second, over the pairs.
        p: two-sided, of McNemar's exact test.
    """

    world: str
    followers: int
    fidelity: Fidelity
    first: str
    second: str
    pairs: int
    unpaired: int
    both: int
    only_first: int
    only_second: int
    neither: int
    difference_percent: float
    p: float

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {field.name: _plain(getattr(self, field.name)) for field in fields(self)}


def by_case(records: Iterable[TrialRecord]) -> dict[CaseKey, list[TrialRecord]]:
    """Return the trials of every case in the order of their numbers; cases in order of appearance."""
    cases: dict[CaseKey, list[TrialRecord]] = {}
    for record in records:
        key = (record.world, record.method, record.followers, record.fidelity)
        cases.setdefault(key, []).append(record)
    return {key: sorted(trials, key=lambda trial: trial.trial) for key, trials in cases.items()}


def summarise_case(trials: Sequence[TrialRecord]) -> CaseSummary:
    """Sum up the trials of one case.

    Raises:
        ValueError: if there is none, they are not all of one case, or one of them is there twice.
    """
    cases = by_case(trials)
    if len(cases) != 1:
        raise ValueError(f"trials of {len(cases)} cases cannot be summed up as one")
    [((world, method, followers, fidelity), ordered)] = cases.items()
    if len({trial.trial for trial in ordered}) != len(ordered):
        raise ValueError(f"a trial of {method} in {world} is there twice")
    count = len(ordered)
    successes = sum(trial.end == SUCCESS for trial in ordered)
    low, high = wilson_interval(successes, count)
    means = {
        name: mean_interval([getattr(trial, field) for trial in ordered]) for name, field in MEANS.items()
    }
    return CaseSummary(
        world=world,
        method=method,
        followers=followers,
        fidelity=fidelity,
        trials=count,
        successes=successes,
        SR=success_rate_percent(successes, count),
        SR_ci95=(100.0 * low, 100.0 * high),
        failures={end: sum(trial.end == end for trial in ordered) for end in FAILURES},
        **means,
    )


def summarise(records: Iterable[TrialRecord]) -> list[CaseSummary]:
    """Sum up all trials, one summary a case, in the order in which cases first appear."""
    return [summarise_case(trials) for trials in by_case(records).values()]


def compare_methods(
    records: Iterable[TrialRecord], first: str, second: str, *, world: str, followers: int, fidelity: Fidelity
) -> PairedComparison:
    """Compare two methods trial by trial where both flew in the same scene.

    Trials are partners if their numbers and the digests of their scenes agree.
    """
    cases = by_case(records)
    ours, theirs = (
        cases.get((world, first, followers, fidelity), []),
        cases.get((world, second, followers, fidelity), []),
    )
    return _compare((world, followers, fidelity), (first, ours), (second, theirs))


def compare_all(records: Iterable[TrialRecord]) -> list[PairedComparison]:
    """Compare every two methods that flew in common scenes, in the order in which they first appear."""
    groups: dict[tuple[str, int, Fidelity], list[tuple[str, list[TrialRecord]]]] = {}
    for (world, method, followers, fidelity), trials in by_case(records).items():
        groups.setdefault((world, followers, fidelity), []).append((method, trials))
    pairs = [
        _compare(group, first, second)
        for group, methods in groups.items()
        for first, second in combinations(methods, 2)
    ]
    return [pair for pair in pairs if pair.pairs]


def _compare(
    group: tuple[str, int, Fidelity],
    first: tuple[str, Sequence[TrialRecord]],
    second: tuple[str, Sequence[TrialRecord]],
) -> PairedComparison:
    ours, theirs = (
        {(trial.trial, trial.scene_hash): trial.end == SUCCESS for trial in trials}
        for _, trials in (first, second)
    )
    pairs = [(ours[scene], theirs[scene]) for scene in ours if scene in theirs]
    only_first, only_second = pairs.count((True, False)), pairs.count((False, True))
    world, followers, fidelity = group
    return PairedComparison(
        world=world,
        followers=followers,
        fidelity=fidelity,
        first=first[0],
        second=second[0],
        pairs=len(pairs),
        unpaired=len(ours) + len(theirs) - 2 * len(pairs),
        both=pairs.count((True, True)),
        only_first=only_first,
        only_second=only_second,
        neither=pairs.count((False, False)),
        difference_percent=100.0 * (only_first - only_second) / len(pairs) if pairs else math.nan,
        p=mcnemar_exact(only_first, only_second),
    )


def _plain(value: Any) -> Any:
    """Return None instead of a number that JSON does not know."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
