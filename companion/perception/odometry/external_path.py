"""The way between poses that somebody else states: through every pose, in the IMU's shape between them."""

import numpy as np
from numpy.typing import NDArray

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.odometry import external_kernels
from companion.perception.odometry.inertial_history import CAPACITY, InertialHistory
from companion.perception.odometry.kernels import SEGMENT_WIDTH

MOTION_SIZE = 15
P, R, V = slice(0, 3), slice(3, 12), slice(12, 15)
_TIME, _P, _R, _V, _A, _OMEGA = 0, slice(1, 4), slice(4, 13), slice(13, 16), slice(16, 19), slice(19, 22)
_ROWS = 4096
"""Rows kept: several seconds of poses and IMU samples, both at 200 Hz."""


def motion_of(p_map: FloatArray, R_map_imu: FloatArray, v_map: FloatArray) -> FloatArray:
    """Return the vector (15,) of a motion."""
    return np.concatenate([p_map, R_map_imu.ravel(), v_map])


class DeadReckoning:
    """Carries a motion of the IMU forward through its samples."""

    def __init__(self, gravity: float) -> None:
        """Take all memory at once; `gravity` in m/s^2."""
        self._gravity = gravity
        self.gyro_bias = np.zeros(3)
        self.segments = np.zeros((CAPACITY + 2, SEGMENT_WIDTH))
        self.count = 0

    def advance(self, motion: FloatArray, history: InertialHistory, start_ns: int, end_ns: int) -> FloatArray:
        """Move a motion (15,) in place from one sensor time to a later one; return the rate (3,) at the end.

        `segments` then hold the way, in seconds after `start_ns`.
        """
        stretch = history.between(start_ns, end_ns, start_ns)
        inertial = stretch.inertial.copy()
        inertial[:, :3] -= self.gyro_bias
        external_kernels.dead_reckon(motion, stretch.t_s, inertial, self._gravity, self.segments)
        self.count = len(stretch.t_s)
        return np.asarray(inertial[-1, :3])


class StatedPath:
    """Bounded memory of the newest way, as rows for de-skewing."""

    def __init__(self) -> None:
        """Take all memory at once."""
        self._t_ns = np.zeros(_ROWS, dtype=np.int64)
        self._rows = np.zeros((_ROWS, SEGMENT_WIDTH))
        # Bending the way puts the noise of positions into velocities and rates: these are the true ones.
        self._twists = np.zeros((_ROWS, 6))
        self._count = 0
        self._end_ns = 0
        self._end = np.zeros(SEGMENT_WIDTH)
        self._end_twist = np.zeros(6)

    def begin(self, t_ns: int, motion: FloatArray) -> None:
        """Forget the way and start at a motion (15,)."""
        self._count = 0
        self._end_ns = t_ns
        self._end[1:16] = motion
        self._end[16:] = 0.0
        self._end_twist[:3] = motion[V]
        self._end_twist[3:] = 0.0

    def extend(self, t_ns: int, motion: FloatArray, predicted: FloatArray) -> None:
        """Add the way from the newest motion to the next.

        Args:
            t_ns: sensor time of the next motion.
            motion: (15,) as stated.
            predicted: (n, 22) the way that the IMU shows from the motion before, in seconds after it; it is
                bent so that it ends where the next motion is.
        """
        rows = predicted[:-1].copy()
        duration_s = float(predicted[-1, _TIME])
        miss = motion[P] - predicted[-1, _P]
        R_end = predicted[-1, _R].reshape(3, 3)
        turn = rotation.log(rotation.from_matrix(R_end.T @ motion[R].reshape(3, 3)))
        share = rows[:, _TIME] / duration_s
        twists = np.concatenate([rows[:, _V], rows[:, _OMEGA]], axis=1)
        twists[:, :3] += share[:, None] * (motion[V] - predicted[-1, _V])
        rows[:, _P] += share[:, None] * miss
        rows[:, _V] += miss / duration_s
        bend = rotation.to_matrix(rotation.exp(share[:, None] * turn))
        rows[:, _R] = (rows[:, _R].reshape(-1, 3, 3) @ bend).reshape(-1, 9)
        rows[:, _OMEGA] += turn / duration_s
        self._append(self._end_ns + np.rint(rows[:, _TIME] * 1e9).astype(np.int64), rows, twists)
        self._end_ns = t_ns
        self._end[1:16] = motion
        self._end[16:] = rows[-1, 16:]
        self._end_twist[:3] = motion[V]
        self._end_twist[3:] = twists[-1, 3:]

    def relabel(self, shift_ns: int) -> None:
        """Move all times by `shift_ns`: the sensor's clock was set, the motion went on."""
        self._t_ns[: self._count] += shift_ns
        self._end_ns += shift_ns

    @property
    def end_ns(self) -> int:
        """Sensor time of the newest motion."""
        return self._end_ns

    def covers(self, start_ns: int, end_ns: int) -> bool:
        """Whether the way leads from one sensor time to another."""
        return self._count > 0 and int(self._t_ns[0]) <= start_ns and end_ns <= self._end_ns

    def between(self, start_ns: int, end_ns: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the way from one sensor time to another, both of them covered.

        Returns:
            Rows (n, 22) from at or before the first time, in seconds after it, to the second; the motion
            (15,) and the rate (3,) at the second.
        """
        times = self._t_ns[: self._count]
        first = int(np.searchsorted(times, start_ns, side="right")) - 1
        last = int(np.searchsorted(times, end_ns, side="left"))
        rows = np.empty((last - first + 1, SEGMENT_WIDTH))
        rows[:-1] = self._rows[first:last]
        rows[:-1, _TIME] = (times[first:last] - start_ns) * 1e-9
        before_ns = int(times[last - 1])
        known = last < self._count
        after_ns = int(times[last]) if known else self._end_ns
        twist = self._twists[last] if known else self._end_twist
        if end_ns == after_ns:
            rows[-1] = self._rows[last] if known else self._end
        else:
            rows[-1] = _moved(rows[-2], (end_ns - before_ns) * 1e-9)
            share = (end_ns - before_ns) / (after_ns - before_ns)
            twist = self._twists[last - 1] + share * (twist - self._twists[last - 1])
        rows[-1, _TIME] = (end_ns - start_ns) * 1e-9
        motion = rows[-1, 1:16].copy()
        motion[V] = twist[:3]
        return rows, motion, twist[3:].copy()

    def _append(self, t_ns: NDArray[np.int64], rows: FloatArray, twists: FloatArray) -> None:
        count = len(rows)
        if self._count + count > _ROWS:
            keep = min(self._count, _ROWS // 2)
            old = slice(self._count - keep, self._count)
            for column in (self._t_ns, self._rows, self._twists):
                column[:keep] = column[old].copy()
            self._count = keep
        new = slice(self._count, self._count + count)
        self._t_ns[new], self._rows[new], self._twists[new] = t_ns, rows, twists
        self._count += count


def _moved(row: FloatArray, dt: float) -> FloatArray:
    """Return a row's motion `dt` seconds later, acceleration and rate unchanged."""
    moved = row.copy()
    moved[_P] += (row[_V] + 0.5 * row[_A] * dt) * dt
    moved[_V] += row[_A] * dt
    turn = rotation.to_matrix(rotation.exp(row[_OMEGA] * dt))
    moved[_R] = (row[_R].reshape(3, 3) @ turn).ravel()
    return moved
