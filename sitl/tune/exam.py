"""What gains are judged by: scenes to fly, and one number that says how well they were flown."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

from companion.errors import ProfileError
from sitl.campaign import paper_numbers as paper
from sitl.campaign.definition import WorldEntry
from sitl.swarm.record import TrialRecord
from sitl.swarm.settings import Behaviour
from sitl.worlds.sites import SITE_NAMES

TargetName = Literal["paper", "common"]

COLLISIONS = ("uav_uav", "leader_follower", "obstacle")
_FREE = WorldEntry(name="none")
_PUBLISHED_AS = {"vpf_polar": "vpf", "flock": paper.PROPOSED}
_WORST = 1e4
_CASE = re.compile(
    r"(?P<site>\w{1,40}):(?P<followers>\d{1,3})(:(?P<behaviour>[a-z]{1,20}))?(=(?P<weight>\d{1,6}(\.\d{1,6})?))?"
)
_BEHAVIOURS = frozenset(get_args(Behaviour))
_MOST_FOLLOWERS = 20
_GREATEST_WEIGHT = 1000.0


class NoTargetError(ProfileError):
    """The paper has no numbers for a method; the text says what to do."""


@dataclass(frozen=True, slots=True)
class Target:
    """What a swarm of five should look like in free space.

    Attributes:
        flock_radius_m: FR.
        minimum_separation_m: MS.
    """

    flock_radius_m: float
    minimum_separation_m: float


COMMON = Target(1.8, 1.5)


def target_of(method: str, name: TargetName) -> Target:
    """Return what a method is tuned to.

    Raises:
        NoTargetError: if that is the paper's row and there is none.
    """
    if name == "common":
        return COMMON
    row = _PUBLISHED_AS.get(method, method)
    radius, separation = (paper.COMPARISON.get((metric, row, "none")) for metric in ("FR", "MS"))
    if radius is None or separation is None:
        raise NoTargetError(f"the paper has no row for {method}: use --target common")
    return Target(radius.mean, separation.mean)


@dataclass(frozen=True, slots=True)
class Part:
    """One case of an exam.

    Attributes:
        world: where.
        followers: how many.
        scenes: how many.
        weight: of its failures; the weights of an exam need not add up to anything.
    """

    world: WorldEntry
    followers: int
    scenes: int
    weight: float


@dataclass(frozen=True, slots=True)
class Exam:
    """Everything that one set of gains has to fly.

    Attributes:
        parts: its cases.
        target: of the first part, which is free space with four followers.
        radius_scale_m, separation_scale_m: a deviation of so much from the target costs 1.
        collision_cost: of colliding in every scene of the first part.
        failure_cost: of failing in every scene of a part with weight 1.
        progress_cost: of no progress in any scene of such a part.
    """

    parts: tuple[Part, ...]
    target: Target
    radius_scale_m: float
    separation_scale_m: float
    collision_cost: float
    failure_cost: float
    progress_cost: float

    @property
    def scenes(self) -> int:
        """Number of scenes."""
        return sum(part.scenes for part in self.parts)

    def with_scenes(self, times: int) -> "Exam":
        """Return the exam with so many times the scenes."""
        parts = tuple(Part(p.world, p.followers, times * p.scenes, p.weight) for p in self.parts)
        return Exam(
            parts,
            self.target,
            self.radius_scale_m,
            self.separation_scale_m,
            self.collision_cost,
            self.failure_cost,
            self.progress_cost,
        )

    def score(self, flown: Sequence[Sequence[TrialRecord]]) -> float:
        """Return how well gains did, the smaller the better; always finite.

        Args:
            flown: the trials of every part, in its order.
        """
        free = flown[0]
        radius = _mean([trial.flock_radius_m for trial in free])
        separation = _mean([trial.minimum_separation_m for trial in free])
        total = ((radius - self.target.flock_radius_m) / self.radius_scale_m) ** 2
        total += ((separation - self.target.minimum_separation_m) / self.separation_scale_m) ** 2
        total += self.collision_cost * _mean([float(trial.end in COLLISIONS) for trial in free])
        for part, trials in zip(self.parts, flown, strict=True):
            failed = _mean([float(trial.end != "success") for trial in trials])
            missing = _mean([1.0 - 0.01 * trial.mission_progress_percent for trial in trials])
            total += part.weight * (self.failure_cost * failed + self.progress_cost * missing)
        return min(total, _WORST) if math.isfinite(total) else _WORST


def free_space_exam(target: Target, scenes: int) -> Exam:
    """Return the exam of other people's laws: flock radius, separation, collisions, success in free space."""
    return Exam((Part(_FREE, 4, scenes, 1.0),), target, 0.15, 0.05, 100.0, 20.0, 0.0)


def obstacle_exam(target: Target, scenes: int) -> Exam:
    """Return the exam of the gain for obstacles: as in free space, and success between pillars.

    They stand as sparse and as dense as where the paper trains: between sparse ones alone most followers meet
    none, and the gain that hinders the flock least wins. The forests are for tests only.
    """
    pillars = (Part(WorldEntry(name=name), 4, scenes, 5.0) for name in ("pillars_10m", "pillars_5m"))
    return Exam((Part(_FREE, 4, scenes, 1.0), *pillars), target, 0.15, 0.05, 100.0, 20.0, 2.0)


HARD_CASES = (
    "pillars_5m:4",
    "pillars_5m:10",
    "simplified_forest:4",
    "forest:4",
    "pillars_5m:4:hover=0.5",
    "pillars_5m:4:reverse=0.5",
    "pillars_5m:4:turn=0.5",
)
"""Where it is hard, and with leaders that hover, reverse and turn: what `flock` is examined in."""


def flock_exam(target: Target, scenes: int, cases: Sequence[str] = HARD_CASES) -> Exam:
    """Return the exam of our own law: free space, and success in several cases at once.

    Args:
        target: in free space.
        scenes: in each case; half as many in free space and in a case with less than weight 1.
        cases: `SITE:FOLLOWERS[:BEHAVIOUR][=WEIGHT]` each.

    Raises:
        ProfileError: if a case is not of this form, or is there twice.
    """
    half = -(-scenes // 2)
    parts = [Part(_FREE, 4, half, 1.0)]
    for case in cases:
        part = case_of(case, scenes)
        if any((part.world.name, part.followers) == (p.world.name, p.followers) for p in parts):
            raise ProfileError(f"case {case!r}: is there already")
        parts.append(replace(part, scenes=half) if part.weight < 1.0 else part)
    return Exam(tuple(parts), target, 0.5, 0.15, 100.0, 100.0, 20.0)


def case_of(text: str, scenes: int) -> Part:
    """Return the case that `SITE:FOLLOWERS[:BEHAVIOUR][=WEIGHT]` stands for.

    Raises:
        ProfileError: if it is not of this form; one sentence that says what is wrong.
    """
    matched = _CASE.fullmatch(text)
    if matched is None:
        raise ProfileError(
            f"case {text!r}: must be SITE:FOLLOWERS[:BEHAVIOUR][=WEIGHT], such as pillars_5m:10=2"
        )
    site, followers, kind = matched["site"], int(matched["followers"]), matched["behaviour"]
    weight = float(matched["weight"] or 1.0)
    if site not in SITE_NAMES:
        raise ProfileError(f"case {text!r}: there is no site {site!r}; there are {', '.join(SITE_NAMES)}")
    if kind is not None and kind not in _BEHAVIOURS:
        raise ProfileError(
            f"case {text!r}: no leader behaves {kind!r}; there are {', '.join(sorted(_BEHAVIOURS))}"
        )
    if not 1 <= followers <= _MOST_FOLLOWERS:
        raise ProfileError(f"case {text!r}: {followers} followers; 1 to {_MOST_FOLLOWERS} are allowed")
    if not 0.0 < weight <= _GREATEST_WEIGHT:
        raise ProfileError(
            f"case {text!r}: weight {weight:g}; it must be above 0 and up to {_GREATEST_WEIGHT:g}"
        )
    if kind is None:
        return Part(WorldEntry(name=site), followers, scenes, weight)
    world = WorldEntry.model_validate({"name": f"{site}_{kind}", "site": site, "behaviour": kind})
    return Part(world, followers, scenes, weight)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan
