"""How far the estimate can be trusted: status, quality and the reason."""

import math
from dataclasses import dataclass

from companion.messages import OdometryStatus
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState, P
from companion.perception.odometry.update import Correction

_GOOD_MATCHED_SHARE = 0.4
_BAD_NORMALISED_RMS = 3.0
_TOLERATED_SIGMA_M = 0.1
_LOST_SIGMA_M = 3.0
_USABLE_QUALITY = 40


@dataclass(frozen=True, slots=True)
class Health:
    """One verdict.

    Attributes:
        status: TRACKING, DEGRADED or LOST.
        quality: 0 (do not use) to 100.
        reason: why the status is not TRACKING; empty otherwise.
    """

    status: OdometryStatus
    quality: int
    reason: str


class HealthMonitor:
    """Remembers the newest correction and judges every output by it and by the time since."""

    def __init__(self, settings: OdometrySettings, t_ns: int) -> None:
        """Start healthy at a sensor time."""
        self._settings = settings
        self._corrected_ns = t_ns
        self._score = 1.0
        self._reason = ""

    def relabel(self, shift_ns: int) -> None:
        """Follow a jump of the sensor's clock."""
        self._corrected_ns += shift_ns

    def observe(self, t_ns: int, correction: Correction) -> None:
        """Take note of one scan's correction, or of its failure."""
        settings = self._settings
        if not correction.accepted:
            self._reason = f"{correction.matched} of {correction.found} planes agree with the scan"
            return
        self._corrected_ns = t_ns
        points = min(1.0, correction.matched / (4.0 * settings.min_effective_points))
        share = min(1.0, correction.matched / max(1, correction.offered) / _GOOD_MATCHED_SHARE)
        excess = (correction.normalised_rms - 1.5) / (_BAD_NORMALISED_RMS - 1.5)
        fit = 1.0 - min(1.0, max(0.0, excess))
        observed = 1.0
        reasons = []
        if correction.observability is not None and correction.observability.degenerate:
            count = correction.observability.degenerate
            observed = max(0.2, 1.0 - 0.4 * count)
            reasons.append(f"{count} directions unobserved")
        if points < 0.5:
            reasons.append(f"only {correction.matched} points matched")
        if share < 0.5:
            reasons.append(f"{correction.matched} of {correction.offered} points matched")
        if fit < 0.5:
            reasons.append(f"residuals {correction.normalised_rms:.1f} times their noise")
        self._score = points * share * fit * observed
        self._reason = ", ".join(reasons)

    def judge(self, state: NavigationState) -> Health:
        """Return the verdict on a state propagated to its own time."""
        if not state.is_finite():
            return Health(OdometryStatus.LOST, 0, "state is not finite")
        age_s = (state.t_ns - self._corrected_ns) * 1e-9
        if age_s > self._settings.lost_after_s:
            return Health(OdometryStatus.LOST, 0, f"no scan matched for {age_s:.1f} s")
        # The trace bounds the largest eigenvalue from above and is far cheaper, 200 times a second.
        sigma_m = math.sqrt(max(0.0, float(state.covariance[P, P].trace())))
        if sigma_m > _LOST_SIGMA_M:
            return Health(OdometryStatus.LOST, 0, f"position uncertain by {sigma_m:.1f} m")
        late = (age_s - self._settings.degraded_after_s) / (
            self._settings.lost_after_s - self._settings.degraded_after_s
        )
        fresh = 1.0 - min(1.0, max(0.0, late))
        certain = 1.0 / (1.0 + (sigma_m / _TOLERATED_SIGMA_M) ** 2)
        quality = max(1, round(100.0 * self._score * fresh * certain))
        reason = self._reason
        if late > 0.0:
            reason = f"no scan matched for {age_s:.1f} s"
        elif not reason and quality < _USABLE_QUALITY:
            reason = f"position uncertain by {sigma_m:.2f} m"
        status = (
            OdometryStatus.DEGRADED if late > 0.0 or quality < _USABLE_QUALITY else OdometryStatus.TRACKING
        )
        return Health(status, quality, reason if status is OdometryStatus.DEGRADED else "")
