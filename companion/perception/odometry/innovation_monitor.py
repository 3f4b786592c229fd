"""Do scans and IMU tell the same story? The size of a scan's correction against what was predicted."""

import numpy as np

from companion.messages import FloatArray
from companion.perception.odometry.innovation_monitor_kernels import RESULT_SIZE, innovate
from companion.perception.odometry.state import NavigationState

WINDOW = 3
"""Scans over which a steady contradiction adds up: 0.3 s."""
LIMIT = 2.75
"""Norm of one scan's normalised innovation that healthy sensors do not reach."""
WINDOWED_LIMIT = 4.0
"""The same of the newest few together, which a healthy but shaken chip keeps up for longer."""

_JUMP_M = 0.1
_JUMP = 0.05  # rad; 3 degrees


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
        self._result = np.zeros(RESULT_SIZE)
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
        result = self._result
        innovate(predicted.vector, corrected.vector, predicted.covariance, way, result)
        self._recent[:-1] = self._recent[1:]
        self._recent[-1] = result[:6]
        total = self._recent.sum(axis=0) / np.sqrt(WINDOW)
        self.newest, self.windowed = float(np.linalg.norm(result[:6])), float(np.linalg.norm(total))
        moved_m, turned = float(result[6]), float(result[7])
        self.jumped = self.newest > LIMIT and _is_far(moved_m, turned)
        if self.newest <= LIMIT and self.windowed <= WINDOWED_LIMIT:
            return ""
        worst = result[:6] if self.newest > LIMIT else total
        if np.linalg.norm(worst[:3]) >= np.linalg.norm(worst[3:]):
            return f"scan contradicts the IMU: position by {100.0 * moved_m:.0f} cm"
        return f"scan contradicts the IMU: rotation by {np.degrees(turned):.1f} deg"


def is_jump(before: NavigationState, after: NavigationState) -> bool:
    """Whether a pose moves so far between two states of one time that nobody may take it for motion."""
    result = np.zeros(RESULT_SIZE)
    innovate(before.vector, after.vector, before.covariance, np.zeros((1, 22)), result)
    return _is_far(float(result[6]), float(result[7]))


def _is_far(moved_m: float, turned: float) -> bool:
    return moved_m > _JUMP_M or turned > _JUMP
