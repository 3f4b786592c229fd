"""A policy's velocity is flown if it is there in time and is one."""

import threading
from collections.abc import Callable

import numpy as np
import pytest

from companion.clock import SystemClock
from companion.control.action import Pilot, PolicyCounters
from companion.control.observation import CONTRACTS, Contract, Observation
from companion.messages import Float32Array

BEST = CONTRACTS["best-2"]
LONG_S = 30.0


class FakePolicy:
    """Answers as it is told."""

    def __init__(self, answer: Callable[[Observation], Float32Array], unusual: int = 0) -> None:
        self.answer = answer
        self.features = unusual

    @property
    def contract(self) -> Contract:
        return BEST

    def velocities(self, observation: Observation) -> Float32Array:
        return self.answer(observation)

    def unusual(self, observation: Observation) -> int:
        return self.features


def own_velocity(observation: Observation) -> Float32Array:
    return observation.ego[:, :3].copy()


def failing(observation: Observation) -> Float32Array:
    raise MemoryError


@pytest.fixture(params=["waiting", "on time"])
def clock(request: pytest.FixtureRequest) -> SystemClock | None:
    return SystemClock() if request.param == "on time" else None


def test_the_velocity_of_this_observation_is_flown(clock: SystemClock | None) -> None:
    pilot = Pilot(FakePolicy(own_velocity), clock, LONG_S)
    for x in (0.5, -0.25, 1.5):
        pilot.observation.ego[0, 0] = x
        velocity = np.full(3, 9.0)
        assert pilot.ask(velocity) is None
        assert velocity.tolist() == [x, 0.0, 0.0]
    assert (pilot.counters.asked, pilot.counters.flown) == (3, 3)
    assert (pilot.counters.slowest_us > 0) == (clock is not None)
    pilot.close()


@pytest.mark.parametrize(
    "answer",
    [[[np.nan, 0, 0]], [[0, np.inf, 0]], [[0, 0, -np.inf]], [[1e30, 0, 0]], [[0, 0]], [0, 0, 0], []],
)
def test_what_is_no_velocity_is_not_flown(answer: list[list[float]], clock: SystemClock | None) -> None:
    pilot = Pilot(FakePolicy(lambda _: np.array(answer, np.float32)), clock, LONG_S)
    velocity = np.ones(3)
    assert pilot.ask(velocity) == "unsound"
    assert velocity.tolist() == [1.0, 1.0, 1.0]
    assert pilot.counters.unsound == 1
    assert pilot.counters.flown == 0
    pilot.close()


def test_a_model_that_breaks_is_not_flown_and_may_come_back(clock: SystemClock | None) -> None:
    policy = FakePolicy(failing)
    pilot = Pilot(policy, clock, LONG_S)
    velocity = np.ones(3)
    assert pilot.ask(velocity) == "failed"
    assert velocity.tolist() == [1.0, 1.0, 1.0]
    policy.answer = own_velocity
    assert pilot.ask(velocity) is None
    assert not velocity.any()
    assert (pilot.counters.failed, pilot.counters.flown) == (1, 1)
    pilot.close()


def test_nobody_waits_for_a_model_that_hangs_and_its_old_answer_is_never_flown() -> None:
    go_on, started = threading.Event(), threading.Semaphore(0)

    def slow(observation: Observation) -> Float32Array:
        started.release()
        assert go_on.wait(LONG_S)
        return own_velocity(observation)

    policy = FakePolicy(slow)
    pilot = Pilot(policy, SystemClock(), 0.001)
    velocity = np.ones(3)
    pilot.observation.ego[0, 0] = 0.5
    assert pilot.ask(velocity) == "late"
    assert started.acquire(timeout=LONG_S)
    for _ in range(3):
        assert pilot.ask(velocity) == "late"
    # It was asked once: whoever is busy is left alone.
    assert not started.acquire(blocking=False)
    assert velocity.tolist() == [1.0, 1.0, 1.0]
    assert pilot.counters.late == 4
    policy.answer = own_velocity
    go_on.set()
    pilot.observation.ego[0, 0] = 0.75
    while pilot.ask(velocity) == "late":
        pass
    assert velocity[0] == 0.75
    pilot.close()


def test_an_answer_after_the_deadline_is_not_flown() -> None:
    class SlowClock(SystemClock):
        t_ns = 0

        def now_ns(self) -> int:
            self.t_ns += 6_000_000
            return self.t_ns

    velocity = np.ones(3)
    clock = SlowClock()
    pilot = Pilot(FakePolicy(own_velocity), clock, 0.005)
    while pilot.counters.slowest_us == 0:
        assert pilot.ask(velocity) == "late"
    assert velocity.tolist() == [1.0, 1.0, 1.0]
    pilot.close()


def test_unusual_observations_are_flown_and_counted() -> None:
    policy = FakePolicy(own_velocity, unusual=3)
    pilot = Pilot(policy)
    assert pilot.ask(np.zeros(3)) is None
    policy.features = 0
    assert pilot.ask(np.zeros(3)) is None
    assert pilot.counters == PolicyCounters(asked=2, flown=2, unusual=1)
