"""The swarm as a vector environment: every follower of every swarm is a stream of its own."""

import copy
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.random import SeedSequence
from numpy.typing import NDArray

from companion.control.observation import CONTRACTS
from companion.kernel_cache import forget_stale
from companion.messages import Float32Array
from sitl.abstract.judging_kernels import (
    ALIGNED,
    ALIGNMENT,
    ENDS,
    FLOCK_RADIUS,
    FLYING,
    SAMPLES,
    SEPARATION,
    SUCCESS,
    TIMEOUT,
)
from sitl.abstract.settings import CONTROL_STEP_S
from sitl.training import batch_layout_kernels as at
from sitl.training.cohort import Cohort
from sitl.training.conditions import ConditionsSource
from sitl.training.crash_replay import CrashReplay, begin_again
from sitl.training.environment_kernels import begin_swarms, step_swarms
from sitl.training.environment_results import EpisodeSummary, Observation, State, StepResult
from sitl.training.environment_settings import EnvironmentSettings
from sitl.training.grid_tables import grid_tables
from sitl.training.reward_settings import TERMS
from sitl.training.scene_bank import SceneBank

__all__ = [
    "TERMS", "EnvironmentSettings", "EpisodeSummary", "Observation", "SceneBank", "State", "StepResult",
    "SwarmBatch",
]  # fmt: skip

_PIECES_PER_WORKER = 3


class SwarmBatch:
    """Many swarms at once: `reset` begins, `step` flies one control step of 0.05 s with given velocities.

    Attributes:
        settings: what it is made of.
        contract: name of the observations' contract.
        streams: K, how many followers there are.
        bank: the scenes.
        swarm_of: (K,) number of the swarm of each stream.
        observation: the newest.
        cohorts: the swarms, by size.
        sites: obstacles and leaders' flights of all scenes, as the kernels read them.
        rays: tables of the grid, likewise.
    """

    def __init__(
        self,
        settings: EnvironmentSettings,
        contract: str,
        seed: int,
        workers: int = 1,
        *,
        bank: SceneBank | None = None,
        on_scene: Callable[[int, int], None] | None = None,
    ) -> None:
        """Build all scenes and take the memory.

        Args:
            settings: swarms, scenes and rules.
            contract: `paper-1` or `best-2`.
            seed: everything random comes from it; results do not depend on `workers`.
            workers: threads.
            bank: scenes that are built already, from settings that agree.
            on_scene: called with how many scenes are built, of how many.

        Raises:
            KeyError: if there is no such contract.
        """
        # Kernels of yesterday would teach how to fly in yesterday's world.
        forget_stale(("sitl",))
        self.settings, self.contract = settings, contract
        self._number = CONTRACTS[contract].number
        self.bank = bank if bank is not None else SceneBank.build(settings, on_scene)
        sizes = [settings.followers[k % len(settings.followers)] for k in range(settings.swarms)]
        first_streams = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        self.streams = int(first_streams[-1])
        self.swarm_of: NDArray[np.int64] = np.repeat(np.arange(len(sizes)), sizes)
        self.observation = Observation.room(contract, self.streams)
        self._result = StepResult.room(self.observation, self.streams)
        self.cohorts: list[Cohort] = []
        for followers in sorted(set(sizes), reverse=True):
            numbers = np.flatnonzero(np.array(sizes) == followers).astype(np.int64)
            self.cohorts.append(
                Cohort.room(
                    settings, followers + 1, numbers, first_streams[numbers], self.bank.most_primitives
                )
            )
        self._scenes = [self.bank.for_swarm(cohort.vehicles) for cohort in self.cohorts]
        self._crashes = [CrashReplay(settings.replay) for _ in self.cohorts]
        self._scene_of = np.zeros(len(sizes), np.int64)
        self._replayed = np.zeros(len(sizes), np.bool_)
        self._begun_at = np.zeros(len(sizes), np.int64)
        self._conditions = ConditionsSource(settings)
        self._law = settings.follower.packed("flock")
        self._numbers = settings.reward.packed(settings.swarm.termination.vehicle_radius_m)
        self._weights = settings.reward.weights
        self._seed = seed
        self._rng = np.random.default_rng(SeedSequence(seed))
        self.sites = (self.bank.kinds, self.bank.rows, self.bank.discs, self.bank.flights)
        self.rays = grid_tables(settings)
        seen = self.observation
        self._shown = (
            seen.ego, seen.neighbours, seen.grid, seen.memory, seen.privileged, seen.reference,
        )  # fmt: skip
        paid = self._result
        self._paid = (paid.terms, paid.reward, paid.terminated.view(np.uint8), paid.truncated.view(np.uint8))
        self._showing = at.SHOW_ALL
        self._workers = workers
        self._pool = ThreadPoolExecutor(workers) if workers > 1 else None

    def reset(self, update: int = 0) -> Observation:
        """Begin all trials anew; for equal numbers equal batches begin alike.

        A run that was interrupted after update k may go on with `reset(k)`, or exactly as it would have with
        `restore`. Stored crashes are forgotten.

        Args:
            update: not negative; another number gives other trials.
        """
        self._rng = np.random.default_rng(SeedSequence((self._seed, update)))
        self._crashes = [CrashReplay(self.settings.replay) for _ in self.cohorts]
        for index, cohort in enumerate(self.cohorts):
            self._begin(index, np.arange(len(cohort)))
        self._showing = at.SHOW_CHANGES
        self._stagger()
        return self.observation

    def step(self, velocity: Float32Array, *, is_shown: bool = True) -> StepResult:
        """Fly on.

        Args:
            velocity: (K, 3) what each follower wants to fly, heading frame, m/s, before limits.
            is_shown: whether anybody looks at the observation; if not, only its `reference` is of the new
                state. What is shown later does not depend on it.

        Raises:
            ValueError: if the shape is another.
        """
        if velocity.shape != (self.streams, 3):
            raise ValueError(f"velocity is {velocity.shape}, expected {(self.streams, 3)}")
        self._show(is_shown)
        self._fly(np.ascontiguousarray(velocity, np.float32), [0] * len(self.cohorts))
        self._result.finished.clear()
        self._result.finished.extend(self._end_and_begin())
        return self._result

    def state(self) -> State:
        """Return everything it needs to go on exactly as it would have; tens of megabytes."""
        return {
            "cohorts": [
                [[array.copy() for array in group] for group in _groups(cohort)] for cohort in self.cohorts
            ],
            "crashes": [crashes.state() for crashes in self._crashes],
            "scene_of": self._scene_of.copy(),
            "replayed": self._replayed.copy(),
            "begun_at": self._begun_at.copy(),
            "rng": copy.deepcopy(self._rng.bit_generator.state),
            "shown": [array.copy() for array in self._shown],
        }

    def restore(self, state: State) -> Observation:
        """Go on from what `state` of an equal batch returned."""
        for cohort, groups in zip(self.cohorts, state["cohorts"], strict=True):
            for group, stored in zip(_groups(cohort), groups, strict=True):
                for array, kept in zip(group, stored, strict=True):
                    array[...] = kept
        for crashes, kept in zip(self._crashes, state["crashes"], strict=True):
            crashes.restore(kept)
        for array, name in (
            (self._scene_of, "scene_of"),
            (self._replayed, "replayed"),
            (self._begun_at, "begun_at"),
        ):
            array[...] = state[name]
        self._rng.bit_generator.state = copy.deepcopy(state["rng"])
        for shown, kept in zip(self._shown, state["shown"], strict=True):
            shown[...] = kept
        # It may have been stored after a step that was not shown.
        self._showing = at.SHOW_NOTHING
        return self.observation

    def close(self) -> None:
        """End its threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def _show(self, is_shown: bool) -> None:
        """Decide what of the next observation is written: more, if the last was not."""
        if not is_shown:
            self._showing = at.SHOW_NOTHING
        else:
            self._showing = at.SHOW_ALL if self._showing == at.SHOW_NOTHING else at.SHOW_CHANGES

    def in_pieces(self, work: Callable[[int, int, int], None], firsts: list[int]) -> None:
        """Do work for all swarms, side by side on all threads.

        Args:
            work: takes the numbers of a cohort, of the first swarm, and one more than that of the last.
            firsts: number of the first swarm in each cohort.
        """
        pieces = []
        for index, cohort in enumerate(self.cohorts):
            first, last = firsts[index], len(cohort)
            if self._pool is None:
                pieces.append((index, first, last))
                continue
            number = self._workers * _PIECES_PER_WORKER
            edges = [first + (last - first) * k // number for k in range(number + 1)]
            pieces.extend((index, low, high) for low, high in pairwise(edges))
        tasks = [piece for piece in pieces if piece[1] < piece[2]]
        if self._pool is None:
            for task in tasks:
                work(*task)
            return
        for _ in self._pool.map(lambda task: work(*task), tasks):
            pass

    def _fly(self, velocity: Float32Array, firsts: list[int]) -> None:
        """Fly on in every cohort the swarms from a number on."""
        self.in_pieces(partial(self._fly_piece, velocity), firsts)

    def _fly_piece(self, velocity: Float32Array, index: int, first: int, last: int) -> None:
        cohort = self.cohorts[index]
        step_swarms(
            first, last, self._number, self._showing, velocity, self.sites, self.rays, self._law,
            self._numbers, self._weights, cohort.swarm, cohort.motion, cohort.views, cohort.acts, self._shown,
            self._paid, cohort.snapshots,
        )  # fmt: skip

    def _stagger(self) -> None:
        """Let the law fly the swarms for different times, evenly spread in every cohort."""
        longest = int(self.settings.stagger_s / CONTROL_STEP_S)
        for done in range(longest):
            firsts = [-(-len(cohort) * (done + 1) // (longest + 1)) for cohort in self.cohorts]
            self._fly(np.array(self.observation.reference), firsts)
            self._end_and_begin()

    def _end_and_begin(self) -> list[EpisodeSummary]:
        """Sum up the trials that are over, and begin others in their place."""
        summaries = []
        for index, cohort in enumerate(self.cohorts):
            ended = np.flatnonzero(cohort.places[:, at.END] != FLYING)
            if len(ended) == 0:
                continue
            for s in ended:
                summaries.append(self._summary(cohort, int(s)))
                end = int(cohort.places[s, at.END])
                number = cohort.numbers[s]
                if self.settings.replay.share > 0.0 and end not in (SUCCESS, TIMEOUT):
                    self._crashes[index].keep(cohort, int(s), int(self._scene_of[number]))
            self._begin(index, ended)
        return summaries

    def _begin(self, index: int, which: NDArray[np.int64]) -> None:
        """Begin new trials with some swarms of a cohort, and show what they see."""
        cohort, rng = self.cohorts[index], self._rng
        longest = round(self.settings.episode_s / CONTROL_STEP_S)
        for s in which:
            number = cohort.numbers[s]
            crash = self._crashes[index].take(rng)
            fresh = int(rng.choice(self._scenes[index]))
            scene_number = fresh if crash is None else crash.scene
            scene = self.bank.scenes[scene_number]
            seed = int(rng.integers(1 << 62))
            conditions = self._conditions.draw(scene.perception, rng)
            begins = 0 if crash is None else crash.step
            if crash is not None:
                conditions = crash.conditions
            cohort.set_rules(int(s), scene, conditions, seed, begins + longest)
            if crash is None:
                cohort.start(int(s), scene, self.bank.flights[scene.flight[0]], self.settings, rng)
            else:
                begin_again(cohort, int(s), crash)
            self._scene_of[number] = scene_number
            self._replayed[number] = crash is not None
            self._begun_at[number] = begins
        self._show_first(index, which)

    def _show_first(self, index: int, which: NDArray[np.int64]) -> None:
        """Let swarms of a cohort perceive whose state has just been set."""
        cohort = self.cohorts[index]
        begin_swarms(
            which, self._number, self.sites, self.rays, self._law, cohort.swarm, cohort.motion,
            cohort.views, cohort.acts, self._shown, cohort.snapshots,
        )  # fmt: skip

    def _summary(self, cohort: Cohort, s: int) -> EpisodeSummary:
        number = int(cohort.numbers[s])
        scene = self.bank.scenes[self._scene_of[number]]
        sums, concerned, _, _, totals, returns = cohort.acts[3:]
        steps = int(cohort.places[s, at.STEP] - self._begun_at[number])
        row = sums[s]
        return EpisodeSummary(
            swarm=number,
            followers=cohort.vehicles - 1,
            world=scene.world,
            behaviour=scene.behaviour,
            perception=scene.perception,
            replayed=bool(self._replayed[number]),
            end=ENDS[cohort.places[s, at.END]],
            ended_by=tuple(int(who) for who in concerned[s] if who >= 0),
            steps=steps,
            total=float(returns[s, 1:].mean()),
            terms=totals[s, 1:].mean(axis=0) / max(steps, 1),
            flock_radius_m=float(row[FLOCK_RADIUS] / row[SAMPLES]),
            minimum_separation_m=float(row[SEPARATION] / row[SAMPLES]),
            alignment=float(row[ALIGNMENT] / row[ALIGNED]) if row[ALIGNED] > 0.0 else float("nan"),
        )


def _groups(cohort: Cohort) -> tuple[tuple[NDArray[np.generic], ...], ...]:
    return cohort.swarm, cohort.motion, cohort.views, cohort.acts, cohort.snapshots
