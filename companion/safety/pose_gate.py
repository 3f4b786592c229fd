"""Stops odometry that jumps: a vehicle cannot be elsewhere all at once, so its estimate is wrong."""

import math
from dataclasses import replace

from companion.clock import seconds_to_ns
from companion.geometry import rotation
from companion.messages import FloatArray, Odometry, OdometryStatus, VehicleState
from companion.safety.settings import SafetySettings

_LONGEST_STEP_NS = seconds_to_ns(0.25)
_STEADY_NS = seconds_to_ns(0.5)
_FRESH_NS = seconds_to_ns(0.2)
_USABLE = (OdometryStatus.TRACKING, OdometryStatus.DEGRADED)


class PoseGate:
    """Compares each step of the odometry with the velocity that PX4 itself states.

    PX4 follows its external vision, but for a fraction of a second its velocity rests on its own
    inertial sensors: a pose that steps where that velocity does not lead has jumped. Where PX4 disagrees
    with the odometry anyway (it may not have begun to use it) the odometry's own velocity decides, so
    that the gate never keeps out what PX4 needs to begin with.

    After a jump nothing passes until the poses have been steady for half a second; from then on the reset
    counter is one higher, so that everybody knows that the map is another one.
    """

    def __init__(self, settings: SafetySettings) -> None:
        """Begin without a pose to compare with."""
        self._settings = settings
        self._last: Odometry | None = None
        self._steady_since_ns: int | None = None  # None while nothing is withheld
        self._jumped_by = ""
        self.jumps = 0

    def admit(self, odometry: Odometry, vehicle: VehicleState | None) -> Odometry:
        """Return the odometry to believe: the same, or one that says why there is none."""
        last, self._last = self._last, odometry if odometry.status in _USABLE else None
        if self._last is None:
            return self.counted(odometry)
        jump = "" if last is None else self._jump(last, odometry, vehicle)
        if jump:
            if self._steady_since_ns is None:
                self.jumps += 1
            self._steady_since_ns, self._jumped_by = odometry.t_ns, jump
        if self._steady_since_ns is None:
            return self.counted(odometry)
        if odometry.t_ns - self._steady_since_ns >= _STEADY_NS:
            self._steady_since_ns = None
            return self.counted(odometry)
        return replace(
            self.counted(odometry),
            status=OdometryStatus.LOST,
            quality=0,
            reason=f"pose jumped by {self._jumped_by}",
        )

    @property
    def withholds(self) -> bool:
        """Whether poses are being kept out after a jump."""
        return self._steady_since_ns is not None

    def counted(self, odometry: Odometry) -> Odometry:
        """Return the odometry with the jumps seen here added to its reset counter."""
        if not self.jumps:
            return odometry
        return replace(odometry, reset_counter=odometry.reset_counter + self.jumps)

    def _jump(self, last: Odometry, odometry: Odometry, vehicle: VehicleState | None) -> str:
        """Return by how much the pose has jumped, or an empty string."""
        step_ns = odometry.t_ns - last.t_ns
        # A counted reset is no secret, and after a long silence there is nothing to compare with.
        if odometry.reset_counter != last.reset_counter or not 0 < step_ns <= _LONGEST_STEP_NS:
            return ""
        step_s = step_ns * 1e-9
        v_map = self._reference_velocity(last, vehicle)
        steps = zip(odometry.p_map.tolist(), last.p_map.tolist(), v_map.tolist(), strict=True)
        off_m = math.hypot(*[now - before - v * step_s for now, before, v in steps])
        if off_m > self._settings.max_pose_jump_m + self._settings.max_acceleration_mps2 * step_s**2:
            return f"{off_m:.1f} m"
        if self._cannot_have_turned(last, odometry, step_s):
            return ""
        expected = rotation.multiply(last.q_map_body, rotation.exp(last.omega_body * step_s))
        off_deg = math.degrees(float(rotation.angle_between(expected, odometry.q_map_body)))
        if off_deg > self._settings.max_attitude_jump_deg:
            return f"{off_deg:.0f} deg"
        return ""

    def _cannot_have_turned(self, last: Odometry, odometry: Odometry, step_s: float) -> bool:
        """Return whether even the sum of the turn made and the turn expected is within the limit.

        It is for nearly every pose, and costs far less than the angle between the two.
        """
        products = zip(last.q_map_body.tolist(), odometry.q_map_body.tolist(), strict=True)
        cosine = abs(sum(a * b for a, b in products))
        made = 2.0 * math.acos(min(cosine, 1.0))
        expected = math.hypot(*last.omega_body.tolist()) * step_s
        return math.degrees(made + expected) <= self._settings.max_attitude_jump_deg

    def _reference_velocity(self, last: Odometry, vehicle: VehicleState | None) -> FloatArray:
        """Return PX4's velocity if it is fresh and has agreed until now, else the odometry's own."""
        if vehicle is None or not vehicle.connected or abs(last.t_ns - vehicle.t_local_ns) > _FRESH_NS:
            return last.v_map
        difference = math.dist(vehicle.v_map.tolist(), last.v_map.tolist())
        agrees = difference <= self._settings.max_velocity_disagreement_mps
        return vehicle.v_map if agrees else last.v_map
