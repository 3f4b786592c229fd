"""How far the estimate can be trusted: status, quality and the reason.

Quality is a product, so it never rises when anything gets worse:

    100 x points x share x fit x observed   how well the newest accepted scan matched
        x fresh                             1 up to `degraded_after_s` without a match, 0 at `lost_after_s`
        x certain                           1 / (1 + (position deviation / 0.1 m)^2)
        x 0.1                               while any alarm of a monitor stands

An alarm stands from its first sign until half a second after its last. The status is DEGRADED while one
stands, while no scan has matched for `degraded_after_s`, or with a quality below 40; LOST when there is
nothing to believe. Of several reasons the oldest is told: it is the likeliest cause of the others.
"""

import math
from dataclasses import dataclass
from enum import Enum

from companion.clock import seconds_to_ns
from companion.messages import FloatArray, ImuSample, LidarScan, OdometryStatus
from companion.perception.odometry.bias_monitor import BiasMonitor
from companion.perception.odometry.degeneracy import weak_directions
from companion.perception.odometry.inertial_monitor import InertialMonitor
from companion.perception.odometry.innovation_monitor import InnovationMonitor, is_jump
from companion.perception.odometry.scan_monitor import ScanMonitor
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import NavigationState
from companion.perception.odometry.update import Correction

_GOOD_MATCHED_SHARE = 0.4
_BAD_NORMALISED_RMS = 3.0
_TOLERATED_SIGMA_M = 0.1
_LOST_SIGMA_M = 3.0
_MOST_DISAGREEING = 0.12  # of the points near a known surface; in a still world one in fifty
_USABLE_QUALITY = 40
_ALARMED = 0.1
_HOLD_NS = seconds_to_ns(0.5)


class Concern(Enum):
    """What an alarm is about; each has at most one alarm at a time."""

    INERTIAL = "inertial"
    SCAN = "scan"
    MATCH = "match"
    CONTRADICTION = "contradiction"
    BIAS = "bias"
    CLOCK = "clock"
    PLACE = "place"


_SPOILS_MAP = (Concern.SCAN, Concern.PLACE)


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


@dataclass(frozen=True, slots=True)
class _Alarm:
    since_ns: int
    until_ns: int
    reason: str


class HealthMonitor:
    """Asks every monitor, remembers the newest correction, and judges every output."""

    def __init__(self, settings: OdometrySettings, t_ns: int) -> None:
        """Start healthy at a sensor time."""
        self._settings = settings
        self._degraded_after_s, self._lost_after_s = settings.degraded_after_s, settings.lost_after_s
        self._fading_per_s = 1.0 / max(1e-3, self._lost_after_s - self._degraded_after_s)
        self._corrected_ns = t_ns
        self._score = 1.0
        self._reason = ""
        self._alarms: dict[Concern, _Alarm] = {}
        self._inertial = InertialMonitor(settings)
        self._scans = ScanMonitor(settings)
        self._innovation = InnovationMonitor()
        self._biases = BiasMonitor(settings)

    def relabel(self, shift_ns: int) -> None:
        """Follow a jump of the sensor's clock."""
        self._corrected_ns += shift_ns
        self._alarms = {
            concern: _Alarm(alarm.since_ns + shift_ns, alarm.until_ns + shift_ns, alarm.reason)
            for concern, alarm in self._alarms.items()
        }
        self._inertial.relabel(shift_ns)
        self._biases.relabel(shift_ns)

    def alarm(self, t_ns: int, concern: Concern, reason: str) -> None:
        """Raise an alarm at a sensor time, or prolong the one that stands."""
        standing = self._alarms.get(concern)
        since_ns = t_ns if standing is None or standing.until_ns < t_ns else standing.since_ns
        self._alarms[concern] = _Alarm(since_ns, t_ns + _HOLD_NS, reason)

    def observe_sample(self, sample: ImuSample) -> None:
        """Take note of one IMU sample."""
        finding = self._inertial.observe(sample)
        if finding:
            self.alarm(sample.t_sensor_ns, Concern.INERTIAL, finding)

    def observe_scan(self, scan: LidarScan, newest: ImuSample) -> None:
        """Take note of a scan as it arrives, after the IMU sample `newest`."""
        finding = self._scans.observe(scan, newest)
        if finding:
            self.alarm(newest.t_sensor_ns, Concern.SCAN, finding)

    def observe(self, predicted: NavigationState, correction: Correction, way: FloatArray) -> bool:
        """Take note of one scan's correction, or of its failure.

        Args:
            predicted: the state before the correction.
            correction: what the scan made of it.
            way: of the propagation since the scan before, see `InnovationMonitor.observe`.

        Returns:
            Whether the pose jumped: it moved farther than prediction and noise explain.
        """
        if not correction.accepted:
            told = f"scan does not match: {correction.matched} of {correction.offered} points agree"
            self.alarm(predicted.t_ns, Concern.MATCH, told)
            return False
        state = correction.state
        self._corrected_ns = state.t_ns
        disagreeing = 1.0 - correction.matched / max(1, correction.found)
        if disagreeing > _MOST_DISAGREEING:
            told = f"{100.0 * disagreeing:.0f} % of the points contradict the map"
            self.alarm(state.t_ns, Concern.MATCH, told)
        finding = self._innovation.observe(predicted, state, way)
        if correction.wide and not finding:
            finding = "scan contradicts the IMU: found in a wider search"
        if finding:
            self.alarm(state.t_ns, Concern.CONTRADICTION, finding)
        runaway = self._biases.observe(state)
        if runaway:
            self.alarm(state.t_ns, Concern.BIAS, runaway)
        self.rate(correction)
        jumped = correction.wide or self._innovation.jumped
        if jumped:
            self.alarm(state.t_ns, Concern.PLACE, finding)
        return jumped

    def relocated(self, predicted: NavigationState, found: Correction) -> bool:
        """The place was found again: DEGRADED until it has held for a while.

        Args:
            predicted: the state that the search began from.
            found: where it ended.

        Returns:
            Whether the pose jumped, as it does after every loss.
        """
        jumped = self.judge(predicted).status is OdometryStatus.LOST or is_jump(predicted, found.state)
        self._corrected_ns = found.state.t_ns
        self._innovation.forget()
        self._biases.forget()
        self._alarms.clear()
        self.alarm(found.state.t_ns, Concern.PLACE, "place found again after an outage")
        self.rate(found)
        return jumped

    def must_search(self, t_ns: int) -> bool:
        """Whether the outage was so long that a match is no longer believed at once."""
        return t_ns - self._corrected_ns > seconds_to_ns(self._settings.search_after_s)

    def may_map(self, t_ns: int) -> bool:
        """Whether scans may enter the map: none that is doubted, or whose place is.

        Mere disagreement does not keep them out: a map that does not grow would never agree again.
        """
        return all(
            self._alarms[concern].until_ns < t_ns for concern in _SPOILS_MAP if concern in self._alarms
        )

    def is_over(self, state: NavigationState) -> bool:
        """Whether nothing is left to search with: no sound state, or no time."""
        if not state.is_finite() or _sigma_m(state) > _LOST_SIGMA_M:
            return True
        longest_ns = seconds_to_ns(self._settings.lost_after_s + self._settings.search_s)
        return state.t_ns - self._corrected_ns > longest_ns

    def judge(self, state: NavigationState) -> Health:
        """Return the verdict on a state propagated to its own time."""
        # Many times a second, so cheaply: whatever else becomes infinite is seen at the next scan.
        if not math.isfinite(float(state.vector @ state.vector)):
            return Health(OdometryStatus.LOST, 0, "state is not finite")
        age_s = (state.t_ns - self._corrected_ns) * 1e-9
        if age_s > self._lost_after_s:
            return Health(OdometryStatus.LOST, 0, f"no scan matched for {age_s:.1f} s")
        sigma_m = _sigma_m(state)
        if sigma_m > _LOST_SIGMA_M:
            return Health(OdometryStatus.LOST, 0, f"position uncertain by {sigma_m:.1f} m")
        late = max(0.0, age_s - self._degraded_after_s) * self._fading_per_s
        quality = 100.0 * self._score * (1.0 - min(1.0, late)) / (1.0 + (sigma_m / _TOLERATED_SIGMA_M) ** 2)
        standing = [alarm for alarm in self._alarms.values() if alarm.until_ns >= state.t_ns]
        if standing:
            quality *= _ALARMED
        if standing:
            reason = min(standing, key=lambda alarm: alarm.since_ns).reason
        elif late > 0.0:
            reason = f"no scan matched for {age_s:.1f} s"
        elif quality < _USABLE_QUALITY:
            reason = self._reason or f"position uncertain by {sigma_m:.2f} m"
        else:
            return Health(OdometryStatus.TRACKING, max(1, round(quality)), "")
        return Health(OdometryStatus.DEGRADED, max(1, round(quality)), reason)

    def rate(self, correction: Correction) -> None:
        """Score how well an accepted scan matched, 0 to 1."""
        points = min(1.0, correction.matched / (4.0 * self._settings.min_effective_points))
        share = min(1.0, correction.matched / max(1, correction.offered) / _GOOD_MATCHED_SHARE)
        excess = (correction.normalised_rms - 1.5) / (_BAD_NORMALISED_RMS - 1.5)
        fit = 1.0 - min(1.0, max(0.0, excess))
        observed = 1.0
        reasons = []
        if correction.observability is not None and correction.observability.degenerate:
            count = correction.observability.degenerate
            observed = max(0.2, 1.0 - 0.4 * count)
            names = ", ".join(weak_directions(correction.observability, correction.state.R_map_imu))
            reasons.append(f"{count} directions unobserved: {names}")
        if points < 0.5:
            reasons.append(f"only {correction.matched} points matched")
        if share < 0.5:
            reasons.append(f"{correction.matched} of {correction.offered} points matched")
        if fit < 0.5:
            reasons.append(f"residuals {correction.normalised_rms:.1f} times their noise")
        self._score = points * share * fit * observed
        self._reason = ", ".join(reasons)


def _sigma_m(state: NavigationState) -> float:
    """Return how uncertain the position is: the trace bounds the largest eigenvalue from above."""
    p = state.covariance
    return math.sqrt(max(0.0, p.item(0, 0) + p.item(1, 1) + p.item(2, 2)))
