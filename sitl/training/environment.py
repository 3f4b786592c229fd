"""The swarm as a vector environment: every follower of every swarm is a stream of its own."""

from collections.abc import Callable

from companion.messages import Float32Array
from sitl.training.environment_results import EpisodeSummary, Observation, State, StepResult
from sitl.training.environment_settings import EnvironmentSettings
from sitl.training.reward_settings import TERMS
from sitl.training.scene_bank import SceneBank

__all__ = [
    "TERMS", "EnvironmentSettings", "EpisodeSummary", "Observation", "SceneBank", "State", "StepResult",
    "SwarmBatch",
]  # fmt: skip


class SwarmBatch:
    """Many swarms at once: `reset` begins, `step` flies one control step of 0.05 s with given velocities.

    Attributes:
        settings: what it is made of.
        contract: name of the observations' contract.
        streams: K, how many followers there are.
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
            contract: `paper-1` or `best-1`.
            seed: everything random comes from it; results do not depend on `workers`.
            workers: threads.
            bank: scenes that are built already, from settings that agree.
            on_scene: called with how many scenes are built, of how many.
        """
        raise NotImplementedError

    def reset(self, round: int = 0) -> Observation:
        """Begin all trials anew; equal rounds of equal batches are equal. A run goes on after update k with
        `reset(k)`, or exactly as it would have with `restore`."""
        raise NotImplementedError

    def step(self, velocity: Float32Array) -> StepResult:
        """Fly on with velocities (K, 3) in the heading frame, m/s, before limits."""
        raise NotImplementedError

    def state(self) -> State:
        """Return everything it needs to go on exactly as it would have (tens of megabytes)."""
        raise NotImplementedError

    def restore(self, state: State) -> Observation:
        """Go on from such a state."""
        raise NotImplementedError

    def close(self) -> None:
        """End its threads."""
        raise NotImplementedError
