"""How far own motion from another process can be trusted, judged by its stamps and by the IMU."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND, seconds_to_ns
from companion.messages import ExternalOdometry, FloatArray, OdometryStatus
from companion.perception.odometry.external_settings import ExternalMotionSettings
from companion.perception.odometry.health import Health

_RATE_WINDOW_NS = seconds_to_ns(1.0)
_TRAVEL_WINDOW_NS = seconds_to_ns(0.5)
_TILT_WINDOW_NS = seconds_to_ns(2.0)
_RESET_WINDOW_NS = seconds_to_ns(10.0)
_MOST_STEPS = 2048
_DOUBT = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """From one stated motion to the next.

    Attributes:
        duration_s: time between them.
        way_map: (3,) difference of the positions, m.
        stated_way_map: (3,) what the stated velocities make of it, m.
        lift_map: (3,) mean specific force less the stated acceleration, m/s^2: gravity upwards, if the
            attitude is right.
    """

    duration_s: float
    way_map: FloatArray
    stated_way_map: FloatArray
    lift_map: FloatArray


class ExternalHealth:
    """Remembers the newest messages and judges every output by them and by the time since."""

    def __init__(self, settings: ExternalMotionSettings) -> None:
        """Know nothing yet."""
        self._settings = settings
        self._began_ns: int | None = None
        self._last_ns = 0
        self._quality = 0
        self._sigma_m = self._sigma_deg = 0.0
        self._arrivals: deque[int] = deque(maxlen=_MOST_STEPS)
        self._misses = _Window(_TRAVEL_WINDOW_NS)
        self._lifts = _Window(_TILT_WINDOW_NS)
        self._resets: deque[int] = deque(maxlen=_MOST_STEPS)
        self._jump_ns: int | None = None
        self._jump = ""

    def begin(self, t_ns: int) -> None:
        """Start settling at a sensor time; resets of the last seconds stay remembered."""
        self._began_ns = t_ns
        self._arrivals.clear()
        self._clear_steps()
        self._jump_ns = None

    def forget(self) -> None:
        """Wait for a new beginning."""
        self._began_ns = None

    def relabel(self, shift_ns: int) -> None:
        """Follow a jump of the LiDAR's clock."""
        self._last_ns += shift_ns
        if self._began_ns is not None:
            self._began_ns += shift_ns
        if self._jump_ns is not None:
            self._jump_ns += shift_ns
        for times in (self._arrivals, self._resets):
            for index in range(len(times)):
                times[index] += shift_ns
        self._misses.relabel(shift_ns)
        self._lifts.relabel(shift_ns)

    def arrived(self, t_ns: int, message: ExternalOdometry) -> None:
        """Take note of a message that is valid at a sensor time."""
        self._last_ns = t_ns
        self._quality = message.quality or self._settings.unstated_quality
        variances = np.diagonal(message.covariance_pose)
        self._sigma_m = math.sqrt(float(variances[:3].max()))
        self._sigma_deg = math.degrees(math.sqrt(float(variances[3:].max())))
        self._arrivals.append(t_ns)
        while self._arrivals[0] <= t_ns - _RATE_WINDOW_NS:
            self._arrivals.popleft()

    def moved(self, t_ns: int, step: Step) -> None:
        """Take note of a step that ended at a sensor time."""
        self._misses.add(t_ns, step.duration_s, step.stated_way_map - step.way_map)
        self._lifts.add(t_ns, step.duration_s, step.duration_s * step.lift_map)

    def _clear_steps(self) -> None:
        self._misses.clear()
        self._lifts.clear()

    def reset(self, t_ns: int, jump: str) -> None:
        """Take note that the map has jumped; `jump` says how, if the sender did not announce it."""
        self._resets.append(t_ns)
        self._clear_steps()
        if jump:
            self._jump_ns, self._jump = t_ns, jump

    def judge(self, t_ns: int, settled: bool) -> Health:
        """Return the verdict at a sensor time.

        Args:
            t_ns: the newest that is known.
            settled: it has counted before; otherwise it has to arrive and agree for a while first.
        """
        settings = self._settings
        if self._began_ns is None:
            return Health(OdometryStatus.INITIALISING, 0, "no external odometry")
        age_s = (t_ns - self._last_ns) * 1e-9
        refusal = self._refusal(t_ns, age_s)
        if refusal:
            return Health(OdometryStatus.LOST, 0, refusal)
        doubts = self._doubts(t_ns, age_s)
        # A stated quality needs no further discount for being low.
        share = _DOUBT if doubts else 1.0
        if self._quality < settings.min_quality:
            doubts.append(f"external odometry states the quality {self._quality}")
        waited_s = (self._last_ns - self._began_ns) * 1e-9
        if not settled and (waited_s < settings.settling_s or doubts):
            settling = f"external odometry for {waited_s:.1f} s of {settings.settling_s:g} s"
            return Health(OdometryStatus.INITIALISING, 0, doubts[0] if doubts else settling)
        late = (age_s - settings.stale_after_s) / (settings.lost_after_s - settings.stale_after_s)
        certain = 1.0 / (1.0 + (self._sigma_m / settings.max_position_sigma_m) ** 2)
        quality = self._quality * (1.0 - min(1.0, max(0.0, late))) * certain * share
        status = OdometryStatus.DEGRADED if doubts else OdometryStatus.TRACKING
        return Health(status, max(1, round(quality)), ", ".join(doubts))

    def _refusal(self, t_ns: int, age_s: float) -> str:
        """Return why it must not be used at all, or an empty string."""
        if age_s > self._settings.lost_after_s:
            return f"no external odometry for {age_s:.1f} s"
        if self._quality < 0:
            return "the external odometry reports its failure"
        while self._resets and self._resets[0] <= t_ns - _RESET_WINDOW_NS:
            self._resets.popleft()
        if len(self._resets) > self._settings.most_resets:
            return f"external odometry was reset {len(self._resets)} times within 10 s"
        tilt_deg = self._tilt_error_deg()
        if tilt_deg > self._settings.max_tilt_error_deg:
            return f"external odometry's vertical is {tilt_deg:.0f} deg off the accelerometer's"
        return ""

    def _doubts(self, t_ns: int, age_s: float) -> list[str]:
        """Return why it is to be used with care only."""
        settings, doubts = self._settings, []
        if age_s > settings.stale_after_s:
            doubts.append(f"no external odometry for {age_s:.1f} s")
        elif self._began_ns is not None and self._last_ns - self._began_ns >= _RATE_WINDOW_NS:
            rate_hz = len(self._arrivals) * NANOSECONDS_PER_SECOND / _RATE_WINDOW_NS
            if rate_hz < settings.min_rate_hz:
                doubts.append(
                    f"external odometry at {rate_hz:.0f} Hz, at least {settings.min_rate_hz:g} wanted"
                )
        if self._sigma_m > settings.max_position_sigma_m:
            doubts.append(f"external position uncertain by {self._sigma_m:.2f} m")
        if self._sigma_deg > settings.max_rotation_sigma_deg:
            doubts.append(f"external attitude uncertain by {self._sigma_deg:.0f} deg")
        if self._jump_ns is not None and t_ns - self._jump_ns < seconds_to_ns(settings.jump_penalty_s):
            doubts.append(self._jump)
        error = self._velocity_error()
        if error > settings.max_velocity_error_mps:
            doubts.append(f"external velocity is {error:.1f} m/s off its positions")
        return doubts

    def _velocity_error(self) -> float:
        """Return how far the stated velocity is from the way covered in half a second, m/s."""
        if self._misses.duration_s < 0.5 * _TRAVEL_WINDOW_NS * 1e-9:
            return 0.0
        return float(np.linalg.norm(self._misses.total)) / self._misses.duration_s

    def _tilt_error_deg(self) -> float:
        """Return the angle between the vertical of the stated attitudes and the accelerometer's."""
        if self._lifts.duration_s < 0.9 * self._settings.settling_s:
            return 0.0
        x, y, z = self._lifts.total.tolist()
        return math.degrees(math.atan2(math.hypot(x, y), z))


class _Window:
    """Sum of what happened in the newest stretch of time."""

    def __init__(self, span_ns: int) -> None:
        self._span_ns = span_ns
        self.clear()

    def clear(self) -> None:
        self._entries: deque[tuple[int, float, FloatArray]] = deque()
        self.duration_s = 0.0
        self.total = np.zeros(3)

    def relabel(self, shift_ns: int) -> None:
        self._entries = deque((t_ns + shift_ns, span, value) for t_ns, span, value in self._entries)

    def add(self, t_ns: int, duration_s: float, value: FloatArray) -> None:
        self._entries.append((t_ns, duration_s, value))
        self.duration_s += duration_s
        self.total += value
        while self._entries[0][0] <= t_ns - self._span_ns or len(self._entries) > _MOST_STEPS:
            _, old_s, old = self._entries.popleft()
            self.duration_s -= old_s
            self.total -= old
