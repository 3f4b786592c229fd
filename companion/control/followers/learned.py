"""A learned policy beside a law: it sees what the law sees and remembers, and flies where it can."""

import numpy as np

from companion.clock import seconds_to_ns
from companion.control.action import Pilot, PolicyCounters, Refusal
from companion.control.followers.laws_kernels import is_sound, overrule
from companion.control.followers.layout_kernels import EGO_YAW, PREVIOUS
from companion.control.observation_kernels import describe
from companion.messages import FloatArray, Severity, StatusText

_TELL_AGAIN_NS = seconds_to_ns(5.0)
_TROUBLE = {
    "late": "policy is late: the law flies",
    "unsound": "policy gives no velocity: the law flies",
    "failed": "policy cannot be run: the law flies",
}


class LearnedFollower:
    """Replaces a law's command by a policy's, tick by tick."""

    def __init__(self, pilot: Pilot, parameters: FloatArray) -> None:
        """Join a policy with the law's parameters (PARAMETER_COUNT,)."""
        self._pilot = pilot
        self._parameters = parameters
        self._previous_map = np.zeros(3)
        self._previous = np.zeros(3)
        self._told_ns: dict[str, int] = {}
        self._remarks: list[StatusText] = []

    @property
    def counters(self) -> PolicyCounters:
        """What has become of the policy's velocities."""
        return self._pilot.counters

    def begin(self, memory: FloatArray) -> None:
        """Keep what was flown before this tick; call it before the law is asked."""
        self._previous_map[:] = memory[PREVIOUS : PREVIOUS + 3]

    def overrule(
        self,
        ego: FloatArray,
        up: FloatArray,
        neighbours: FloatArray,
        ranges: FloatArray,
        memory: FloatArray,
        command: FloatArray,
        t_ns: int,
    ) -> None:
        """Put the policy's velocity, within the limits, in the place of the law's, if it may be flown.

        Args:
            ego: as given to `steer`, and likewise the next but one.
            up: (3,) the body's upward axis in the heading frame.
            neighbours: see there.
            ranges: see there.
            memory: of the law, after `steer`.
            command: (3,) in and out: heading frame, m/s.
            t_ns: host time.
        """
        if not is_sound(ego, neighbours, ranges):
            return
        cosine, sine = np.cos(ego[EGO_YAW]), np.sin(ego[EGO_YAW])
        x, y, z = self._previous_map
        self._previous[:] = cosine * x + sine * y, cosine * y - sine * x, z
        seen = self._pilot.observation
        describe(
            seen.contract.number, ego, up, neighbours, ranges, memory, self._parameters, command,
            self._previous, seen.ego[0], seen.neighbours[0], seen.grid[0], seen.memory[0],
        )  # fmt: skip
        unusual = self._pilot.counters.unusual
        refusal = self._pilot.ask(command)
        if refusal is None:
            overrule(seen.contract.keeping, ego, self._previous_map, memory, self._parameters, command)
        self._remark(refusal, self._pilot.counters.unusual > unusual, t_ns)

    def remarks(self) -> tuple[StatusText, ...]:
        """Return what is to be told since the last call."""
        told, self._remarks = tuple(self._remarks), []
        return told

    def _remark(self, refusal: Refusal | None, unusual: bool, t_ns: int) -> None:
        if refusal is not None:
            self._tell(t_ns, Severity.WARNING, _TROUBLE[refusal])
        elif unusual:
            self._tell(t_ns, Severity.NOTICE, "policy sees what it hardly knows")

    def _tell(self, t_ns: int, severity: Severity, text: str) -> None:
        """Tell one thing at most every few seconds; the counters know how often it happened."""
        last_ns = self._told_ns.get(text)
        if last_ns is None or t_ns - last_ns >= _TELL_AGAIN_NS:
            self._told_ns[text] = t_ns
            self._remarks.append(StatusText(t_ns, severity, text))
