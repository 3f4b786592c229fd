"""Offset from the sensor's clock to the host's, from receive times that are late by unknown amounts.

A datagram is never received before it was sent, so the smallest difference of receive time and stamp
within a short window is the offset plus the smallest transport delay. The published offset follows
that minimum no faster than a limit, so nothing downstream ever sees time jump. Only a restart of the
sensor's clock makes it jump, and a restart is counted.
"""

from collections import deque

from companion.clock import seconds_to_ns

BUCKET_NS = seconds_to_ns(0.25)
BUCKETS = 8
ACQUISITION_NS = seconds_to_ns(1.0)
# Crystals differ by less than 100 ppm and the filter adds little: 500 ppm follows any real drift.
RISE_LIMIT_PPM = 500
# Falling is firm evidence of an earlier overestimate, so it may go faster.
FALL_LIMIT_PPM = 5_000
IMPOSSIBLY_EARLY_NS = seconds_to_ns(0.05)


class ClockOffsetEstimator:
    """Windowed minimum of receive time minus stamp, followed at a limited rate."""

    def __init__(self) -> None:
        """Know nothing yet."""
        self._restarts = 0
        self._t_start_ns: int | None = None
        self._t_last_ns = 0
        self._t_bucket_ns = 0
        self._offset_ns = 0
        self._minimum_ns = 0
        self._window_minimum_ns = 0
        self._allowance_left = 0
        self._minima_ns: deque[int] = deque(maxlen=BUCKETS)

    @property
    def offset_ns(self) -> int:
        """Host time minus sensor time, 0 before the first sample."""
        return self._offset_ns

    @property
    def settled(self) -> bool:
        """Whether the offset has left its first second, in which it still follows the minimum freely."""
        return self._t_start_ns is not None and self._t_last_ns - self._t_start_ns >= ACQUISITION_NS

    @property
    def restarts(self) -> int:
        """How often the sensor's clock jumped or started again."""
        return self._restarts

    def update(self, t_host_ns: int, t_sensor_ns: int) -> bool:
        """Take one pair of receive time and stamp.

        Returns:
            True if the pair proves that the sensor's clock jumped; the estimate then starts anew.
        """
        difference_ns = t_host_ns - t_sensor_ns
        if self._t_start_ns is None:
            self._begin(t_host_ns, difference_ns)
            return False
        if difference_ns < self._offset_ns - IMPOSSIBLY_EARLY_NS:
            self._restart(t_host_ns, difference_ns)
            return True
        if difference_ns < self._minimum_ns:
            self._minimum_ns = difference_ns
        if t_host_ns - self._t_bucket_ns >= BUCKET_NS:
            self._close_bucket(t_host_ns, difference_ns)
        target_ns = min(self._window_minimum_ns, self._minimum_ns)
        if target_ns != self._offset_ns:
            self._follow(t_host_ns, target_ns)
            return False
        self._allowance_left = 0  # there is nothing to follow, as nearly always
        if t_host_ns > self._t_last_ns:
            self._t_last_ns = t_host_ns
        return False

    def declare_restart(self, t_host_ns: int, t_sensor_ns: int) -> bool:
        """Start anew at a pair after stamps went backwards, unless the pair fits the estimate.

        Returns:
            True if the estimate started anew.
        """
        difference_ns = t_host_ns - t_sensor_ns
        if self._t_start_ns is not None and abs(difference_ns - self._offset_ns) <= IMPOSSIBLY_EARLY_NS:
            return False
        self._restart(t_host_ns, difference_ns)
        return True

    def _restart(self, t_host_ns: int, difference_ns: int) -> None:
        self._restarts += 1
        self._begin(t_host_ns, difference_ns)

    def _begin(self, t_host_ns: int, difference_ns: int) -> None:
        self._minima_ns.clear()
        self._allowance_left = 0
        self._t_start_ns = self._t_last_ns = self._t_bucket_ns = t_host_ns
        self._offset_ns = self._minimum_ns = self._window_minimum_ns = difference_ns

    def _close_bucket(self, t_host_ns: int, difference_ns: int) -> None:
        self._minima_ns.append(self._minimum_ns)
        self._window_minimum_ns = min(self._minima_ns)
        self._minimum_ns = difference_ns
        self._t_bucket_ns = t_host_ns

    def _follow(self, t_host_ns: int, target_ns: int) -> None:
        elapsed_ns = max(0, t_host_ns - self._t_last_ns)
        self._t_last_ns += elapsed_ns
        error_ns = target_ns - self._offset_ns
        if not self.settled:
            self._offset_ns += min(error_ns, 0)
            return
        limit_ppm = RISE_LIMIT_PPM if error_ns > 0 else FALL_LIMIT_PPM
        # Remainders are kept, so that many small steps add up to the limit exactly.
        allowance = self._allowance_left + elapsed_ns * limit_ppm
        step_ns = min(abs(error_ns), allowance // 1_000_000)
        self._allowance_left = allowance - step_ns * 1_000_000 if step_ns < abs(error_ns) else 0
        self._offset_ns += step_ns if error_ns > 0 else -step_ns
