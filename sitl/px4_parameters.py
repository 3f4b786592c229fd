"""Parameters of a PX4 that runs already: read, compared, and written only when asked to."""

from collections.abc import Sequence

from companion.clock import SystemClock, seconds_to_ns
from companion.config import Profile
from companion.drivers.px4 import Px4Link
from companion.drivers.px4_param_client import ParameterState
from companion.drivers.px4_params import ParameterFinding, compare, names, writable
from companion.drivers.px4_session import Px4Session
from companion.messages import FlightState, MavlinkMessage
from companion.preflight.autopilot import needs_of

_START_TIMEOUT_S = 20.0
_TIMEOUT_NS = seconds_to_ns(30.0)
_POLL_NS = seconds_to_ns(0.02)


class ParameterVisit:
    """One short conversation with the autopilot about its parameters."""

    def __init__(self, profile: Profile, clock: SystemClock) -> None:
        """Prepare; see `run`."""
        self._needs = needs_of(profile)
        self._clock = clock
        self._session = Px4Session(profile.autopilot)
        self._replies: list[MavlinkMessage] = []
        self._link = Px4Link(profile.autopilot, self._session, clock, self._take)

    async def run(self, *, apply: bool) -> list[str]:
        """Read all parameters that matter; write those that differ if `apply`.

        Returns:
            One line for each that differs, saying what became of it.

        Raises:
            StartError: if the autopilot does not answer.
        """
        await self._link.start(_START_TIMEOUT_S)
        try:
            self._session.parameters.read(names(self._needs))
            await self._talk()
            findings = compare(self._session.parameters.values(), self._needs)
            wishes = writable(findings) if apply else {}
            if wishes:
                self._session.parameters.write(wishes)
                await self._talk()
            return self._lines(findings, sorted(wishes))
        finally:
            await self._link.stop()

    def _lines(self, findings: Sequence[ParameterFinding], written: Sequence[str]) -> list[str]:
        lines: list[str] = []
        for finding in findings:
            fate = "left as it is"
            if finding.name in written:
                state = self._session.parameters.entries[finding.name].state
                fate = "written" if state is ParameterState.WRITTEN else f"not written ({state.value})"
            lines.append(f"{finding.sentence}: {fate}")
        if any(name.startswith(("EKF2_", "SYS_")) for name in written):
            lines.append("EKF2 and SYS values were written: some take effect only after PX4 is restarted")
        return lines

    def _take(self, message: MavlinkMessage, t_ns: int) -> None:
        self._replies.extend(self._session.receive(message, t_ns))

    async def _talk(self) -> None:
        """Exchange messages until every question is answered or given up."""
        deadline_ns = self._clock.now_ns() + _TIMEOUT_NS
        while not self._session.parameters.done and self._clock.now_ns() < deadline_ns:
            outgoing, self._replies = self._replies, []
            outgoing.extend(self._session.poll(self._clock.now_ns(), FlightState.STARTING))
            await self._link.send(outgoing)
            await self._clock.sleep(_POLL_NS)
