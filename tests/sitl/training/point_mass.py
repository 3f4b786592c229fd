"""A task that needs no swarm: fly a point on a plane to where it wants to be."""

import numpy as np
from numpy.typing import NDArray

from sitl.training.environment_results import Observation, State, StepResult
from sitl.training.reward_settings import TERMS

_STEP_S = 0.1
_EPISODE = 40


class PointMass:
    """Points that see where their goal is, in `ego`, and are paid for nearness."""

    def __init__(self, streams: int, seed: int, contract: str = "best-2") -> None:
        self._streams = streams
        self._random = np.random.default_rng(seed)
        self._observation = Observation.room(contract, streams)
        self._result = StepResult.room(self._observation, streams)
        self._away: NDArray[np.float64] = np.zeros((streams, 2))
        self._age = np.zeros(streams, np.int64)

    @property
    def streams(self) -> int:
        return self._streams

    def reset(self, round: int = 0) -> Observation:  # noqa: A002
        self._away[:] = self._random.uniform(-1.0, 1.0, self._away.shape)
        self._age[:] = self._random.integers(0, _EPISODE, self._streams)
        return self._seen()

    def step(self, velocity: NDArray[np.float32], *, is_shown: bool = True) -> StepResult:
        result = self._result
        self._away -= _STEP_S * np.clip(velocity[:, :2].astype(float), -2.0, 2.0)
        self._age += 1
        distance = np.linalg.norm(self._away, axis=1)
        result.terms[:] = 0.0
        result.terms[:, TERMS.index("cohesion")] = -distance
        result.reward[:] = -distance
        result.terminated[:] = distance > 3.0
        result.truncated[:] = (self._age >= _EPISODE) & ~result.terminated
        over = result.terminated | result.truncated
        self._away[over] = self._random.uniform(-1.0, 1.0, (int(over.sum()), 2))
        self._age[over] = 0
        self._seen()
        return result

    def state(self) -> State:
        return {
            "away": self._away.copy(),
            "age": self._age.copy(),
            "random": repr(self._random.bit_generator.state),
        }

    def restore(self, state: State) -> Observation:
        self._away[:], self._age[:] = state["away"], state["age"]
        # Its own repr, written just above.
        self._random.bit_generator.state = eval(state["random"], {"__builtins__": {}})
        return self._seen()

    def _seen(self) -> Observation:
        self._observation.ego[:, :2] = self._away
        self._observation.privileged[:, :2] = self._away
        return self._observation
