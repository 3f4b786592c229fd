"""Rigid transforms. `T_a_b` maps coordinates in frame b to coordinates in frame a."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from companion.geometry import rotation
from companion.geometry.rotation import FloatArray


@dataclass(frozen=True, slots=True)
class Pose:
    """One rigid transform T_a_b.

    Attributes:
        p: origin of frame b in frame a, shape (3,), metres.
        q: attitude q_a_b, shape (4,), unit quaternion (w, x, y, z).
    """

    p: FloatArray
    q: FloatArray

    @classmethod
    def of(cls, p: ArrayLike, q: ArrayLike) -> "Pose":
        """Build from anything array-like, normalising the quaternion."""
        return cls(np.asarray(p, dtype=np.float64).copy(), rotation.normalize(q))

    @classmethod
    def identity(cls) -> "Pose":
        """Return the transform between two equal frames."""
        return cls(np.zeros(3), rotation.IDENTITY.copy())

    def __matmul__(self, other: "Pose") -> "Pose":
        """Return T_a_c = T_a_b @ T_b_c."""
        return Pose(
            self.p + rotation.rotate(self.q, other.p),
            rotation.normalize(rotation.multiply(self.q, other.q)),
        )

    def inverse(self) -> "Pose":
        """Return T_b_a."""
        q_b_a = rotation.conjugate(self.q)
        return Pose(-rotation.rotate(q_b_a, self.p), q_b_a)

    def transform(self, p_b: ArrayLike) -> FloatArray:
        """Return points p_a (..., 3) of points p_b (..., 3)."""
        return self.p + rotation.rotate(self.q, p_b)


def interpolate(start: Pose, end: Pose, fraction: float) -> Pose:
    """Return the pose a `fraction` of the way from `start` (0) to `end` (1): straight line, shortest arc."""
    return Pose(
        start.p + fraction * (end.p - start.p),
        rotation.normalize(rotation.slerp(start.q, end.q, fraction)),
    )
