"""Judges a policy on fixed scenes: never those that it trains in, never those held out for tests.

All trials of a case fly side by side, so that one call of the network serves all of them; cases may fly in
several threads, and what comes of them does not depend on how many.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch

from companion.control.followers.settings import FollowerSettings
from companion.control.observation import CONTRACTS, Contract, Observation
from companion.messages import Float32Array
from sitl.abstract.course import Course
from sitl.abstract.flight import fly_abstract
from sitl.abstract.policy_flight import POLICY, Policy, PolicyStep
from sitl.abstract.settings import AbstractSettings, Preset
from sitl.abstract.trial import AbstractTrial, leader_course
from sitl.campaign.cases import CaseKey, CaseSummary, PairedComparison, compare_methods, summarise_case
from sitl.campaign.differences import Difference, metric_difference
from sitl.campaign.tasks import trial_seed
from sitl.swarm.record import TrialRecord
from sitl.swarm.scene import SwarmScene, set_scene
from sitl.swarm.settings import Behaviour, LeaderBehaviourSettings, SwarmSettings
from sitl.training.torch_threads import calm_threads

_SEED = 90_210
"""Scenes are drawn for this number and the names of their cases."""
_THIN_OUT = 0.6
"""Ended trials are taken out of the batch when fewer than this share still fly."""


@dataclass(frozen=True, slots=True)
class EvaluationCase:
    """One kind of scene.

    Attributes:
        name: in tables.
        site: one of the known sites.
        followers: how many.
        behaviour: of the leader.
        perception: errors, delays and flight.
        goal_distance_m: from the start.
    """

    name: str
    site: str
    followers: int = 4
    behaviour: Behaviour = "straight"
    perception: Preset = "paper"
    goal_distance_m: float = 30.0

    def scene(self, seed: int) -> SwarmScene:
        """Build one of its scenes."""
        leader = LeaderBehaviourSettings(behaviour=self.behaviour)
        swarm = SwarmSettings(followers=self.followers, leader=leader, goal_distance_m=self.goal_distance_m)
        return set_scene(swarm, self.site, seed)


CASES = (
    EvaluationCase("pillars_5m_8", "pillars_5m", 8),
    EvaluationCase("forest_4", "forest", 4),
    EvaluationCase("pillars_5m_4", "pillars_5m", 4),
    EvaluationCase("pillars_5m_4_reverse", "pillars_5m", 4, "reverse"),
    EvaluationCase("pillars_10m_4_mixed", "pillars_10m", 4, "mixed"),
    EvaluationCase("none_4", "none", 4),
)
"""What a training is judged by; those that take longest come first."""


@dataclass(frozen=True, slots=True)
class Evaluated:
    """What all cases came to.

    Attributes:
        records: of all trials, case by case; their worlds are the names of the cases.
        cases: the same summed up.
    """

    records: tuple[TrialRecord, ...]
    cases: tuple[CaseSummary, ...]

    @property
    def score(self) -> float:
        """One number for a policy, the higher the better: the mean over the cases.

        A point of success rate weighs as much as 0.2 m of flock radius or 0.05 of alignment; separation
        counts only below what is asked for.
        """
        return sum(_score(case) for case in self.cases) / len(self.cases)

    def numbers(self) -> dict[str, float]:
        """Return score, and SR, FR, MS and AL of every case, for a training's curve."""
        numbers = {"score": self.score}
        for case in self.cases:
            numbers[f"{case.world}_SR"] = case.SR
            for name in ("FR", "MS", "AL"):
                numbers[f"{case.world}_{name}"] = case.metric(name).mean
        return numbers

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for every case, with plain values."""
        return [case.as_dict() for case in self.cases]

    def differences(self, other: "Evaluated") -> list[dict[str, Difference]]:
        """Return FR, MS and AL minus another method's on the same scenes, case by case."""
        both = (*self.records, *other.records)
        return [
            {name: metric_difference(both, _key(ours), _key(theirs), name) for name in ("FR", "MS", "AL")}
            for ours, theirs in zip(self.cases, other.cases, strict=True)
        ]

    def against(self, other: "Evaluated") -> list[PairedComparison]:
        """Compare with another method on the same scenes, case by case."""
        both = (*self.records, *other.records)
        first, second = self.records[0].method, other.records[0].method
        return [
            compare_methods(
                both, first, second, world=case.world, followers=case.followers, fidelity="abstract"
            )
            for case in self.cases
        ]


class TorchPolicy:
    """A network that is still being trained, as abstract swarms know policies."""

    def __init__(self, module: torch.nn.Module, contract: Contract) -> None:
        """Take a module that maps named observations to velocities (batch, 3)."""
        calm_threads()
        self._module = module
        self._contract = contract

    @classmethod
    def of(cls, module: torch.nn.Module, contract: str) -> "TorchPolicy":
        """Take a module and the name of its contract."""
        return cls(module.eval(), CONTRACTS[contract])

    @property
    def contract(self) -> Contract:
        """What it wants to see."""
        return self._contract

    def velocities(self, observation: Observation) -> Float32Array:
        """Return (batch, 3) velocities in the heading frame, m/s."""
        with torch.inference_mode():
            inputs = {name: torch.from_numpy(array) for name, array in observation.inputs.items()}
            velocity: torch.Tensor = self._module(**inputs)
        said: Float32Array = velocity.float().numpy()
        return said


class Evaluation:
    """Fixed scenes, built once."""

    def __init__(
        self,
        trials: int,
        *,
        cases: Sequence[EvaluationCase] = CASES,
        follower: FollowerSettings | None = None,
        abstract: Callable[[Preset], AbstractSettings] = AbstractSettings.of,
        workers: int = 1,
        on_scene: Callable[[int, int], None] = lambda done, total: None,
    ) -> None:
        """Build the scenes.

        Args:
            trials: in each case.
            cases: kinds of scenes.
            follower: gains of the law beside the policy, and limits of commands.
            abstract: perception and motion under one of the known perceptions.
            workers: threads.
            on_scene: called with how many scenes are ready, of how many.
        """
        self._cases, self._follower, self._workers = tuple(cases), follower or FollowerSettings(), workers
        self._abstract = abstract
        self._scenes: list[list[tuple[SwarmScene, Course]]] = []
        for number, case in enumerate(self._cases):
            self._scenes.append([])
            for trial in range(trials):
                self._scenes[number].append(_scene(case, trial))
                on_scene(number * trials + trial + 1, trials * len(self._cases))

    def __call__(self, module: torch.nn.Module, contract: str = "best-2") -> Mapping[str, float]:
        """Judge a network for a training's curve; see `Evaluated.numbers`."""
        return self.judge(TorchPolicy.of(module, contract)).numbers()

    def judge(self, policy: Policy) -> Evaluated:
        """Fly all scenes with a policy."""
        return self._judged(partial(self._fly_case, policy))

    def judge_law(self, method: str) -> Evaluated:
        """Fly all scenes with a law alone."""
        return self._judged(partial(self._fly_case_by_law, method))

    def _judged(self, fly: Callable[[int], list[TrialRecord]]) -> Evaluated:
        numbers = range(len(self._cases))
        if self._workers == 1:
            flown = list(map(fly, numbers))
        else:
            with ThreadPoolExecutor(self._workers) as pool:
                flown = list(pool.map(fly, numbers))
        return Evaluated(
            records=tuple(record for records in flown for record in records),
            cases=tuple(summarise_case(records) for records in flown),
        )

    def _fly_case(self, policy: Policy, number: int) -> list[TrialRecord]:
        case = self._cases[number]
        settings = self._abstract(case.perception)
        trials = [
            AbstractTrial(scene, self._follower.method, self._follower, settings, course=course)
            for scene, course in self._scenes[number]
        ]
        fly_together(policy, trials)
        return [trial.result(POLICY, case.name, index).record for index, trial in enumerate(trials)]

    def _fly_case_by_law(self, method: str, number: int) -> list[TrialRecord]:
        case = self._cases[number]
        settings = self._abstract(case.perception)
        return [
            fly_abstract(
                scene, method, self._follower, settings, world_name=case.name, trial=index, course=course
            ).record
            for index, (scene, course) in enumerate(self._scenes[number])
        ]


def fly_together(policy: Policy, trials: Sequence[AbstractTrial]) -> None:
    """Fly trials side by side to their ends, with one call of the policy for a step of all of them."""
    flying = list(trials)
    while flying:
        step = PolicyStep(policy.contract, flying)
        enough = math.ceil(_THIN_OUT * len(flying))
        while sum(not trial.is_over for trial in flying) >= enough:
            step.begin()
            step.finish(policy.velocities(step.observation))
        flying = [trial for trial in flying if not trial.is_over]


def _scene(case: EvaluationCase, trial: int) -> tuple[SwarmScene, Course]:
    seed = trial_seed(_SEED, f"{case.site} {case.behaviour}", case.followers, trial, held_out=False)
    scene = case.scene(seed)
    return scene, leader_course(scene)


def _key(case: CaseSummary) -> CaseKey:
    return case.world, case.method, case.followers, case.fidelity


def _score(case: CaseSummary) -> float:
    radius, apart, aligned = (case.metric(name).mean for name in ("FR", "MS", "AL"))
    score = case.SR - 5.0 * radius - 30.0 * max(0.0, 1.45 - apart)
    return score + 20.0 * aligned if math.isfinite(aligned) else score
