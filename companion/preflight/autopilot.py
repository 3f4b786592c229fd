"""Preflight checks of the autopilot: the right one answers, and its parameters suit a flight without GNSS."""

from collections.abc import Callable, Sequence
from typing import Protocol

from companion.clock import Clock, SystemClock, seconds_to_ns
from companion.config import Profile
from companion.drivers.px4 import OnMessage, Px4Link
from companion.drivers.px4_params import ParameterNeeds, compare, names
from companion.drivers.px4_session import Px4Session
from companion.drivers.px4_settings import Px4Settings
from companion.messages import FlightState, MavlinkMessage, Severity
from companion.preflight.check import Check, Verdict

START_TIMEOUT_S = 5.0
_PARAMETERS_TIMEOUT_NS = seconds_to_ns(20.0)
_LISTEN_NS = seconds_to_ns(1.5)  # telemetry that comes once a second has come by then
_POLL_NS = seconds_to_ns(0.02)
_LOW_BATTERY_PERCENT = 40


class Link(Protocol):
    """What carries messages to and from the autopilot."""

    async def start(self, timeout_s: float) -> None:
        """Open and wait for the configured autopilot."""
        ...

    async def send(self, messages: Sequence[MavlinkMessage]) -> None:
        """Send messages now."""
        ...

    async def stop(self) -> None:
        """Close."""
        ...


OpenLink = Callable[[Px4Settings, Px4Session, Clock, OnMessage], Link]


async def check_autopilot(profile: Profile, clock: SystemClock, open_link: OpenLink = Px4Link) -> list[Check]:
    """Listen to the autopilot and read its parameters; writes nothing.

    Args:
        profile: of the vehicle.
        clock: the host's time.
        open_link: builds the link; another one in tests.

    Returns:
        One check for the link, the radio, the battery, and every parameter that is not right.

    Raises:
        StartError: if the configured autopilot does not answer.
    """
    session = Px4Session(profile.autopilot)
    replies: list[MavlinkMessage] = []

    def on_message(message: MavlinkMessage, t_ns: int) -> None:
        replies.extend(session.receive(message, t_ns))

    link = open_link(profile.autopilot, session, clock, on_message)
    await link.start(START_TIMEOUT_S)
    try:
        needs = needs_of(profile)
        session.parameters.read(names(needs))
        begin_ns = now_ns = clock.now_ns()
        while now_ns - begin_ns < _LISTEN_NS or (
            not session.parameters.done and now_ns - begin_ns < _PARAMETERS_TIMEOUT_NS
        ):
            outgoing, replies[:] = [*replies, *session.poll(now_ns, FlightState.STARTING)], []
            await link.send(outgoing)
            await clock.sleep(_POLL_NS)
            now_ns = clock.now_ns()
    finally:
        await link.stop()
    return [
        _link_check(session, profile.autopilot, now_ns),
        _radio_check(session),
        _battery_check(session),
        *_parameter_checks(session, needs),
    ]


def needs_of(profile: Profile) -> ParameterNeeds:
    """Return what a profile demands of the autopilot's parameters."""
    return ParameterNeeds(
        system_id=profile.autopilot.system_id,
        max_speed_mps=profile.safety.max_speed_mps,
        max_climb_mps=profile.safety.max_climb_mps,
        max_descent_mps=profile.safety.max_descent_mps,
        min_odometry_quality=profile.autopilot.min_odometry_quality,
    )


def _link_check(session: Px4Session, settings: Px4Settings, now_ns: int) -> Check:
    state = session.vehicle_state(now_ns)
    if not state.connected:
        return Check("autopilot", "fail", f"system id {settings.system_id} fell silent during the check")
    reason = f"system id {settings.system_id}, mode {state.mode.value}"
    foreign = session.foreign_autopilots()
    if foreign:
        heard = ", ".join(str(system_id) for system_id in foreign)
        return Check("autopilot", "warn", f"{reason}; system id {heard} is heard on the same link")
    if state.armed:
        return Check("autopilot", "warn", f"{reason}, armed")
    return Check("autopilot", "ok", f"{reason}, disarmed")


def _radio_check(session: Px4Session) -> Check:
    if session.health().manual_control:
        return Check("radio control", "ok", "the pilot's receiver is heard")
    return Check("radio control", "warn", "no receiver is heard: nobody could take over by stick")


def _battery_check(session: Px4Session) -> Check:
    percent = session.health().battery_percent
    if percent < 0:
        return Check("battery", "warn", "its charge is unknown")
    verdict: Verdict = "ok" if percent >= _LOW_BATTERY_PERCENT else "warn"
    return Check("battery", verdict, f"{percent} %")


def _parameter_checks(session: Px4Session, needs: ParameterNeeds) -> list[Check]:
    findings = compare(session.parameters.values(), needs)
    if not findings:
        return [
            Check("parameters", "ok", f"{len(session.parameters.values())} are as this flight needs them")
        ]
    return [
        Check(
            f"parameter {finding.name}",
            "fail" if finding.severity <= Severity.ERROR else "warn",
            finding.sentence,
        )
        for finding in findings
    ]
