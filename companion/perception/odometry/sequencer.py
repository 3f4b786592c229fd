"""Bringing samples and scans into one order: a scan waits until the IMU covers its end."""

from collections import deque
from dataclasses import dataclass
from enum import Enum

from companion.clock import seconds_to_ns
from companion.messages import FloatArray, ImuSample, LidarScan
from companion.perception.odometry.inertial_history import InertialHistory
from companion.perception.odometry.settings import OdometrySettings

MOST_WAITING_SCANS = 10
_MOST_RATE = 200.0  # rad/s; several times what the chip can measure
_MOST_ACCELERATION = 2000.0  # m/s^2


class Arrival(Enum):
    """What became of an IMU sample."""

    FIRST = "first"
    ACCEPTED = "accepted"
    DROPPED = "dropped"
    RELABELLED = "relabelled"
    """The sensor's clock jumped while the host's shows that little time passed."""
    BROKEN = "broken"
    """So much time is missing that motion cannot be bridged."""


@dataclass(slots=True)
class SequenceCounts:
    """What was not used, since construction."""

    samples_implausible: int = 0
    samples_repeated: int = 0
    scans_overflowed: int = 0
    scans_stale: int = 0
    clock_jumps: int = 0


class Sequencer:
    """Keeps the inertial history and the scans that wait for it."""

    def __init__(self, settings: OdometrySettings) -> None:
        """Start empty."""
        self.history = InertialHistory()
        self.counts = SequenceCounts()
        self.relabelled_by_ns = 0
        self.broken_for_ns = 0
        self._settings = settings
        self._longest_ns = seconds_to_ns(settings.max_imu_gap_s)
        self._scans: deque[LidarScan] = deque()
        self._last: ImuSample | None = None

    @property
    def newest(self) -> ImuSample | None:
        """The newest accepted IMU sample."""
        return self._last

    def clear(self) -> None:
        """Forget samples and scans; the counts stay."""
        self.history.clear()
        self._scans.clear()
        self._last = None

    def add_sample(self, sample: ImuSample) -> Arrival:
        """Take an IMU sample into the history.

        On RELABELLED all remembered times have moved by `relabelled_by_ns`, so that the sample follows
        them by as much as the host's clock says; the caller moves its own times likewise. On BROKEN
        `broken_for_ns` is for how long the host saw no sample.
        """
        if not (_below(_MOST_RATE, sample.gyro_imu) and _below(_MOST_ACCELERATION, sample.accel_imu)):
            self.counts.samples_implausible += 1
            return Arrival.DROPPED
        last, self._last = self._last, sample
        if last is None:
            self._append(sample, suspect=False)
            return Arrival.FIRST
        passed_ns = sample.t_sensor_ns - last.t_sensor_ns
        if 0 < passed_ns <= self._longest_ns:
            self._append(sample, suspect=False)
            return Arrival.ACCEPTED
        if -self._longest_ns < passed_ns <= 0:
            self._last = last
            self.counts.samples_repeated += 1
            return Arrival.DROPPED
        host_passed_ns = sample.t_ns - last.t_ns
        self._scans.clear()
        self.counts.clock_jumps += 1
        if 0 < host_passed_ns <= self._longest_ns:
            self.relabelled_by_ns = passed_ns - host_passed_ns
            self.history.relabel(self.relabelled_by_ns)
            self._append(sample, suspect=True)
            return Arrival.RELABELLED
        self.broken_for_ns = host_passed_ns
        self.history.clear()
        self._append(sample, suspect=False)
        return Arrival.BROKEN

    def add_scan(self, scan: LidarScan) -> None:
        """Queue a scan; when the queue is full the oldest gives way."""
        if len(self._scans) == MOST_WAITING_SCANS:
            self._scans.popleft()
            self.counts.scans_overflowed += 1
        self._scans.append(scan)

    def covered_scan(self, after_ns: int) -> LidarScan | None:
        """Return the next scan whose end the history covers and lies after a sensor time, if any."""
        while self._scans and len(self.history):
            scan = self._scans[0]
            stale = scan.t_sensor_end_ns <= after_ns or scan.t_sensor_start_ns < self.history.first_ns
            ahead_ns = scan.t_sensor_end_ns - self.history.last_ns
            # A scan may be ahead by as long as the IMU may be silent; more is a wrong stamp, and must not
            # keep the scans behind it waiting.
            if stale or ahead_ns > self._longest_ns:
                self._scans.popleft()
                self.counts.scans_stale += 1
                continue
            if ahead_ns > 0:
                return None
            return self._scans.popleft()
        return None

    def take_scans(self, start_ns: int, end_ns: int) -> list[LidarScan]:
        """Return and remove all waiting scans that lie between two sensor times; drop older ones."""
        taken = [
            scan
            for scan in self._scans
            if scan.t_sensor_start_ns >= start_ns and scan.t_sensor_end_ns <= end_ns
        ]
        self._scans = deque(scan for scan in self._scans if scan.t_sensor_end_ns > end_ns)
        return taken

    def _append(self, sample: ImuSample, suspect: bool) -> None:
        regular = _below(self._settings.gyro_saturation, sample.gyro_imu) and _below(
            self._settings.accel_saturation, sample.accel_imu
        )
        self.history.append(
            sample.t_sensor_ns, sample.gyro_imu, sample.accel_imu, suspect=suspect or not regular
        )


def _below(limit: float, v_imu: FloatArray) -> bool:
    """Return whether all components (3,) are smaller than a limit; not a number never is."""
    x, y, z = v_imu.tolist()
    return bool(abs(x) < limit and abs(y) < limit and abs(z) < limit)
