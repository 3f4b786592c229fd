"""What the comparison counts, defined once for every system.

All systems are judged by the pose of the body at the ends of scans, from two seconds after the first
scan on. Maps start where a system chooses, so the estimate is first laid over the truth as a whole.

- APE: root mean square distance after the best rigid alignment of the path; attitude likewise.
- Drift: mean error of the motion over stretches of 20, 40 and 80 m of true path from every pose,
  in percent of the stretch, seen in the frame of its start: only what the system did during the stretch
  counts, so neither the first attitude nor any alignment matters. (A path too short for these is judged
  over half its length.)

Source: A. Geiger, P. Lenz, R. Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark
suite", CVPR 2012, for the drift.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.geometry import rotation, trajectory_error
from companion.geometry.trajectory import Trajectory
from companion.messages import FloatArray

STRETCHES_M = (20.0, 40.0, 80.0)
_LONGEST_SHARE = 0.75
_POSES_MIN = 10
_PATH_MIN_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """An estimate beside the truth.

    Attributes:
        t_ns: (n,) times compared.
        p_true: (n, 3) true positions of the body.
        p_laid: (n, 3) estimated ones after alignment.
        ape_rmse_m: root mean square distance between the two.
        attitude_rmse_deg: root mean square angle after the same alignment.
        drift_percent: see the module; None if the path is too short to tell.
        q_true_map: (4,) attitude of the system's map in the frame of the truth.
    """

    t_ns: NDArray[np.int64]
    p_true: FloatArray
    p_laid: FloatArray
    ape_rmse_m: float
    attitude_rmse_deg: float
    drift_percent: float | None
    q_true_map: FloatArray

    @property
    def error_m(self) -> FloatArray:
        """Return the distances (n,)."""
        return np.asarray(np.linalg.norm(self.p_laid - self.p_true, axis=1))


def judge(estimate: Trajectory, truth: Trajectory) -> Judgement | None:
    """Compare two trajectories of the body where they have a pose of the same time.

    Returns:
        None if they share fewer than ten poses.
    """
    t_ns, ours, theirs = np.intersect1d(estimate.t_ns, truth.t_ns, assume_unique=True, return_indices=True)
    if len(t_ns) < _POSES_MIN:
        return None
    p, q, p_true, q_true = estimate.p[ours], estimate.q[ours], truth.p[theirs], truth.q[theirs]
    summary = trajectory_error.absolute_error(p, q, p_true, q_true)
    T_true_map = trajectory_error.align(p, p_true)
    return Judgement(
        t_ns=t_ns,
        p_true=p_true,
        p_laid=T_true_map.transform(p),
        ape_rmse_m=summary.rmse_m,
        attitude_rmse_deg=summary.rotation_rmse_deg,
        drift_percent=drift_percent(p, q, p_true, q_true),
        q_true_map=T_true_map.q,
    )


def drift_percent(
    p_estimated: FloatArray, q_estimated: FloatArray, p_true: FloatArray, q_true: FloatArray
) -> float | None:
    """Return the drift as defined in the module.

    Args:
        p_estimated: (n, 3) estimated positions, metres.
        q_estimated: (n, 4) estimated attitudes (w, x, y, z).
        p_true: (n, 3) true positions of the same instants.
        q_true: (n, 4) true attitudes.

    Returns:
        None for a true path of less than a metre.
    """
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p_true, axis=0), axis=1))])
    path_m = float(travelled[-1])
    if path_m < _PATH_MIN_M:
        return None
    lengths = [length for length in STRETCHES_M if length <= _LONGEST_SHARE * path_m] or [0.5 * path_m]
    shares: list[float] = []
    for length in lengths:
        ends = np.searchsorted(travelled, travelled + length)
        starts = np.flatnonzero(ends < len(travelled))
        ends = ends[starts]
        motion = _motion(p_estimated, q_estimated, starts, ends)
        error_m = np.linalg.norm(motion - _motion(p_true, q_true, starts, ends), axis=1)
        shares.append(float(np.mean(error_m / (travelled[ends] - travelled[starts]))))
    return 100.0 * float(np.mean(shares))


def _motion(p: FloatArray, q: FloatArray, starts: NDArray[np.int64], ends: NDArray[np.int64]) -> FloatArray:
    """Return the translations (n, 3) from poses `starts` to `ends`, in the frames of `starts`."""
    return rotation.rotate(rotation.conjugate(q[starts]), p[ends] - p[starts])
