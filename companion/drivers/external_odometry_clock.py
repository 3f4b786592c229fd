"""When another process's message was valid, on the host's clock, from stamps on a clock of its own.

A stamp may be older than the one before only if the sender's clock was set, so that is believed as soon
as several messages in a row agree about it; being late is never taken for a clock that was set, because a
queue somewhere looks just the same.
"""

from enum import Enum

from companion.clock import NANOSECONDS_PER_SECOND, seconds_to_ns
from companion.drivers.external_odometry_settings import ExternalOdometrySettings
from companion.drivers.livox_clock import ClockOffsetEstimator

_MAX_FUTURE_NS = seconds_to_ns(0.05)
_MAX_STAMP_NS = 2**62
_PROOFS = 5


class StampVerdict(Enum):
    """What is thought of one stamp."""

    ACCEPTED = "accepted"
    BEGUN_ANEW = "begun anew"
    """The first stamp of a clock, or of one that was set."""
    MISSING = "stamp missing"
    REPEATED = "stamp repeated"
    OUT_OF_ORDER = "out of order"
    TOO_OFTEN = "too often"
    FUTURE = "in the future"
    LATE = "late"


class SourceClockFollower:
    """Judges the stamps of one sender and keeps the offset of its clock."""

    def __init__(self, settings: ExternalOdometrySettings) -> None:
        """Know nothing yet."""
        self._is_host_clock = settings.clock == "host_monotonic"
        self._min_delay_ns = round(settings.min_delay_ms * 1e6) if settings.clock == "estimated" else 0
        self._max_delay_ns = round(settings.max_delay_ms * 1e6)
        self._min_period_ns = round(0.5 * NANOSECONDS_PER_SECOND / settings.max_rate_hz)
        self._estimator = ClockOffsetEstimator()
        self._t_last_ns: int | None = None
        self._t_odd_ns = 0
        self._proofs = 0

    @property
    def offset_ns(self) -> int:
        """Host time minus the sender's time."""
        return 0 if self._is_host_clock else self._estimator.offset_ns - self._min_delay_ns

    def judge(self, t_host_ns: int, time_usec: int) -> StampVerdict:
        """Take the stamp of a message received at `t_host_ns`.

        One that is refused moves nothing, except that a late one still tells about the clock.

        Args:
            t_host_ns: host time of reception.
            time_usec: the message's stamp, microseconds on the sender's clock.
        """
        t_ns = time_usec * 1000
        if not 0 < t_ns < _MAX_STAMP_NS:
            return StampVerdict.MISSING
        if self._t_last_ns is None:
            return self._begin(t_host_ns, t_ns)
        verdict = self._against_the_last(t_ns, self._t_last_ns)
        if verdict is None and t_host_ns - t_ns < self._least_difference_ns():
            verdict = StampVerdict.FUTURE
        if verdict in (StampVerdict.OUT_OF_ORDER, StampVerdict.FUTURE):
            # In the first second the offset is but a guess: a message that was less late is welcome.
            guessed = (
                verdict is StampVerdict.FUTURE and not self._is_host_clock and not self._estimator.settled
            )
            return self._begin(t_host_ns, t_ns) if self._is_proven(t_ns) or guessed else verdict
        if verdict is not None:
            return verdict
        self._proofs = 0
        self._t_last_ns = t_ns
        self._estimator.update(t_host_ns, t_ns)
        if t_host_ns - t_ns - self.offset_ns > self._max_delay_ns:
            return StampVerdict.LATE
        return StampVerdict.ACCEPTED

    def _against_the_last(self, t_ns: int, t_last_ns: int) -> StampVerdict | None:
        if t_ns == t_last_ns:
            return StampVerdict.REPEATED
        if t_ns < t_last_ns:
            return StampVerdict.OUT_OF_ORDER
        return StampVerdict.TOO_OFTEN if t_ns - t_last_ns < self._min_period_ns else None

    def _least_difference_ns(self) -> int:
        """Return the least difference of reception and stamp that is believed."""
        return (0 if self._is_host_clock else self._estimator.offset_ns) - _MAX_FUTURE_NS

    def _is_proven(self, t_ns: int) -> bool:
        """Whether enough messages in a row have agreed that the sender's clock was set."""
        follows = 0 < t_ns - self._t_odd_ns < NANOSECONDS_PER_SECOND
        self._t_odd_ns = t_ns
        self._proofs = self._proofs + 1 if follows else 1
        return self._proofs >= _PROOFS

    def _begin(self, t_host_ns: int, t_ns: int) -> StampVerdict:
        if self._is_host_clock and t_host_ns - t_ns < -_MAX_FUTURE_NS:
            return StampVerdict.FUTURE
        self._proofs = 0
        self._t_last_ns = t_ns
        if self._is_host_clock and t_host_ns - t_ns > self._max_delay_ns:
            return StampVerdict.LATE
        self._estimator = ClockOffsetEstimator()
        self._estimator.update(t_host_ns, t_ns)
        return StampVerdict.BEGUN_ANEW
