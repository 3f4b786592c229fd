"""How many steps of UAVs the abstract swarm flies in a second, on one process and on several."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

from companion.clock import SystemClock
from companion.control.followers.settings import FollowerSettings
from sitl.abstract.flight import fly_abstract
from sitl.abstract.settings import AbstractSettings
from sitl.campaign.scenes import prepare
from sitl.swarm.scene import set_scene
from sitl.swarm.settings import SwarmSettings
from sitl.worlds.seeds import training_seed

_CLOCK = SystemClock()


@dataclass(frozen=True, slots=True)
class Share:
    """What one process flew.

    Attributes:
        steps: control steps, each vehicle counted.
        begun_ns: when, by the clock that all processes share.
        ended_ns: likewise.
        scenes_cpu_ns: processor time for building scenes.
        flights_cpu_ns: processor time for flying, the leader's route included.
    """

    steps: int
    begun_ns: int
    ended_ns: int
    scenes_cpu_ns: int
    flights_cpu_ns: int


def fly_share(site: str, followers: int, first: int, trials: int, method: str = "flock") -> Share:
    """Fly some trials in this process and take the time; what is needed only once is done before.

    Args:
        site: name of the world.
        followers: how many.
        first: number of the first scene.
        trials: how many.
        method: the followers' law.
    """
    prepare()
    swarm, settings, follower = SwarmSettings(followers=followers), AbstractSettings(), FollowerSettings()
    fly_abstract(set_scene(swarm, site, training_seed(first)), method, follower, settings)
    steps = scenes_ns = flights_ns = 0
    begun_ns = _CLOCK.now_ns()
    for trial in range(first, first + trials):
        start_ns = _CLOCK.thread_cpu_ns()
        scene = set_scene(swarm, site, training_seed(trial))
        set_ns = _CLOCK.thread_cpu_ns()
        record = fly_abstract(scene, method, follower, settings).record
        steps += record.steps * (followers + 1)
        scenes_ns += set_ns - start_ns
        flights_ns += _CLOCK.thread_cpu_ns() - set_ns
    return Share(steps, begun_ns, _CLOCK.now_ns(), scenes_ns, flights_ns)


def measure(site: str, followers: int, trials: int, processes: int) -> dict[str, object]:
    """Return one row: the speed of so many processes that fly `trials` trials each."""
    firsts = [process * trials for process in range(processes)]
    if processes == 1:
        shares = [fly_share(site, followers, 0, trials)]
    else:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(processes, mp_context=context) as pool:
            shares = list(
                pool.map(fly_share, [site] * processes, [followers] * processes, firsts, [trials] * processes)
            )
    steps = sum(share.steps for share in shares)
    wall_ns = max(share.ended_ns for share in shares) - min(share.begun_ns for share in shares)
    cpu_ns = sum(share.scenes_cpu_ns + share.flights_cpu_ns for share in shares)
    done = trials * processes
    return {
        "site": site,
        "followers": followers,
        "processes": processes,
        "trials": done,
        "uav_steps_per_s": 1e9 * steps / wall_ns,
        "uav_steps_per_cpu_s": 1e9 * steps / cpu_ns,
        "scene_cpu_ms": 1e-6 * sum(share.scenes_cpu_ns for share in shares) / done,
        "flight_cpu_ms": 1e-6 * sum(share.flights_cpu_ns for share in shares) / done,
    }
