"""Time sources: the only place that reads a real clock or sleeps.

All times are integer nanoseconds. `SystemClock` is monotonic and unrelated to the time of day, so a
step of the host's calendar clock moves nothing in flight.
"""

import asyncio
import time
from typing import Protocol

NANOSECONDS_PER_SECOND = 1_000_000_000


def seconds_to_ns(seconds: float) -> int:
    """Convert a duration in seconds to integer nanoseconds."""
    return round(seconds * NANOSECONDS_PER_SECOND)


def ns_to_seconds(duration_ns: int) -> float:
    """Convert a duration in integer nanoseconds to seconds."""
    return duration_ns / NANOSECONDS_PER_SECOND


class Clock(Protocol):
    """Source of the present time."""

    def now_ns(self) -> int:
        """Return the present time in nanoseconds; never goes backwards."""
        ...


class SystemClock:
    """Monotonic host clock, shared by all threads of the process."""

    def now_ns(self) -> int:
        """Return the monotonic host time in nanoseconds."""
        return time.monotonic_ns()

    def calendar_ns(self) -> int:
        """Return nanoseconds since the Unix epoch, for file names and log metadata only."""
        return time.time_ns()

    def thread_cpu_ns(self) -> int:
        """Return the processor time that the calling thread has used, for measurements."""
        return time.thread_time_ns()

    def process_cpu_ns(self) -> int:
        """Return the processor time that all threads of this process have used, for measurements."""
        return time.process_time_ns()

    async def sleep(self, duration_ns: int) -> None:
        """Suspend the calling task for a duration in nanoseconds (at once when not positive)."""
        await asyncio.sleep(max(0, duration_ns) / NANOSECONDS_PER_SECOND)

    async def sleep_until(self, t_ns: int) -> None:
        """Suspend the calling task until the monotonic time `t_ns`."""
        await self.sleep(t_ns - self.now_ns())

    def pause(self, duration_ns: int) -> None:
        """Block the calling thread for a duration in nanoseconds; never call it on the event loop."""
        time.sleep(max(0, duration_ns) / NANOSECONDS_PER_SECOND)


class StepClock:
    """Simulated time that moves only when told to."""

    def __init__(self, start_ns: int = 0) -> None:
        """Start at `start_ns` nanoseconds."""
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """Return the simulated time in nanoseconds."""
        return self._now_ns

    def advance_to(self, t_ns: int) -> None:
        """Move to `t_ns` nanoseconds.

        Raises:
            ValueError: if `t_ns` lies in the past.
        """
        if t_ns < self._now_ns:
            raise ValueError(f"clock cannot go back from {self._now_ns} ns to {t_ns} ns")
        self._now_ns = t_ns
