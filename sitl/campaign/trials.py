"""One task of a worker: build scenes, fly every method in each, return what they came to."""

import functools
from dataclasses import replace
from pathlib import Path

import companion
import sitl
from companion.compiled import warm_up
from companion.kernel_cache import forget_stale_kernels
from sitl.abstract.course import Course
from sitl.abstract.flight import AbstractFlight, fly_abstract
from sitl.campaign.conditions import Rules, Variant
from sitl.campaign.definition import WorldEntry
from sitl.campaign.tasks import SceneTask, trial_seed
from sitl.swarm.record import TrialRecord
from sitl.swarm.scene import SwarmScene, set_scene
from sitl.swarm.settings import SwarmSettings


def fly_scenes(task: SceneTask) -> list[TrialRecord]:
    """Fly every method in every scene of a task; equal tasks give equal records, wherever they are done."""
    if task.rules.fidelity == "full":
        from sitl.campaign.full_trials import fly_scenes_fully

        return fly_scenes_fully(task)
    prepare()
    records = []
    for trial in task.trials:
        scene = scene_of(task.rules, task.world, task.followers, trial)
        course = None
        for label, variant in task.variants:
            flight = fly_one(task.rules, task.world.name, variant, scene, trial, course=course)
            course = flight.course
            records.append(replace(flight.record, method=label))
    return records


def scene_of(rules: Rules, world: WorldEntry, followers: int, trial: int) -> SwarmScene:
    """Build the scene of a trial."""
    seed = trial_seed(rules.seed, world.site_name, followers, trial, held_out=rules.seeds == "held_out")
    return set_scene(swarm_of(rules, world, followers), world.site_name, seed)


def swarm_of(rules: Rules, world: WorldEntry, followers: int) -> SwarmSettings:
    """Return the swarm that flies in one world of a campaign."""
    leader = rules.swarm.leader
    if world.behaviour is not None:
        leader = leader.model_copy(update={"behaviour": world.behaviour})
    return rules.swarm.model_copy(update={"followers": followers, "leader": leader})


def fly_one(
    rules: Rules,
    world: str,
    variant: Variant,
    scene: SwarmScene,
    trial: int,
    *,
    course: Course | None = None,
    record: bool = False,
) -> AbstractFlight:
    """Fly one trial in abstract fidelity.

    Args:
        rules: of the campaign.
        world: its name in the tables.
        variant: who follows.
        scene: where.
        trial: its number.
        course: the leader's route in this scene, if it is known from another flight.
        record: keep everybody's path as well.
    """
    neighbours = rules.abstract.neighbours.model_copy(update={"count": variant.observable_neighbours})
    return fly_abstract(
        scene,
        variant.method,
        variant.follower,
        rules.abstract.model_copy(update={"neighbours": neighbours}),
        termination=rules.swarm.termination,
        cap_m=rules.obstacle_distance_cap_m,
        record=record,
        world_name=world,
        trial=trial,
        course=course,
    )


@functools.cache
def prepare() -> None:
    """Load all kernels from the disk, once in this process; those whose sources have changed are compiled."""
    root, laws = Path(sitl.__file__).parent, Path(companion.__file__).parent
    forget_stale_kernels(root, [*laws.rglob("*kernels.py"), *(root / "abstract").glob("*.py")])
    warm_up()
