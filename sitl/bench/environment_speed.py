"""How many steps of UAVs the training environment flies in a second, without any network."""

from collections.abc import Callable, Iterator

import numpy as np

from companion.clock import SystemClock
from sitl.training.environment import SceneBank, SwarmBatch
from sitl.training.settings import TrainingSettings

_CLOCK = SystemClock()


def measure(
    settings: TrainingSettings,
    workers: int,
    steps: int,
    on_scene: Callable[[int, int], None] | None = None,
) -> Iterator[dict[str, object]]:
    """Fly one recipe with one thread and with several, and yield a row for each.

    Followers fly what flock wants, plus what a beginning policy adds at random; an action lasts as long as in
    training, and only what it leads to is looked at. Scenes, compilation, the staggered beginning and the
    first action do not count.

    Args:
        settings: a recipe.
        workers: threads.
        steps: control steps of each row.
        on_scene: called with how many scenes are built, of how many.
    """
    bank = SceneBank.build(settings.environment, on_scene)
    for threads in dict.fromkeys((1, workers)):
        yield _row(settings, bank, threads, steps)


def _row(settings: TrainingSettings, bank: SceneBank, threads: int, steps: int) -> dict[str, object]:
    batch = SwarmBatch(settings.environment, settings.contract, settings.seed, threads, bank=bank)
    hold, network = settings.ppo.hold, settings.network
    rng = np.random.default_rng(settings.seed)
    sigmas = np.array(
        [network.sigma_horizontal_mps, network.sigma_horizontal_mps, network.sigma_vertical_mps]
    )
    change = np.zeros((batch.streams, 3), np.float32)

    def fly(number: int) -> None:
        for step in range(number):
            if step % hold == 0:
                change[:] = rng.normal(0.0, sigmas, change.shape)
            batch.step(batch.observation.reference + change, is_shown=step % hold == hold - 1)

    try:
        batch.reset()
        fly(hold)
        begin_ns, begin_cpu_ns = _CLOCK.now_ns(), _CLOCK.process_cpu_ns()
        fly(steps)
        wall_ns, cpu_ns = _CLOCK.now_ns() - begin_ns, _CLOCK.process_cpu_ns() - begin_cpu_ns
    finally:
        batch.close()
    vehicles = batch.streams + settings.environment.swarms
    return {
        "threads": threads,
        "followers": batch.streams,
        "uavs": vehicles,
        "hold": hold,
        "steps": steps,
        "uav_steps_per_s": 1e9 * vehicles * steps / wall_ns,
        "uav_steps_per_cpu_s": 1e9 * vehicles * steps / cpu_ns,
        "follower_steps_per_s": 1e9 * batch.streams * steps / wall_ns,
        "follower_steps_per_cpu_s": 1e9 * batch.streams * steps / cpu_ns,
    }
