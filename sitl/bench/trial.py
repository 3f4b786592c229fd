"""Feeds one flight to several systems at once and measures each call.

Every event goes to one system after the other, and the order rotates from scan to scan: whatever else
the computer does, and whoever warmed its caches, meets all alike.
"""

import os
from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.clock import NANOSECONDS_PER_SECOND, SystemClock, seconds_to_ns
from companion.geometry.trajectory import Trajectory
from companion.messages import FloatArray, LidarScan
from sitl.bench.contenders import Contender, Estimate, Job, SensorEvent

WARM_UP_S = 2.0
"""Scans of the first two seconds count for nothing: caches fill and our odometry waits for rest."""

_SETTLED_NS = 60 * NANOSECONDS_PER_SECOND
_NUMBERS = 12
_P, _Q, _V, _WALL, _CPU = slice(0, 3), slice(3, 7), slice(7, 10), 10, 11
_NOTE_MAX = 160
_STATM = Path("/proc/self/statm")
_PAGE_MIB = os.sysconf("SC_PAGE_SIZE") / 2**20


class Track:
    """What one system said and how long it took; memory is taken in advance."""

    def __init__(self, capacity: int) -> None:
        """Take memory for `capacity` scans; more are possible."""
        # Written to at once: untouched pages would look like growth later.
        self._t_ns = np.full(max(capacity, 16), 0, dtype=np.int64)
        self._numbers = np.full((max(capacity, 16), _NUMBERS), np.nan)
        self._count = 0

    def add(self, estimate: Estimate, wall_ns: int, cpu_ns: int) -> bool:
        """Append one estimate unless it is not finite or not newer than the last; returns whether."""
        pose, v = estimate.T_map_body, estimate.v_map
        if not (np.isfinite(pose.p).all() and np.isfinite(pose.q).all()):
            return False
        if self._count and estimate.t_sensor_ns <= self._t_ns[self._count - 1]:
            return False
        if self._count == len(self._t_ns):
            self._t_ns = np.concatenate([self._t_ns, np.zeros_like(self._t_ns)])
            self._numbers = np.concatenate([self._numbers, np.full_like(self._numbers, np.nan)])
        row = self._numbers[self._count]
        row[_P], row[_Q] = pose.p, pose.q
        if v is not None:
            row[_V] = v
        row[_WALL], row[_CPU] = 1e-6 * wall_ns, 1e-6 * cpu_ns
        self._t_ns[self._count] = estimate.t_sensor_ns
        self._count += 1
        return True

    def __len__(self) -> int:
        return self._count

    def trajectory(self) -> Trajectory:
        """Return the poses of the body by sensor time."""
        known = self._numbers[: self._count]
        return Trajectory(self._t_ns[: self._count].copy(), known[:, _P].copy(), known[:, _Q].copy())

    @property
    def v_map(self) -> FloatArray:
        """Velocities (n, 3), NaN where unknown."""
        return self._numbers[: self._count, _V]

    @property
    def wall_ms(self) -> FloatArray:
        """Real time (n,) of the call that registered each scan."""
        return self._numbers[: self._count, _WALL]

    @property
    def cpu_ms(self) -> FloatArray:
        """Processor time (n,) of the same call, all threads."""
        return self._numbers[: self._count, _CPU]


class Trial:
    """One system in one flight."""

    def __init__(self, name: str, contender: Contender, capacity: int, *, forgiving: bool = True) -> None:
        """Prepare to measure.

        Args:
            name: of the system.
            contender: fresh, without memory of another flight.
            capacity: expected number of scans.
            forgiving: what the system raises is its result; else it ends the comparison.
        """
        self.name = name
        self.setup = contender.setup
        self.track = Track(capacity)
        self.failures = 0
        self.note = ""
        self.samples = 0
        self.sample_cpu_ns = 0
        self._contender = contender
        self._forgiving = forgiving
        self._clock = SystemClock()

    @property
    def remark(self) -> str:
        """What the system complains about now, empty if nothing."""
        return self._contender.remark

    def take(self, event: SensorEvent) -> None:
        """Give the system one event."""
        for job in self._contender.jobs(event):
            self._run(job)

    def _run(self, job: Job) -> None:
        wall_ns, cpu_ns = self._clock.now_ns(), self._clock.process_cpu_ns()
        try:
            estimate = job()
        except Exception as error:
            if not self._forgiving:
                raise
            self._failed(f"{type(error).__name__}: {error}")
            return
        cpu_ns, wall_ns = self._clock.process_cpu_ns() - cpu_ns, self._clock.now_ns() - wall_ns
        if estimate is None:
            self.samples += 1
            self.sample_cpu_ns += cpu_ns
        elif not self.track.add(estimate, wall_ns, cpu_ns):
            self._failed("a pose that is not finite or not newer than the one before")

    def _failed(self, why: str) -> None:
        self.failures += 1
        self.note = self.note or " ".join(why.split())[:_NOTE_MAX]


class Race:
    """Several systems in one flight.

    Attributes:
        scan_end_ns: sensor time of the end of each scan.
        scan_host_ns: the same instants on the host's clock.
    """

    def __init__(self, trials: list[Trial], on_second: Callable[[int], None] = lambda second: None) -> None:
        """Prepare.

        Args:
            trials: the systems.
            on_second: called with the number of each finished second of the flight.
        """
        self.trials = trials
        self.scan_end_ns = array("q")
        self.scan_host_ns = array("q")
        self._orders = [trials[first:] + trials[:first] for first in range(len(trials))] or [[]]
        self._on_second = on_second
        self._second = 0
        self._settled_mib: float | None = None
        self._last_mib: float | None = None

    def take(self, event: SensorEvent) -> None:
        """Give one event to every system."""
        scans = len(self.scan_end_ns)
        if isinstance(event, LidarScan) and (not scans or event.t_sensor_end_ns > self.scan_end_ns[-1]):
            self.scan_end_ns.append(event.t_sensor_end_ns)
            self.scan_host_ns.append(event.t_sensor_end_ns + event.clock_offset_ns)
        for trial in self._orders[scans % len(self._orders)]:
            trial.take(event)
        if isinstance(event, LidarScan):
            self._note_second(event.t_sensor_end_ns - self.scan_end_ns[0])

    @property
    def counted_from_ns(self) -> int:
        """Sensor time from which scans count."""
        return self.scan_end_ns[0] + seconds_to_ns(WARM_UP_S) if self.scan_end_ns else 0

    def counted(self, t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which sensor times (n,) count."""
        return np.asarray(t_ns >= self.counted_from_ns)

    @property
    def growth_mib(self) -> float | None:
        """Memory the process gained after the first minute, None if the flight was shorter."""
        if self._settled_mib is None or self._last_mib is None:
            return None
        return self._last_mib - self._settled_mib

    def _note_second(self, flown_ns: int) -> None:
        second = flown_ns // NANOSECONDS_PER_SECOND
        if second == self._second:
            return
        self._second = second
        self._on_second(second)
        if flown_ns >= _SETTLED_NS:
            self._last_mib = resident_mib()
            if self._settled_mib is None:
                self._settled_mib = self._last_mib


def resident_mib() -> float | None:
    """Return the memory this process occupies, None where the system does not tell."""
    try:
        with _STATM.open("rb") as stream:
            return int(stream.read(256).split()[1]) * _PAGE_MIB
    except (OSError, IndexError, ValueError):
        return None
