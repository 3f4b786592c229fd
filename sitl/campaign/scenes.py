"""The scene of any trial of a campaign, and the kernels without which none can be flown."""

import functools
import importlib

import sitl
from companion.compiled import warm_up
from companion.errors import ProfileError
from companion.kernel_cache import forget_stale
from sitl.campaign.conditions import Rules
from sitl.campaign.definition import WorldEntry
from sitl.campaign.own_worlds import settings_of
from sitl.campaign.tasks import trial_seed
from sitl.swarm.scene import SwarmScene, set_scene
from sitl.swarm.settings import SwarmSettings


def scene_of(rules: Rules, world: WorldEntry, followers: int, trial: int) -> SwarmScene:
    """Build the scene of a trial.

    Raises:
        ProfileError: if the world has no place for such a swarm or such a way.
    """
    seed = trial_seed(rules.seed, world.scenes_name, followers, trial, held_out=rules.seeds == "held_out")
    try:
        return set_scene(swarm_of(rules, world, followers), settings_of(world), seed)
    except ValueError as error:
        raise ProfileError(
            f"world {world.name} with {followers} followers, trial {trial}: no scene can be built: {error}"
        ) from None


def swarm_of(rules: Rules, world: WorldEntry, followers: int) -> SwarmSettings:
    """Return the swarm that flies in one world of a campaign."""
    leader = rules.swarm.leader
    if world.behaviour is not None:
        leader = leader.model_copy(update={"behaviour": world.behaviour})
    return rules.swarm.model_copy(update={"followers": followers, "leader": leader})


@functools.cache
def prepare() -> None:
    """Load all kernels from the disk, once in this process; those whose sources have changed are compiled."""
    forget_stale((sitl.__name__,))
    importlib.import_module("sitl.abstract.flight")
    warm_up()
