"""The search for gains: CMA-ES on training scenes, with every generation kept so that it can go on later.

The same seed finds the same gains, whatever the number of workers and however often the search was stopped.
"""

import json
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cma
import numpy as np

from companion import __version__
from companion.control.followers.settings import FollowerSettings
from companion.errors import LogError
from sitl.abstract.settings import AbstractSettings
from sitl.campaign.conditions import Rules, Variant
from sitl.campaign.runner import Execute
from sitl.campaign.tasks import SceneTask
from sitl.swarm.record import TrialRecord
from sitl.swarm.settings import SwarmSettings
from sitl.tune.exam import Exam
from sitl.tune.space import axes_of, start_of, with_values

NEIGHBOURS = 12
_CONFIRMATION_FIRST = 100_000
_CONFIRMATION_TIMES = 4
_MAX_BYTES = 64 * 1024**2


@dataclass(frozen=True, slots=True)
class Found:
    """What a search came to.

    Attributes:
        follower: the settings with the best gains.
        score: of them, on scenes that the search has not seen.
        start_score: of the defaults on the same scenes.
        flown: their trials, part by part of the exam.
        evaluations: sets of gains that were flown in the search.
    """

    follower: FollowerSettings
    score: float
    start_score: float
    flown: tuple[tuple[TrialRecord, ...], ...]
    evaluations: int


class Examiner:
    """Flies exams."""

    def __init__(self, method: str, seed: int, execute: Execute) -> None:
        """Prepare for one law.

        Args:
            method: the law.
            seed: from which all scenes come.
            execute: does the flying.
        """
        self._method = method
        self._execute = execute
        self._rules = Rules(
            seed=seed,
            seeds="training",
            fidelity="abstract",
            swarm=SwarmSettings(),
            abstract=AbstractSettings.of("paper"),
            obstacle_distance_cap_m=4.0,
        )

    def fly(
        self, exam: Exam, followers: Sequence[FollowerSettings], first: int = 0
    ) -> list[list[list[TrialRecord]]]:
        """Fly an exam with several sets of gains in the same scenes.

        Args:
            exam: what to fly.
            followers: the sets.
            first: number of the first scene.

        Returns:
            The trials of every set, part by part.
        """
        variants = tuple(
            (str(number), Variant(method=self._method, observable_neighbours=NEIGHBOURS, follower=follower))
            for number, follower in enumerate(followers)
        )
        tasks = [
            SceneTask(self._rules, part.world, part.followers, (trial,), variants)
            for part in exam.parts
            for trial in range(first, first + part.scenes)
        ]
        places = {_place(part.world.name, part.followers): index for index, part in enumerate(exam.parts)}
        flown: list[list[list[TrialRecord]]] = [[[] for _ in exam.parts] for _ in followers]
        for records in self._execute(tasks):
            for record in records:
                flown[int(record.method)][places[_place(record.world, record.followers)]].append(record)
        for parts in flown:
            for trials in parts:
                trials.sort(key=_number)
        return flown


def search(
    examiner: Examiner,
    exam: Exam,
    method: str,
    *,
    budget: int,
    seed: int,
    journal: Path,
    on_progress: Callable[[int, float], None],
) -> Found:
    """Search for the gains of a law that do best in an exam.

    Args:
        examiner: flies it.
        exam: what counts.
        method: the law.
        budget: sets of gains to fly; the last generation is completed.
        seed: of the search.
        journal: file that keeps every generation; one of the same search is gone on from.
        on_progress: called with (sets flown so far, best score so far).

    Raises:
        LogError: if the journal holds another search.
    """
    axes, start = axes_of(method), start_of(method)
    known = _Journal(journal, _identity(exam, method, seed))
    rng = np.random.default_rng(seed)
    strategy = cma.CMAEvolutionStrategy(
        [axis.start for axis in axes],
        1.0,
        {
            "bounds": [[axis.low for axis in axes], [axis.high for axis in axes]],
            "CMA_stds": [axis.spread for axis in axes],
            # Random numbers come from our own generator: the library would seed NumPy's global one.
            "seed": math.nan,
            "randn": lambda *shape: rng.standard_normal(shape),
            "maxfevals": budget,
            "verbose": -9,
            "verb_log": 0,
        },
    )
    done, best, best_score = 0, start, math.inf
    while done < budget and not strategy.stop():
        asked = strategy.ask()
        followers = [with_values(start, method, axes, list(map(float, values))) for values in asked]
        scores = known.scores()
        if scores is None or len(scores) != len(asked):
            scores = [exam.score(parts) for parts in examiner.fly(exam, followers)]
            known.add(scores)
        strategy.tell(asked, scores)
        done += len(asked)
        leader = min(range(len(scores)), key=scores.__getitem__)
        if scores[leader] < best_score:
            best, best_score = followers[leader], scores[leader]
        on_progress(done, best_score)
    middle = with_values(start, method, axes, list(map(float, strategy.result.xfavorite)))
    return confirm(examiner, exam, [start, best, middle], done)


def confirm(examiner: Examiner, exam: Exam, followers: Sequence[FollowerSettings], evaluations: int) -> Found:
    """Return the best of a few sets of gains on many scenes that no search has seen.

    Args:
        examiner: flies the exam.
        exam: what counts; it is flown with several times its scenes.
        followers: the sets; the first is what the search started from.
        evaluations: sets that the search has flown.
    """
    longer = exam.with_scenes(_CONFIRMATION_TIMES)
    flown = examiner.fly(longer, followers, _CONFIRMATION_FIRST)
    scores = [longer.score(parts) for parts in flown]
    best = min(range(len(scores)), key=scores.__getitem__)
    return Found(
        follower=followers[best],
        score=scores[best],
        start_score=scores[0],
        flown=tuple(map(tuple, flown[best])),
        evaluations=evaluations,
    )


class _Journal:
    """Scores of the generations so far, one line each, below a line that says of which search."""

    def __init__(self, path: Path, identity: dict[str, Any]) -> None:
        """Read what is there.

        Raises:
            LogError: if it is of another search.
        """
        self._path = path
        self._left: list[list[float]] = []
        if not path.exists():
            self._append(identity)
            return
        if path.stat().st_size > _MAX_BYTES:
            raise LogError(f"{path}: larger than {_MAX_BYTES} bytes, which no search is")
        data = path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        try:
            lines = [json.loads(line) for line in whole.splitlines()]
            head, self._left = lines[0], [[float(score) for score in line["scores"]] for line in lines[1:]]
        except (ValueError, KeyError, TypeError, IndexError):
            raise LogError(f"{path}: not the journal of a search; remove it to start anew") from None
        if head != identity:
            raise LogError(f"{path}: holds another search; remove it or choose another --out")
        if len(whole) < len(data):
            with path.open("r+b") as file:
                file.truncate(len(whole))

    def scores(self) -> list[float] | None:
        """Return the scores of the next generation, None if it has not been flown."""
        return self._left.pop(0) if self._left else None

    def add(self, scores: list[float]) -> None:
        """Keep the scores of a generation."""
        self._append({"scores": scores})

    def _append(self, line: dict[str, Any]) -> None:
        with self._path.open("ab") as file:
            file.write(json.dumps(line, allow_nan=False).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())


def _identity(exam: Exam, method: str, seed: int) -> dict[str, Any]:
    return {
        "version": __version__,
        "method": method,
        "seed": seed,
        "exam": repr(exam),
        "command": start_of(method).command.model_dump(),
        "axes": [[axis.name, axis.start, axis.low, axis.high, axis.spread] for axis in axes_of(method)],
    }


def _place(world: str, followers: int) -> str:
    return f"{world} {followers}"


def _number(record: TrialRecord) -> int:
    return record.trial
