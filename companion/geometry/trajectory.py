"""A path in time: poses by their instants, and poses between them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.geometry import rotation
from companion.geometry.rotation import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses of one frame in another, in order of time.

    Attributes:
        t_ns: (n,) instants, strictly ascending, nanoseconds on whatever clock the source keeps.
        p: (n, 3) positions, metres.
        q: (n, 4) attitudes, unit quaternions (w, x, y, z).
    """

    t_ns: NDArray[np.int64]
    p: FloatArray
    q: FloatArray

    def __post_init__(self) -> None:
        """Check shapes and order.

        Raises:
            ValueError: if the three disagree in length or times do not ascend.
        """
        n = len(self.t_ns)
        if self.p.shape != (n, 3) or self.q.shape != (n, 4):
            raise ValueError(f"{n} times with positions {self.p.shape} and attitudes {self.q.shape}")
        if np.any(np.diff(self.t_ns) <= 0):
            raise ValueError("the times of a trajectory must ascend")

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def length_m(self) -> float:
        """Length of the path."""
        return float(np.linalg.norm(np.diff(self.p, axis=0), axis=1).sum())

    def covers(self, t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which instants (m,) lie between the first and the last pose, both included."""
        if not len(self):
            return np.zeros(np.shape(t_ns), dtype=np.bool_)
        return np.asarray((t_ns >= self.t_ns[0]) & (t_ns <= self.t_ns[-1]))

    def at(self, t_ns: NDArray[np.int64]) -> "Trajectory":
        """Return the poses at ascending instants (m,): positions linearly, attitudes along the shortest arc.

        Raises:
            ValueError: if an instant lies outside the trajectory.
        """
        if not self.covers(t_ns).all():
            raise ValueError("an instant lies outside the trajectory")
        if len(self) == 1:
            return self
        after = np.clip(np.searchsorted(self.t_ns, t_ns), 1, len(self) - 1)
        before = after - 1
        fraction = (t_ns - self.t_ns[before]) / (self.t_ns[after] - self.t_ns[before])
        p = self.p[before] + fraction[:, None] * (self.p[after] - self.p[before])
        q = rotation.slerp(self.q[before], self.q[after], fraction)
        return Trajectory(np.asarray(t_ns, dtype=np.int64), p, rotation.normalize(q))
