"""Whether a policy's velocity may be flown: it must be there in time, and be one."""

import queue
import threading
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from companion.clock import Clock, seconds_to_ns
from companion.control.observation import Contract, Observation
from companion.messages import Float32Array, FloatArray

DEADLINE_S = 0.010
"""A velocity that takes longer is not waited for."""

Refusal = Literal["late", "unsound", "failed"]

_LARGEST_MPS = 20.0


class Policy(Protocol):
    """Turns observations into velocities; equal observations give equal velocities."""

    @property
    def contract(self) -> Contract:
        """What it wants to see."""
        ...

    def velocities(self, observation: Observation) -> Float32Array:
        """Return (batch, 3) velocities in the heading frame, m/s, before limits."""
        ...

    def unusual(self, observation: Observation) -> int:
        """Return how many features are far from everything that training showed it."""
        ...


@dataclass(slots=True)
class PolicyCounters:
    """What has become of a policy's velocities since the start.

    Attributes:
        asked: ticks in which one was wanted.
        flown: ticks in which it was flown, within the limits.
        late: ticks in which it was not there in time.
        unsound: ticks in which it was no velocity.
        failed: ticks in which the model could not be run.
        unusual: ticks in which it was asked about what it hardly knows.
        slowest_us: longest time that one took, microseconds; 0 without a clock.
    """

    asked: int = 0
    flown: int = 0
    late: int = 0
    unsound: int = 0
    failed: int = 0
    unusual: int = 0
    slowest_us: int = 0


class Pilot:
    """Asks a policy once a tick and says whether its velocity may be flown.

    Attributes:
        observation: of one follower; to be written before each `ask`.
        counters: what has become of the velocities.
    """

    def __init__(self, policy: Policy, clock: Clock | None = None, deadline_s: float = DEADLINE_S) -> None:
        """Take all memory at once.

        Args:
            policy: a model, warmed up.
            clock: of the host, to hold the policy to its deadline; without one it is waited for, and equal
                observations have equal consequences.
            deadline_s: how long a velocity may take.
        """
        self.observation = Observation(policy.contract)
        self.counters = PolicyCounters()
        self._policy = policy
        self._clock = clock
        self._deadline_s = deadline_s
        self._worker = _Worker(policy) if clock is not None else None

    def ask(self, velocity: FloatArray) -> Refusal | None:
        """Ask about the present observation.

        Args:
            velocity: (3,) receives the policy's velocity in the heading frame, m/s, before limits; untouched
                if it must not be flown.

        Returns:
            Why it must not be flown, or None.
        """
        counters = self.counters
        counters.asked += 1
        counters.unusual += self.is_unusual
        answer = self._answer()
        if isinstance(answer, str):
            setattr(counters, answer, getattr(counters, answer) + 1)
            return answer
        if answer.shape != (1, 3) or not bool(np.all(np.abs(answer) <= _LARGEST_MPS)):
            counters.unsound += 1
            return "unsound"
        velocity[:] = answer[0]
        counters.flown += 1
        return None

    @property
    def is_unusual(self) -> bool:
        """Whether the present observation is far from everything that training showed the policy."""
        return self._policy.unusual(self.observation) > 0

    def close(self) -> None:
        """End the thread that runs the policy, once it is through with what it does."""
        if self._worker is not None:
            self._worker.close()

    def _answer(self) -> Float32Array | Literal["late", "failed"]:
        if self._worker is None or self._clock is None:
            return _run(self._policy, self.observation)
        begin_ns = self._clock.now_ns()
        answer = self._worker.run(self.observation, self._deadline_s)
        took_ns = self._clock.now_ns() - begin_ns
        self.counters.slowest_us = max(self.counters.slowest_us, took_ns // 1000)
        if took_ns > seconds_to_ns(self._deadline_s):
            return "late"
        return answer


class _Worker:
    """Runs a policy in a thread of its own: whoever asks need not wait for it."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self._observation = Observation(policy.contract)
        self._jobs: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[Float32Array | Literal["failed"]] = queue.SimpleQueue()
        self._busy = False
        # The process must be able to end whatever a model is doing.
        threading.Thread(target=self._work, name="policy", daemon=True).start()

    def run(self, observation: Observation, timeout_s: float) -> Float32Array | Literal["late", "failed"]:
        """Return the answer, or "late" if it takes longer, or if an earlier one is still being worked on."""
        if self._busy:
            try:
                self._answers.get_nowait()
            except queue.Empty:
                return "late"
        for name, values in observation.inputs.items():
            np.copyto(self._observation.inputs[name], values)
        self._busy = True
        self._jobs.put(True)
        try:
            answer = self._answers.get(timeout=timeout_s)
        except queue.Empty:
            return "late"
        self._busy = False
        return answer

    def close(self) -> None:
        self._jobs.put(False)

    def _work(self) -> None:
        while self._jobs.get():
            self._answers.put(_run(self._policy, self._observation))


def _run(policy: Policy, observation: Observation) -> Float32Array | Literal["failed"]:
    try:
        return policy.velocities(observation)
    except Exception:
        # Whatever a model may run into, there is a law to fly by.
        return "failed"
