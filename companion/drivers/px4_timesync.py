"""The autopilot's clock as seen from the host: TIMESYNC in both directions.

We ask with (tc1 = 0, ts1 = our time); the autopilot answers (tc1 = its time, ts1 copied). Halfway
through the round trip both clocks showed those values. When the autopilot asks, we answer with our
estimate of *its* time, so it finds an offset of about zero and stamps that we convert and stamps that
it converts mean the same, before and after its own estimate has converged (500 samples, about 50 s).
"""

from collections import deque
from dataclasses import dataclass

from companion.clock import seconds_to_ns
from companion.drivers.mavlink_fields import integer
from companion.messages import MavlinkMessage

_INT64_MAX = 2**63 - 1
# Clocks are assumed to differ by up to 1 % in rate (a simulator was measured 0.7 % slow).
_RATE_BOUND_PPT = 10
_WINDOW_NS = seconds_to_ns(1.0)
_MAX_ROUND_TRIP_NS = seconds_to_ns(0.1)
_MAX_ANSWER_AGE_NS = seconds_to_ns(10.0)
_JUMP_NS = seconds_to_ns(0.2)
# Three answers in a row must agree on a new time before the old one is given up.
_JUMP_ANSWERS = 3
_MAX_OPEN_REQUESTS = 16


@dataclass(frozen=True, slots=True)
class ClockSample:
    """One comparison: autopilot time minus host time, and how long asking took."""

    t_ns: int
    offset_ns: int
    round_trip_ns: int

    def uncertainty_ns(self, t_ns: int) -> int:
        """Return the largest error of the offset at `t_ns`: half the round trip plus drift since."""
        return self.round_trip_ns // 2 + (t_ns - self.t_ns) * _RATE_BOUND_PPT // 1000


class AutopilotClock:
    """Estimates the autopilot's time; notices when the autopilot has started anew."""

    def __init__(self, period_ns: int, address: tuple[int, int]) -> None:
        """Ask every `period_ns` nanoseconds; `address` is our own system and component id."""
        self._period_ns = period_ns
        # An answer of an older autopilot names nobody.
        self._addresses = ((0, 0), address)
        self._due_ns: int | None = None
        self._open: deque[int] = deque(maxlen=_MAX_OPEN_REQUESTS)
        self._samples: deque[ClockSample] = deque()
        self._suspects: list[ClockSample] = []
        self.unmatched = 0
        """Answers to questions never asked, or answered too late."""

    @property
    def round_trip_ns(self) -> int | None:
        """Round trip of the comparison in use, or None."""
        return self._samples[-1].round_trip_ns if self._samples else None

    def offset_ns(self, t_ns: int) -> int | None:
        """Return autopilot time minus host time at `t_ns`, or None while it is not known.

        Of the last second's comparisons the one with the smallest bound on its error counts. After 10 s
        without an answer, and while answers contradict the estimate, nothing is known.
        """
        if not self._samples or self._suspects or t_ns - self._samples[-1].t_ns > _MAX_ANSWER_AGE_NS:
            return None
        return min(self._samples, key=lambda sample: sample.uncertainty_ns(t_ns)).offset_ns

    def autopilot_ns(self, t_ns: int, now_ns: int) -> int | None:
        """Return the autopilot's time at host time `t_ns`, as known at `now_ns`; None if unknown."""
        offset_ns = self.offset_ns(now_ns)
        return None if offset_ns is None else t_ns + offset_ns

    def request(self, t_ns: int) -> dict[str, object] | None:
        """Return the fields of a question when one is due, else None."""
        if self._due_ns is not None and t_ns < self._due_ns:
            return None
        on_time = self._due_ns is not None and t_ns - self._due_ns < self._period_ns
        self._due_ns = (self._due_ns if on_time and self._due_ns is not None else t_ns) + self._period_ns
        self._open.append(t_ns)
        return {"tc1": 0, "ts1": t_ns}

    def receive(self, message: MavlinkMessage, t_ns: int) -> tuple[dict[str, object] | None, bool]:
        """Take a TIMESYNC message received at `t_ns`.

        Returns:
            The fields of the answer if it was a question that can be answered, and whether the
            autopilot's time was found to have gone back, which means that it has started anew.

        Raises:
            ProtocolError: if its fields are not times.
        """
        tc1 = integer(message, "tc1", -_INT64_MAX, _INT64_MAX)
        ts1 = integer(message, "ts1", -_INT64_MAX, _INT64_MAX)
        if tc1 == 0:
            autopilot_ns = self.autopilot_ns(t_ns, t_ns)
            if autopilot_ns is None or autopilot_ns <= 0:
                return None, False
            return {"tc1": autopilot_ns, "ts1": ts1}, False
        addressee = tuple(
            integer(message, name, 0, 0xFF) if name in message.fields else 0
            for name in ("target_system", "target_component")
        )
        if addressee not in self._addresses:
            return None, False
        if ts1 not in self._open or not 0 <= t_ns - ts1 <= _MAX_ROUND_TRIP_NS or tc1 < 0:
            self.unmatched += 1
            return None, False
        self._open.remove(ts1)
        round_trip_ns = t_ns - ts1
        return None, self._take(ClockSample(t_ns, tc1 - ts1 - round_trip_ns // 2, round_trip_ns))

    def _take(self, sample: ClockSample) -> bool:
        known = self._samples[-1] if self._samples else None
        if known is None or self._agrees(known, sample):
            self._suspects.clear()
            self._samples.append(sample)
            while sample.t_ns - self._samples[0].t_ns > _WINDOW_NS:
                self._samples.popleft()
            return False
        if self._suspects and not self._agrees(self._suspects[-1], sample):
            self._suspects.clear()
        self._suspects.append(sample)
        if len(self._suspects) < _JUMP_ANSWERS:
            return False
        went_back = sample.offset_ns < known.offset_ns
        self._samples = deque(self._suspects)
        self._suspects = []
        return went_back

    @staticmethod
    def _agrees(earlier: ClockSample, later: ClockSample) -> bool:
        drift_ns = (later.t_ns - earlier.t_ns) * _RATE_BOUND_PPT // 1000
        return abs(later.offset_ns - earlier.offset_ns) <= _JUMP_NS + drift_ns
