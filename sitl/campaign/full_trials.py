"""Trials of a campaign in full fidelity: a complete companion in every vehicle."""

import functools
import tempfile
from pathlib import Path

from companion.kernel_cache import load_kernels
from sitl.campaign.conditions import Rules, Variant
from sitl.campaign.scenes import prepare, scene_of
from sitl.campaign.tasks import SceneTask
from sitl.scenario import Scenario
from sitl.swarm.full import FullFlight, fly_full
from sitl.swarm.record import TrialRecord
from sitl.swarm.referee import TrialNames
from sitl.swarm.scene import SwarmScene
from sitl.swarm.vehicles import Crew
from sitl.worlds.settings import WorldSettings


def fly_scenes_fully(task: SceneTask) -> list[TrialRecord]:
    """Fly every method in every scene of a task; the vehicles' logs are not kept."""
    records = []
    for trial in task.trials:
        scene = scene_of(task.rules, task.world, task.followers, trial)
        for label, variant in task.variants:
            with tempfile.TemporaryDirectory(prefix="swarm-") as folder:
                names = TrialNames(task.world.name, label, trial)
                records.append(
                    fly_one_fully(task.rules, variant, scene, names, Path(folder), workers=1).record
                )
    return records


def fly_one_fully(
    rules: Rules,
    variant: Variant,
    scene: SwarmScene,
    names: TrialNames,
    folder: Path,
    *,
    workers: int | None = None,
    packets: bool = False,
) -> FullFlight:
    """Fly one trial in full fidelity.

    Args:
        rules: of the campaign.
        variant: who follows.
        scene: where.
        names: what the trial is called.
        folder: for the logs of all vehicles.
        workers: processes, one a core by default.
        packets: log the raw LiDAR packets too.
    """
    _prepare()
    assert rules.leader_profile is not None
    assert rules.follower_profile is not None
    neighbours = rules.follower_profile.neighbours.model_copy(update={"count": variant.observable_neighbours})
    follower = rules.follower_profile.model_copy(
        update={"follower": variant.follower, "neighbours": neighbours}
    )
    weather = Scenario(
        profile="-",
        world=WorldSettings(primitives=[]),
        quadrotor=rules.abstract.quadrotor,
        wind=rules.abstract.wind,
    )
    return fly_full(
        scene,
        Crew(rules.leader_profile, follower),
        weather,
        folder,
        names,
        termination=rules.swarm.termination,
        cap_m=rules.obstacle_distance_cap_m,
        workers=workers,
        packets=packets,
    )


@functools.cache
def _prepare() -> None:
    """Load every kernel once in this process."""
    prepare()
    load_kernels()
