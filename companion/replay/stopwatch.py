"""How far a replay has come, and how fast it goes."""

from collections.abc import Callable

from companion.clock import SystemClock, ns_to_seconds, seconds_to_ns

Progress = Callable[[float | None, float, float], None]
"""Told how much of the file has been read (0 to 1, None if unknown), the seconds of flight, and how many
times faster than real time that was."""

_PERIOD_NS = seconds_to_ns(0.25)
_EVERY = 100


class Stopwatch:
    """Compares the time in a recording with the time that passes here.

    Attributes:
        start_ns: earliest host time in the recording.
    """

    def __init__(self, clock: SystemClock, on_progress: Progress | None) -> None:
        """Start."""
        self.start_ns = 0
        self._clock = clock
        self._on_progress = on_progress
        self._begun_ns = self._told_ns = clock.now_ns()
        self._end_ns = 0
        self._observed = 0

    @property
    def seconds(self) -> float:
        """Time in the recording from its first message to its last so far."""
        return ns_to_seconds(self._end_ns - self.start_ns)

    @property
    def wall_s(self) -> float:
        """Time that passed here."""
        return ns_to_seconds(self._clock.now_ns() - self._begun_ns)

    def observe(self, t_ns: int, fraction: float | None) -> None:
        """Note a message of the recording at host time `t_ns`, and how much of the file has been read."""
        if not self._observed:
            self.start_ns = self._end_ns = t_ns
        self.start_ns = min(self.start_ns, t_ns)
        self._end_ns = max(self._end_ns, t_ns)
        self._observed += 1
        if self._on_progress is None or self._observed % _EVERY:
            return
        now_ns = self._clock.now_ns()
        if now_ns - self._told_ns >= _PERIOD_NS:
            self._told_ns = now_ns
            self._on_progress(fraction, self.seconds, self.seconds / self.wall_s)
