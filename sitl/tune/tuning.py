"""The whole tuning of one law: search, confirmation, and for the laws of others one gain between pillars."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from companion.control.followers.settings import with_gains
from companion.errors import ProfileError
from sitl.campaign.runner import Execute
from sitl.swarm.record import TrialRecord
from sitl.tune.exam import (
    HARD_CASES,
    Exam,
    TargetName,
    flock_exam,
    free_space_exam,
    obstacle_exam,
    target_of,
)
from sitl.tune.search import Examiner, Found, search
from sitl.tune.space import OBSTACLE_GAIN, obstacle_values

_OBSTACLE_VALUES = 9
_OBSTACLE_FIRST = 200_000
_OBSTACLE_TIMES = 8


@dataclass(frozen=True, slots=True)
class Tuned:
    """Gains, and how well they do.

    Attributes:
        found: what the search came to; its gains against obstacles are chosen too.
        exam: by which the score is counted.
    """

    found: Found
    exam: Exam

    @property
    def free(self) -> list[TrialRecord]:
        """The confirming trials in free space with four followers."""
        return list(self.found.flown[0])


def tune(
    method: str,
    target: TargetName,
    *,
    budget: int,
    scenes: int,
    seed: int,
    journal: Path,
    execute: Execute,
    on_progress: Callable[[int, float], None],
    cases: Sequence[str] = (),
) -> Tuned:
    """Tune the gains of a law on training scenes.

    The laws of others are tuned in free space to a flock radius and a separation, and then their one gain
    against obstacles between pillars. `flock` is tuned to succeed where it is hard.

    Args:
        method: the law.
        target: whose flock radius and separation.
        budget: sets of gains that the search flies.
        scenes: for each of them in each world.
        seed: of scenes and search.
        journal: keeps every generation of the search.
        execute: does the flying.
        on_progress: called with (sets flown so far, best score so far).
        cases: what `flock` has to fly instead of its own cases, see `case_of`.

    Raises:
        ProfileError: if a case is wrong, or another law is to fly cases.
        NoTargetError: if the paper has no row for the law.
        LogError: if the journal holds another search.
    """
    aim = target_of(method, target)
    if cases and method != "flock":
        raise ProfileError(f"cases are for flock; {method} is tuned in free space, then between pillars")
    exam = flock_exam(aim, scenes, cases or HARD_CASES) if method == "flock" else free_space_exam(aim, scenes)
    examiner = Examiner(method, seed, execute)
    found = search(examiner, exam, method, budget=budget, seed=seed, journal=journal, on_progress=on_progress)
    if method not in OBSTACLE_GAIN:
        return Tuned(found, exam)
    # One gain among few: many scenes tell neighbouring values apart, which a search need not.
    between = obstacle_exam(aim, scenes).with_scenes(_OBSTACLE_TIMES)
    now = getattr(getattr(found.follower, method), OBSTACLE_GAIN[method])
    values = list(dict.fromkeys([now, *obstacle_values(method, found.follower, _OBSTACLE_VALUES)]))
    tried = [with_gains(found.follower, method, {OBSTACLE_GAIN[method]: value}) for value in values]
    flown = examiner.fly(between, tried, _OBSTACLE_FIRST)
    scores = [between.score(parts) for parts in flown]
    best = min(range(len(scores)), key=scores.__getitem__)
    chosen = replace(
        found,
        follower=tried[best],
        score=scores[best],
        start_score=scores[0],
        flown=tuple(map(tuple, flown[best])),
    )
    return Tuned(chosen, between)
