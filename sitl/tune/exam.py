"""What gains are judged by: scenes to fly, and one number that says how well they were flown."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from companion.errors import ProfileError
from sitl.campaign import paper_numbers as paper
from sitl.campaign.definition import WorldEntry
from sitl.swarm.record import TrialRecord

TargetName = Literal["paper", "common"]

COLLISIONS = ("uav_uav", "leader_follower", "obstacle")
_FREE = WorldEntry(name="none")
_PUBLISHED_AS = {"vpf_polar": "vpf", "flock": paper.PROPOSED}
_WORST = 1e4


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
    """Return the exam of the gain for obstacles: as in free space, and success between sparse pillars."""
    sparse = Part(WorldEntry(name="pillars_10m"), 4, scenes, 5.0)
    return Exam((Part(_FREE, 4, scenes, 1.0), sparse), target, 0.15, 0.05, 100.0, 20.0, 2.0)


def flock_exam(target: Target, scenes: int) -> Exam:
    """Return the exam of our own law: success where it is hard, with leaders that hover, reverse and turn."""
    dense, ten = "pillars_5m", 10
    hard = (
        Part(WorldEntry(name=dense), 4, scenes, 1.0),
        Part(WorldEntry(name=dense), ten, scenes, 1.0),
        Part(WorldEntry(name="simplified_forest"), 4, scenes, 1.0),
        Part(WorldEntry(name="forest"), 4, scenes, 1.0),
        *(
            Part(WorldEntry(name=f"{dense}_{kind}", site=dense, behaviour=kind), 4, -(-scenes // 2), 0.5)
            for kind in ("hover", "reverse", "turn")
        ),
    )
    free = Part(_FREE, 4, -(-scenes // 2), 1.0)
    return Exam((free, *hard), target, 0.5, 0.15, 100.0, 100.0, 20.0)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan
