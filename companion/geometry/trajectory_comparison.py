"""Estimated against true motion: error over time, absolute error after alignment, drift."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.geometry import rotation
from companion.geometry.rotation import FloatArray
from companion.geometry.trajectory_error import align

_POSES_MIN = 3
_REACH_M = 1e6


@dataclass(frozen=True, slots=True)
class Comparison:
    """How far an estimate was from the truth.

    Attributes:
        t: (n,) times compared, seconds.
        p_estimate, p_truth: (n, 3) both in the estimate's frame, the truth laid on the estimate's first
            pose, attitude included.
        map_tilt: angle between what the estimate took for vertical at the start and the vertical, rad.
        ape_rmse_m: root mean square distance after the best rigid alignment of both paths.
        end_error_m: distance at the end.
        path_m: length of the true path.
    """

    t: FloatArray
    p_estimate: FloatArray
    p_truth: FloatArray
    map_tilt: float
    ape_rmse_m: float
    end_error_m: float
    path_m: float

    @property
    def error_m(self) -> FloatArray:
        """Return the distances (n,) between estimate and truth."""
        return np.asarray(np.linalg.norm(self.p_estimate - self.p_truth, axis=1))

    @property
    def drift_percent(self) -> float | None:
        """Return the end error as a share of the true path, None if nothing moved."""
        return 100.0 * self.end_error_m / self.path_m if self.path_m > 0.5 else None


def compare(
    t: FloatArray,
    p_estimate: FloatArray,
    q_estimate: FloatArray,
    t_truth: FloatArray,
    p_truth: FloatArray,
    q_truth: FloatArray,
) -> Comparison | None:
    """Compare estimates (n, 3), (n, 4) with the truth (m, 3), (m, 4), interpolated to their times.

    Returns:
        The comparison over the time that both cover, None if that is less than three poses.
    """
    usable = _sane(p_estimate, q_estimate)
    if len(t_truth) < 2 or not _sane(p_truth, q_truth).all() or np.any(np.diff(t_truth) < 0.0):
        return None
    inside = usable & (t >= t_truth[0]) & (t <= t_truth[-1])
    if np.count_nonzero(inside) < _POSES_MIN:
        return None
    t, p_estimate, q_estimate = t[inside], p_estimate[inside], q_estimate[inside]
    p_true = np.column_stack([np.interp(t, t_truth, p_truth[:, axis]) for axis in range(3)])
    q_true = q_truth[np.clip(np.searchsorted(t_truth, t[0]), 0, len(t_truth) - 1)]
    q_map_world = rotation.normalize(rotation.multiply(q_estimate[0], rotation.conjugate(q_true)))
    laid = p_estimate[0] + rotation.rotate(q_map_world, p_true - p_true[0])
    vertical = float(np.clip(rotation.to_matrix(q_map_world)[2, 2], -1.0, 1.0))
    aligned = align(laid, p_estimate).transform(laid)
    return Comparison(
        t=t,
        p_estimate=p_estimate,
        p_truth=laid,
        map_tilt=float(np.arccos(vertical)),
        ape_rmse_m=float(np.sqrt(np.mean(np.sum((aligned - p_estimate) ** 2, axis=1)))),
        end_error_m=float(np.linalg.norm(p_estimate[-1] - laid[-1])),
        path_m=float(np.sum(np.linalg.norm(np.diff(p_true, axis=0), axis=1))),
    )


def _sane(p: FloatArray, q: FloatArray) -> NDArray[np.bool_]:
    """Return which poses (n,) are positions within any flight's reach and unit quaternions."""
    return np.asarray(np.all(np.abs(p) < _REACH_M, axis=1) & (np.abs(np.linalg.norm(q, axis=1) - 1.0) < 0.1))


def path_length(p: FloatArray, step_m: float) -> float:
    """Return the length of a path (n, 3), counting only steps of at least `step_m`: noise adds nothing."""
    if not len(p):
        return 0.0
    anchor = p[0]
    length = 0.0
    for point in p[1:]:
        step = float(np.linalg.norm(point - anchor))
        if step >= step_m:
            length += step
            anchor = point
    return length
