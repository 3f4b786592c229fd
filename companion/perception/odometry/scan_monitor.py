"""Is the laser alive and believable? Judged from a scan as it arrives, before it is matched."""

from collections import deque

import numpy as np

from companion.clock import seconds_to_ns
from companion.messages import ImuSample, LidarScan, PointArray
from companion.perception.odometry.settings import OdometrySettings

_COMPARED = 64  # points, evenly from the whole scan; noise alone makes each of them unique
_REMEMBERED = 15  # scans that say how stamps and arrivals usually lie
_LEAST_REMEMBERED = 5
_BLOCKED_RANGE_M = 0.8
_BLOCKED_SHARE = 0.8


class ScanMonitor:
    """Watches for scans that repeat, see nothing or only what is on the lens, or change their clock."""

    def __init__(self, settings: OdometrySettings) -> None:
        """Begin without any scan."""
        self._settings = settings
        self._tolerance_ns = seconds_to_ns(settings.stamp_tolerance_s)
        self._silent_ns = seconds_to_ns(settings.imu_silent_after_s)
        self._previous: PointArray = np.zeros((0, 3), dtype=np.float32)
        self._lags_ns: deque[int] = deque(maxlen=_REMEMBERED)
        self._moved_ns = 0

    def observe(self, scan: LidarScan, newest: ImuSample | None) -> str:
        """Take a scan as it arrives; return what is wrong, or "".

        Args:
            scan: the newest scan.
            newest: the newest IMU sample that arrived before it.
        """
        return self._seen(scan.points_lidar) or self._repeated(scan.points_lidar) or self._late(scan, newest)

    def _seen(self, points_lidar: PointArray) -> str:
        count = len(points_lidar)
        if count < self._settings.min_effective_points:
            return f"LiDAR sees nothing: {count} returns"
        sample = points_lidar[:: max(1, count // 512)]
        square = np.einsum("ij,ij->i", sample, sample)
        near = float(np.count_nonzero(square < _BLOCKED_RANGE_M**2)) / len(sample)
        if near > _BLOCKED_SHARE:
            return f"LiDAR blocked: {100.0 * near:.0f} % of its returns nearer than {_BLOCKED_RANGE_M} m"
        return ""

    def _repeated(self, points_lidar: PointArray) -> str:
        """Compare with the scan before."""
        sample = points_lidar[:: max(1, len(points_lidar) // _COMPARED)].copy()
        before, self._previous = self._previous, sample
        return "LiDAR frozen: scans repeat" if np.array_equal(sample, before) else ""

    def _late(self, scan: LidarScan, newest: ImuSample | None) -> str:
        """Compare how long after its own stamp a scan arrives with how long an IMU sample takes.

        Both streams carry stamps of one clock over one cable, so the difference hardly changes. A new
        difference is reported until it is the usual one.
        """
        if newest is None or scan.t_ns - newest.t_ns > self._silent_ns:
            return ""
        lag_ns = (scan.t_ns - scan.t_sensor_end_ns) - (newest.t_ns - newest.t_sensor_ns)
        usual_ns = int(np.median(self._lags_ns)) if len(self._lags_ns) >= _LEAST_REMEMBERED else lag_ns
        self._lags_ns.append(lag_ns)
        before_ns, self._moved_ns = self._moved_ns, lag_ns - usual_ns
        # One scan alone may have been held up on its way.
        lasting_ns = min(abs(before_ns), abs(self._moved_ns)) if before_ns * self._moved_ns > 0 else 0
        if lasting_ns <= self._tolerance_ns:
            return ""
        return f"stamps of scans moved by {self._moved_ns * 1e-6:+.0f} ms against the IMU's"
