"""Do scans and IMU tell the same story? The size of a scan's correction against what was predicted."""

import numpy as np

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.odometry.state import NavigationState

WINDOW = 3
"""Scans over which a steady contradiction adds up: 0.3 s."""
LIMIT = 2.75
"""Norm of one scan's normalised innovation that healthy sensors do not reach."""
WINDOWED_LIMIT = 4.0
"""The same of the newest few together, which a healthy but shaken chip keeps up for longer."""

_JUMP_M = 0.1
_JUMP = 0.05  # rad; 3 degrees
_POSITION_FLOOR_M = 0.002  # what a map of noisy points is off by, beyond what the filter knows
_ROTATION_FLOOR = 3.5e-4  # rad; 0.02 degrees
_SCALE_ERROR = 0.005  # of a chip's axes
_COHERENT = 0.2  # of shaking that adds up over a scan instead of averaging out
_HARD_SHAKING = 1.0  # m/s^2; beyond it rotor tones that fold to low frequencies dominate
_MISSING_AFTER = 1.5  # of the usual interval


class InnovationMonitor:
    """Normalised innovations, of each scan and added up over the newest few.

    With e the correction of the pose and S its predicted covariance, L^-1 e with S = L L' has at most
    unit variance in each of six directions while the filter's assumptions hold, and successive ones are
    independent. A sum over k scans, divided by sqrt(k), has the same variance; an error that stays,
    like a wrong specific force, grows in it with sqrt(k). Source: Y. Bar-Shalom, X. R. Li,
    T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 5.4.

    To the filter's own covariance is added what it does not model: a small error of the map, the chip's
    scale, and shaking so regular that it does not average out.
    """

    def __init__(self) -> None:
        """Begin without any scan.

        Public after each scan: `newest` and `windowed`, the norms of the normalised innovations, and
        `jumped`, whether the pose moved farther than prediction and noise explain.
        """
        self._recent = np.zeros((WINDOW, 6))
        self.newest = 0.0
        self.windowed = 0.0
        self.jumped = False

    def forget(self) -> None:
        """Begin anew: what follows does not continue what was before."""
        self._recent[:] = 0.0
        self.newest = self.windowed = 0.0
        self.jumped = False

    def observe(self, predicted: NavigationState, corrected: NavigationState, way: FloatArray) -> str:
        """Take one scan's correction; return what contradicts, or "".

        Args:
            predicted: state and covariance at the scan's end, before the correction.
            corrected: the same after it.
            way: (n, 22) of the propagation since the scan before, as `kernels.propagate` leaves it.
        """
        moved = corrected.p_map - predicted.p_map
        turned = rotation.log(rotation.from_matrix(predicted.R_map_imu.T @ corrected.R_map_imu))
        position_m, angle = unmodelled(way)
        S = predicted.covariance[:6, :6] + np.diag([position_m**2] * 3 + [angle**2] * 3)
        whitened = np.linalg.solve(np.linalg.cholesky(S), np.concatenate([moved, turned]))
        self._recent[:-1] = self._recent[1:]
        self._recent[-1] = whitened
        total = self._recent.sum(axis=0) / np.sqrt(WINDOW)
        self.newest, self.windowed = float(np.linalg.norm(whitened)), float(np.linalg.norm(total))
        self.jumped = self.newest > LIMIT and is_jump(predicted, corrected)
        if self.newest <= LIMIT and self.windowed <= WINDOWED_LIMIT:
            return ""
        worst = whitened if self.newest > LIMIT else total
        if np.linalg.norm(worst[:3]) >= np.linalg.norm(worst[3:]):
            return f"scan contradicts the IMU: position by {100.0 * np.linalg.norm(moved):.0f} cm"
        return f"scan contradicts the IMU: rotation by {np.degrees(np.linalg.norm(turned)):.1f} deg"


def unmodelled(way: FloatArray) -> tuple[float, float]:
    """Return how far position (m) and rotation (rad) may be off after a way beyond the filter's covariance.

    Args:
        way: (n, 22) as `kernels.propagate` leaves it: time in column 0, acceleration in the map in columns
            16-18, rate in 19-21.
    """
    if len(way) < 3:
        return _POSITION_FLOOR_M, _ROTATION_FLOOR
    intervals_s = np.diff(way[:, 0])
    passed_s = float(intervals_s.sum())
    missing = float(intervals_s[intervals_s > _MISSING_AFTER * np.median(intervals_s)].sum()) / passed_s
    steps = np.diff(way[:-1, 16:22], axis=0)
    shaking = np.sqrt(0.5 * np.einsum("ij,ij->j", steps, steps) / len(steps))
    acceleration, rate = float(shaking[:3].max()), float(shaking[3:].max())
    adding_up = (_COHERENT + missing) * acceleration + max(0.0, acceleration - _HARD_SHAKING)
    turn = float(np.linalg.norm(way[:-1, 19:22].mean(axis=0))) * passed_s
    return (
        _POSITION_FLOOR_M + adding_up * passed_s**2,
        _ROTATION_FLOOR + _COHERENT * rate * passed_s + _SCALE_ERROR * turn,
    )


def is_jump(before: NavigationState, after: NavigationState) -> bool:
    """Whether a pose moves so far between two states of one time that nobody may take it for motion."""
    turned = rotation.log(rotation.from_matrix(before.R_map_imu.T @ after.R_map_imu))
    return bool(np.linalg.norm(after.p_map - before.p_map) > _JUMP_M or np.linalg.norm(turned) > _JUMP)
