"""How far an estimated trajectory lies from the truth. Poses with equal index belong to equal times."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.geometry.rotation import FloatArray


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Errors over a trajectory.

    Attributes:
        rmse_m, median_m, max_m: of the position errors, metres.
        rotation_rmse_deg: root mean square of the rotation errors, degrees.
    """

    rmse_m: float
    median_m: float
    max_m: float
    rotation_rmse_deg: float


def align(p_estimated: FloatArray, p_true: FloatArray) -> Pose:
    """Return T_true_estimated, the rigid motion that brings an estimate (n, 3) closest to the truth (n, 3).

    Source: S. Umeyama, "Least-squares estimation of transformation parameters between two point
    patterns", TPAMI 13(4), 1991, without scale.

    Raises:
        ValueError: if the shapes differ or there are fewer than three positions.
    """
    if p_estimated.shape != p_true.shape or len(p_true) < 3:
        raise ValueError(f"cannot align positions of shapes {p_estimated.shape} and {p_true.shape}")
    mean_estimated, mean_true = p_estimated.mean(axis=0), p_true.mean(axis=0)
    U, _, Vt = np.linalg.svd((p_true - mean_true).T @ (p_estimated - mean_estimated))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return Pose.of(mean_true - R @ mean_estimated, rotation.from_matrix(R))


def absolute_error(
    p_estimated: FloatArray, q_estimated: FloatArray, p_true: FloatArray, q_true: FloatArray
) -> ErrorSummary:
    """Return the absolute pose error (APE) after rigid alignment of the positions.

    Args:
        p_estimated: (n, 3) estimated positions, metres.
        q_estimated: (n, 4) estimated attitudes (w, x, y, z).
        p_true: (n, 3) true positions, metres.
        q_true: (n, 4) true attitudes.
    """
    T_true_estimated = align(p_estimated, p_true)
    distances = np.linalg.norm(T_true_estimated.transform(p_estimated) - p_true, axis=1)
    angles = rotation.angle_between(rotation.multiply(T_true_estimated.q, q_estimated), q_true)
    return _summary(distances, angles)


def relative_error(
    p_estimated: FloatArray,
    q_estimated: FloatArray,
    p_true: FloatArray,
    q_true: FloatArray,
    distance_m: float,
) -> ErrorSummary:
    """Return the relative pose error (RPE): of the motion over every stretch of a given length.

    Source: A. Geiger, P. Lenz, R. Urtasun, "Are we ready for autonomous driving?", 2012: from every
    pose to the first at least `distance_m` of true path later, errors seen in the starting body frame.

    Args:
        p_estimated: (n, 3) estimated positions, metres.
        q_estimated: (n, 4) estimated attitudes (w, x, y, z).
        p_true: (n, 3) true positions, metres.
        q_true: (n, 4) true attitudes.
        distance_m: length of a stretch.

    Raises:
        ValueError: if the true path is shorter than one stretch.
    """
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p_true, axis=0), axis=1))])
    ends = np.searchsorted(travelled, travelled + distance_m)
    starts = np.flatnonzero(ends < len(travelled))
    if len(starts) == 0:
        raise ValueError(f"the path of {travelled[-1]:.2f} m is shorter than a stretch of {distance_m:.2f} m")
    ends = ends[starts]
    step_estimated, turn_estimated = _motion(p_estimated, q_estimated, starts, ends)
    step_true, turn_true = _motion(p_true, q_true, starts, ends)
    return _summary(
        np.linalg.norm(step_estimated - step_true, axis=1), rotation.angle_between(turn_estimated, turn_true)
    )


def drift_percent(
    p_estimated: FloatArray, q_estimated: FloatArray, p_true: FloatArray, q_true: FloatArray
) -> float:
    """Return the error of the last position over the length of the true path, in percent.

    The trajectories are aligned at their first pose only, so errors of heading and tilt count.

    Args:
        p_estimated: (n, 3) estimated positions, metres.
        q_estimated: (n, 4) estimated attitudes (w, x, y, z).
        p_true: (n, 3) true positions, metres.
        q_true: (n, 4) true attitudes.

    Raises:
        ValueError: if the true path has no length.
    """
    length_m = float(np.linalg.norm(np.diff(p_true, axis=0), axis=1).sum())
    if length_m <= 0.0:
        raise ValueError("drift needs a path")
    first, last = np.array([0]), np.array([len(p_true) - 1])
    step_estimated, _ = _motion(p_estimated, q_estimated, first, last)
    step_true, _ = _motion(p_true, q_true, first, last)
    return 100.0 * float(np.linalg.norm(step_estimated - step_true)) / length_m


def _motion(
    p: FloatArray, q: FloatArray, starts: NDArray[np.int64], ends: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    """Return translation and rotation from poses `starts` to `ends`, in the frames of `starts`."""
    back = rotation.conjugate(q[starts])
    return rotation.rotate(back, p[ends] - p[starts]), rotation.multiply(back, q[ends])


def _summary(distances: FloatArray, angles: FloatArray) -> ErrorSummary:
    return ErrorSummary(
        rmse_m=float(np.sqrt(np.mean(distances**2))),
        median_m=float(np.median(distances)),
        max_m=float(distances.max()),
        rotation_rmse_deg=float(np.degrees(np.sqrt(np.mean(angles**2)))),
    )
