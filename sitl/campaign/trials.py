"""One task of a worker: build scenes, fly every method in each, return what they came to."""

import functools
from dataclasses import replace

from companion.control.followers.settings import FollowerSettings
from sitl.abstract.course import Course
from sitl.abstract.flight import AbstractFlight, fly_abstract
from sitl.abstract.policy_flight import POLICY, Policy
from sitl.campaign.conditions import Rules, Variant
from sitl.campaign.scenes import prepare, scene_of
from sitl.campaign.tasks import SceneTask
from sitl.swarm.record import TrialRecord
from sitl.swarm.scene import SwarmScene


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
    abstract = variant.abstract or rules.abstract
    neighbours = abstract.neighbours.model_copy(update={"count": variant.observable_neighbours})
    return fly_abstract(
        scene,
        variant.method,
        variant.follower,
        abstract.model_copy(update={"neighbours": neighbours}),
        termination=rules.swarm.termination,
        cap_m=rules.obstacle_distance_cap_m,
        record=record,
        world_name=world,
        trial=trial,
        course=course,
        policy=policy_of(variant.follower) if variant.method == POLICY else None,
    )


@functools.lru_cache(maxsize=8)
def policy_of(follower: FollowerSettings) -> Policy:
    """Load the model of a learned follower, once in this process.

    Raises:
        ModelError: if it cannot be flown, or is another than when the campaign began.
    """
    # Its runtime takes a moment to import, and most campaigns fly without.
    from companion.control.policy import load_policy

    return load_policy(follower)
