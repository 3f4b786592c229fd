"""Preflight check of another process's odometry: it arrives, is taken, comes often enough and is good."""

from collections import deque

from companion.clock import NANOSECONDS_PER_SECOND, SystemClock, seconds_to_ns
from companion.config import Profile
from companion.drivers.external_odometry_link import ExternalOdometryLink
from companion.messages import ExternalOdometry, SensorEvent
from companion.preflight.check import Check

NAME = "external odometry"
WAIT_NS = seconds_to_ns(5.0)
_LISTEN_NS = seconds_to_ns(2.0)
_POLL_NS = seconds_to_ns(0.02)
_MOST_MESSAGES = 4096


async def check_external_odometry(profile: Profile, clock: SystemClock, wait_ns: int = WAIT_NS) -> Check:
    """Listen as a flight does, for two seconds after the first message that is accepted.

    Args:
        profile: of the vehicle.
        clock: the host's time.
        wait_ns: how long the first message may take.

    Raises:
        StartError: if the port is taken.
    """
    messages: deque[ExternalOdometry] = deque(maxlen=_MOST_MESSAGES)

    def keep(event: SensorEvent) -> None:
        if isinstance(event, ExternalOdometry):
            messages.append(event)

    link = ExternalOdometryLink(profile.external_odometry, clock, keep)
    await link.start()
    try:
        end_ns = clock.now_ns() + wait_ns
        while not messages and clock.now_ns() < end_ns:
            await clock.sleep(_POLL_NS)
        if messages:
            await clock.sleep(_LISTEN_NS)
        return _judge(profile, list(messages), link, clock.now_ns())
    finally:
        await link.stop()


def _judge(
    profile: Profile, messages: list[ExternalOdometry], link: ExternalOdometryLink, now_ns: int
) -> Check:
    limits = profile.odometry.external
    if not messages:
        return Check(NAME, "fail", link.diagnosis())
    newest = messages[-1]
    age_s = (now_ns - newest.t_valid_ns) / NANOSECONDS_PER_SECOND
    rate_hz = len(messages) * NANOSECONDS_PER_SECOND / _LISTEN_NS
    quality = newest.quality or limits.unstated_quality
    if age_s > limits.lost_after_s:
        return Check(NAME, "fail", f"it stopped: the newest message is {age_s:.1f} s old")
    if rate_hz < limits.min_rate_hz:
        reason = f"it comes at {rate_hz:.1f} Hz, at least {limits.min_rate_hz:g} Hz are needed"
        return Check(NAME, "fail", reason)
    if newest.quality < 0:
        return Check(NAME, "fail", "the other process reports its failure")
    if quality < limits.min_quality:
        reason = f"it states the quality {quality}, at least {limits.min_quality} is needed"
        return Check(NAME, "fail", reason)
    stated = f"quality {newest.quality}" if newest.quality else "no quality stated"
    found = f"{rate_hz:.0f} Hz, {stated}"
    refused = link.statistics().refused
    if refused:
        return Check(NAME, "warn", f"{found}; {link.diagnosis()}")
    return Check(NAME, "ok", found)
