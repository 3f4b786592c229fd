"""The swarm as a vector environment on a graphics card, with the interface of `SwarmBatch`.

States, observations and rewards stay on the card. The processor only learns which trials have ended, draws
the beginnings of the next ones exactly as `SwarmBatch` does, and sends those.
"""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import cuda
from numpy.typing import NDArray

from companion.errors import StartError
from sitl.abstract.judging_kernels import FLYING
from sitl.training import batch_layout_kernels as at
from sitl.training.cohort import Cohort
from sitl.training.cuda_kernels import launches
from sitl.training.environment import SwarmBatch
from sitl.training.environment_results import EpisodeSummary, Observation, State, StepResult
from sitl.training.environment_settings import EnvironmentSettings
from sitl.training.scene_bank import SceneBank

Group = tuple[Any, ...]

_NEEDED_AT_THE_END = (3, 4, 7, 8)


class _OnCard:
    """The arrays of a cohort on the card, in the groups of `batch_layout_kernels`."""

    def __init__(self, cohort: Cohort) -> None:
        self.swarm, self.motion, self.views, self.acts, self.snapshots = map(_sent, _groups(cohort))
        self.which = cuda.to_device(np.arange(len(cohort)))

    @property
    def groups(self) -> tuple[Group, ...]:
        return self.swarm, self.motion, self.views, self.acts, self.snapshots


class CudaSwarmBatch(SwarmBatch):
    """A `SwarmBatch` whose swarms fly on a graphics card.

    Observations and results are arrays of the card (they have `__cuda_array_interface__`, so
    `torch.as_tensor` takes them without copying); velocities may be such arrays or tensors, or arrays of the
    processor. The numbers agree with those of `SwarmBatch` but for rounding.
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
            contract: of the observations.
            seed: everything random comes from it.
            workers: has no meaning here.
            bank: scenes that are built already, from settings that agree.
            on_scene: called with how many scenes are built, of how many.

        Raises:
            KeyError: if there is no such contract.
            StartError: if there is no graphics card, or nothing that compiles for it.
        """
        if not cuda.is_available():
            raise StartError("no graphics card that CUDA can use was found; train with --device cpu instead")
        if cuda.implementation == "Built-in" and not numba.config.ENABLE_CUDASIM:
            # The compiler that Numba itself brings along no longer knows the minimum of two numbers.
            raise StartError("the package numba-cuda is missing: install the extra gpu")
        # Few swarms at a time begin anew: that is no reason for a warning.
        numba.config.CUDA_LOW_OCCUPANCY_WARNINGS = 0
        super().__init__(settings, contract, seed, 1, bank=bank, on_scene=on_scene)
        self._run = launches()
        self._card = [_OnCard(cohort) for cohort in self.cohorts]
        self._card_bank, self._card_rays = _sent(self.sites), _sent(self.rays)
        self._card_law, self._card_numbers, self._card_weights = _sent(
            (self._law, self._numbers, self._weights)
        )
        self._card_shown = _sent(self._shown)
        self.observation = Observation(*self._card_shown)
        flags = (np.zeros(self.streams, np.bool_), np.zeros(self.streams, np.bool_))
        self._card_paid = _sent((self._result.terms, self._result.reward, *flags))
        terms, reward, terminated, truncated = self._card_paid
        self._result = StepResult(self.observation, terms, reward, terminated, truncated, [])

    def step(self, velocity: Any, *, is_shown: bool = True) -> StepResult:
        """Fly on.

        Args:
            velocity: (K, 3) what each follower wants to fly, heading frame, m/s, before limits.
            is_shown: whether anybody looks at the observation, see `SwarmBatch.step`.

        Raises:
            ValueError: if the shape is another.
        """
        if tuple(velocity.shape) != (self.streams, 3):
            raise ValueError(f"velocity is {tuple(velocity.shape)}, expected {(self.streams, 3)}")
        self._show(is_shown)
        self._fly(velocity, [0] * len(self.cohorts))
        self._result.finished.clear()
        self._result.finished.extend(self._end_and_begin())
        return self._result

    def state(self) -> State:
        """Return everything it needs to go on exactly as it would have, in arrays of the processor."""
        for cohort, card in zip(self.cohorts, self._card, strict=True):
            for group, sent in zip(_groups(cohort), card.groups, strict=True):
                _fetch(sent, group)
        _fetch(self._card_shown, self._shown)
        return super().state()

    def restore(self, state: State) -> Observation:
        """Go on from what `state` of an equal batch returned, on a card or not."""
        super().restore(state)
        for cohort, card in zip(self.cohorts, self._card, strict=True):
            for group, sent in zip(_groups(cohort), card.groups, strict=True):
                _send(group, sent)
        _send(self._shown, self._card_shown)
        return self.observation

    def _fly(self, velocity: Any, firsts: list[int]) -> None:
        super()._fly(_on_card(velocity), firsts)

    def _fly_piece(self, velocity: Any, index: int, first: int, last: int) -> None:
        card, run, n = self._card[index], self._run, self.cohorts[index].vehicles
        which, count = card.which[first:last], last - first
        run.fly(
            count * n, which, self._number, velocity, self._card_bank, self._card_law, card.swarm,
            card.motion, card.views, card.acts,
        )  # fmt: skip
        run.count(count, which, 1, card.swarm, card.motion, card.acts)
        self._see(card, which, count * n, self._showing)
        run.judge(count, which, card.swarm, card.motion, card.views, card.acts)
        run.pay(
            count * (n - 1), which, self._card_rays, self._card_numbers, self._card_weights, card.swarm,
            card.motion, card.views, card.acts, self._card_paid,
        )  # fmt: skip

    def _see(self, card: _OnCard, which: Any, threads: int, showing: int) -> None:
        self._run.see(
            threads, which, self._number, showing, self._card_bank, self._card_rays, self._card_law,
            card.swarm, card.motion, card.views, card.acts, self._card_shown, card.snapshots,
        )  # fmt: skip

    def _end_and_begin(self) -> list[EpisodeSummary]:
        for cohort, card in zip(self.cohorts, self._card, strict=True):
            card.swarm[1].copy_to_host(cohort.places)
            ended = np.flatnonzero(cohort.places[:, at.END] != FLYING)
            if len(ended) == 0:
                continue
            for place in _NEEDED_AT_THE_END:
                card.acts[place].copy_to_host(cohort.acts[place])
            if self.settings.replay.share > 0.0:
                for stored, kept in zip(card.snapshots, cohort.snapshots, strict=True):
                    for s in ended:
                        kept[s] = stored[int(s)].copy_to_host()
        return super()._end_and_begin()

    def _show_first(self, index: int, which: NDArray[np.int64]) -> None:
        cohort, card, n = self.cohorts[index], self._card[index], self.cohorts[index].vehicles
        numbers = cuda.to_device(which)
        # What follows in the group of the swarm is found out on the card.
        begun = (*cohort.swarm[:6], *cohort.motion, *cohort.views, *cohort.acts[3:], cohort.snapshots[0])
        sent = (*card.swarm[:6], *card.motion, *card.views, *card.acts[3:], card.snapshots[0])
        for source, target in zip(begun, sent, strict=True):
            rows = np.ascontiguousarray(source[which]).reshape(len(which), -1)
            flat = target.reshape(len(cohort), rows.shape[1])
            self._run.scatter(rows.size, numbers, cuda.to_device(rows), flat)
        self._run.begin(len(which) * n, numbers, self._card_bank, card.swarm, card.motion)
        self._run.count(len(which), numbers, 0, card.swarm, card.motion, card.acts)
        self._see(card, numbers, len(which) * n, at.SHOW_ALL)


def _groups(cohort: Cohort) -> tuple[tuple[NDArray[Any], ...], ...]:
    return cohort.swarm, cohort.motion, cohort.views, cohort.acts, cohort.snapshots


def _sent(group: tuple[NDArray[Any], ...]) -> Group:
    return tuple(cuda.to_device(np.ascontiguousarray(array)) for array in group)


def _send(group: tuple[NDArray[Any], ...], sent: Group) -> None:
    for source, target in zip(group, sent, strict=True):
        if source.size > 0:
            target.copy_to_device(source)


def _fetch(sent: Group, group: tuple[NDArray[Any], ...]) -> None:
    for source, target in zip(sent, group, strict=True):
        if target.size > 0:
            source.copy_to_host(target)


def _on_card(velocity: Any) -> Any:
    """Return velocities as an array of the card, without copying those that are there already."""
    if hasattr(velocity, "__cuda_array_interface__"):
        return cuda.as_cuda_array(velocity)
    return cuda.to_device(np.ascontiguousarray(velocity, np.float32))
