"""Preflight check of the learned model that a follower flies by."""

import statistics

from companion.clock import SystemClock
from companion.control.action import DEADLINE_S
from companion.control.followers.settings import CommandSettings, FollowerSettings
from companion.control.observation import Observation
from companion.control.policy import Policy, load_policy
from companion.preflight.check import Check

NAME = "policy"
SLOW_MS = 2.0
_RUNS = 100


def check_policy(follower: FollowerSettings, clock: SystemClock) -> Check:
    """Load the model as a flight does, and see how long it takes.

    Raises:
        ModelError: if it cannot be flown with this profile.
    """
    policy = load_policy(follower)
    milliseconds = _median_ms(policy, clock)
    metadata = policy.metadata
    trained = f"configuration {metadata.configuration_sha256[:12]}, commit {metadata.commit[:12]}"
    found = f"{policy}, contract {metadata.contract}, {trained}, {milliseconds:.2f} ms"
    if milliseconds > 1000.0 * DEADLINE_S:
        return Check(NAME, "fail", f"{found}: it is due within {1000.0 * DEADLINE_S:.0f} ms")
    other = _other_limits(follower.command, policy)
    if other:
        return Check(NAME, "warn", f"{found}; {other}")
    if milliseconds > SLOW_MS:
        return Check(NAME, "warn", f"{found}: more than {SLOW_MS:.0f} ms leaves little room")
    return Check(NAME, "ok", found)


def _median_ms(policy: Policy, clock: SystemClock) -> float:
    observation = Observation(policy.contract)
    times = []
    for _ in range(_RUNS):
        begin_ns = clock.now_ns()
        policy.velocities(observation)
        times.append((clock.now_ns() - begin_ns) / 1e6)
    return statistics.median(times)


def _other_limits(command: CommandSettings, policy: Policy) -> str:
    """Say which limits of the profile are not those that the model was trained with."""
    differences = []
    for name, trained in policy.metadata.limits.items():
        configured = getattr(command, name, None)
        if configured is not None and configured != trained:
            differences.append(f"{name} is {configured:g}, it was trained with {trained:g}")
    return ", ".join(differences)
