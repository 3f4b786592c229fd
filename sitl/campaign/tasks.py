"""Which trials there are, with which seeds, and how they are dealt out to workers."""

import hashlib
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass

from sitl.campaign.conditions import Conditions, Rules, Variant, labels_of
from sitl.campaign.definition import CampaignDefinition, WorldEntry
from sitl.campaign.journal import Key
from sitl.worlds.seeds import HELD_OUT_FROM, held_out_seed, training_seed


@dataclass(frozen=True, slots=True)
class Selection:
    """The part of a campaign that is wanted now.

    Attributes:
        worlds: names.
        methods: labels.
        followers: sizes of the swarm.
        trials: how many in each case.
    """

    worlds: tuple[str, ...]
    methods: tuple[str, ...]
    followers: tuple[int, ...]
    trials: int

    def __iter__(self) -> Iterator[Key]:
        """Name every wanted trial, case by case."""
        for world in self.worlds:
            for method in self.methods:
                for followers in self.followers:
                    for trial in range(self.trials):
                        yield world, method, followers, trial

    def __len__(self) -> int:
        return len(self.worlds) * len(self.methods) * len(self.followers) * self.trials


def selection_of(
    definition: CampaignDefinition,
    *,
    worlds: Sequence[str] | None = None,
    methods: Sequence[str] | None = None,
    followers: Sequence[str] | None = None,
    perceptions: Sequence[str] | None = None,
) -> Selection:
    """Return all that a campaign's file wants, or the named part of it.

    Args:
        definition: the file.
        worlds: names of entries; all without.
        methods: names of entries, each with all its variants; all without.
        followers: sizes; all without.
        perceptions: names of entries; all without.
    """
    return Selection(
        worlds=tuple(e.name for e in definition.world_entries if worlds is None or e.name in worlds),
        methods=tuple(
            label
            for entry in definition.method_entries
            if methods is None or entry.name in methods
            for label, _, perception in labels_of(definition, entry)
            if perceptions is None or perception in perceptions
        ),
        followers=tuple(n for n in definition.followers if followers is None or str(n) in followers),
        trials=definition.trials,
    )


@dataclass(frozen=True, slots=True)
class SceneTask:
    """Some scenes of one world and size, and who flies in each of them; all that a worker needs to know.

    Attributes:
        rules: of the campaign.
        world: where.
        followers: size of the swarm.
        trials: numbers of the scenes.
        variants: labels of the methods, and what they stand for.
    """

    rules: Rules
    world: WorldEntry
    followers: int
    trials: tuple[int, ...]
    variants: tuple[tuple[str, Variant], ...]


def trial_seed(campaign_seed: int, scenes: str, followers: int, trial: int, *, held_out: bool) -> int:
    """Return the seed of a trial: it depends on the scene, never on who flies in it nor on which worker.

    Args:
        campaign_seed: of the whole campaign.
        scenes: name of the site, or of the file with the world.
        followers: size of the swarm without its leader.
        trial: number of the trial, from 0.
        held_out: for testing rather than for tuning and training.
    """
    text = f"{campaign_seed}\n{scenes}\n{followers}\n{trial}"
    number = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") % HELD_OUT_FROM
    return held_out_seed(number) if held_out else training_seed(number)


def pending_tasks(
    conditions: Conditions, selection: Selection, done: Container[Key], scenes_per_task: int
) -> list[SceneTask]:
    """Deal out what has not been flown yet.

    All methods that are missing in one scene fly it in one task, for building a scene takes time. Trials with
    low numbers come first in every case, so that an unfinished campaign says something about all of them.
    """
    tasks: list[SceneTask] = []
    for first in range(0, selection.trials, scenes_per_task):
        block = range(first, min(first + scenes_per_task, selection.trials))
        for world in selection.worlds:
            for followers in selection.followers:
                missing = {
                    trial: tuple(
                        label for label in selection.methods if (world, label, followers, trial) not in done
                    )
                    for trial in block
                }
                tasks.extend(
                    SceneTask(
                        rules=conditions.rules,
                        world=conditions.worlds[world],
                        followers=followers,
                        trials=trials,
                        variants=tuple((label, conditions.variants[label]) for label in labels),
                    )
                    for labels, trials in _alike(missing.items())
                    if labels
                )
    return tasks


def _alike(missing: Iterable[tuple[int, tuple[str, ...]]]) -> list[tuple[tuple[str, ...], tuple[int, ...]]]:
    """Bring scenes together in which the same methods are missing."""
    groups: dict[tuple[str, ...], list[int]] = {}
    for trial, labels in missing:
        groups.setdefault(labels, []).append(trial)
    return [(labels, tuple(trials)) for labels, trials in groups.items()]
