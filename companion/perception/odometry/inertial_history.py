"""The newest IMU samples in time order, and the stretch between any two instants."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray

CAPACITY = 2048
"""Samples kept: ten seconds at 200 Hz."""


@dataclass(frozen=True, slots=True, eq=False)
class InertialStretch:
    """Consecutive intervals between samples; the first and last may be cut short.

    Attributes:
        t_s: (n,) limits of the intervals, seconds after the origin that was asked for, ascending.
        inertial: (n - 1, 6) mean gyro rad/s and specific force m/s^2 of each interval.
        suspect: (n - 1,) whether an interval's samples are saturated or follow a break.
    """

    t_s: FloatArray
    inertial: FloatArray
    suspect: NDArray[np.bool_]


class InertialHistory:
    """Bounded memory of IMU samples, oldest dropped first."""

    def __init__(self) -> None:
        """Take all memory at once."""
        self._t_ns = np.zeros(2 * CAPACITY, dtype=np.int64)
        self._inertial = np.zeros((2 * CAPACITY, 6))
        self._suspect = np.zeros(2 * CAPACITY, dtype=np.bool_)
        self._begin = 0
        self._end = 0

    def __len__(self) -> int:
        return self._end - self._begin

    @property
    def first_ns(self) -> int:
        """Time of the oldest sample."""
        return int(self._t_ns[self._begin])

    @property
    def last_ns(self) -> int:
        """Time of the newest sample."""
        return int(self._t_ns[self._end - 1])

    @property
    def samples(self) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.bool_]]:
        """Times (n,), gyro and specific force (n, 6) and suspicion (n,) of all samples, as views."""
        kept = slice(self._begin, self._end)
        return self._t_ns[kept], self._inertial[kept], self._suspect[kept]

    def clear(self) -> None:
        """Forget all samples."""
        self._begin = self._end = 0

    def append(self, t_ns: int, gyro_imu: FloatArray, accel_imu: FloatArray, suspect: bool) -> None:
        """Add a sample newer than all others."""
        if self._end == len(self._t_ns):
            keep = slice(self._end - CAPACITY + 1, self._end)
            for column in (self._t_ns, self._inertial, self._suspect):
                column[: CAPACITY - 1] = column[keep]
            self._begin, self._end = 0, CAPACITY - 1
        self._t_ns[self._end] = t_ns
        self._inertial[self._end, :3] = gyro_imu
        self._inertial[self._end, 3:] = accel_imu
        self._suspect[self._end] = suspect
        self._end += 1
        self._begin = max(self._begin, self._end - CAPACITY)

    def relabel(self, shift_ns: int) -> None:
        """Move all times by `shift_ns`: the sensor's clock was set, the motion went on."""
        self._t_ns[self._begin : self._end] += shift_ns

    def between(self, start_ns: int, end_ns: int, origin_ns: int) -> InertialStretch:
        """Return what was measured from one instant to another.

        A sample is the mean over the interval that ends with it, as a filter that averages between
        samples makes it; so the motion is integrated up to the newest sample without delay. Before the
        oldest sample and after the newest, the nearest one holds.

        Args:
            start_ns: first instant.
            end_ns: last instant, later than the first.
            origin_ns: zero of the returned times.

        Raises:
            ValueError: without samples, or if the instants are not in order.
        """
        if len(self) == 0 or start_ns >= end_ns:
            raise ValueError(f"no inertial stretch between {start_ns} ns and {end_ns} ns")
        times = self._t_ns[self._begin : self._end]
        low = int(np.searchsorted(times, start_ns, side="right"))
        high = int(np.searchsorted(times, end_ns, side="left"))
        t_ns = np.empty(high - low + 2, dtype=np.int64)
        t_ns[0], t_ns[-1] = start_ns, end_ns
        t_ns[1:-1] = times[low:high]
        index = np.arange(self._begin + low, self._begin + high + 1)
        index[-1] = min(index[-1], self._end - 1)
        return InertialStretch(
            (t_ns - origin_ns).astype(np.float64) * 1e-9, self._inertial[index], self._suspect[index]
        )
