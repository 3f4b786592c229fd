"""Predicates: what is true of the vehicle, the link and the odometry right now."""

import math
from dataclasses import dataclass

from companion.clock import seconds_to_ns
from companion.messages import FloatArray, LandedState, Odometry, OdometryStatus, VehicleMode, VehicleState
from companion.safety.settings import SafetySettings

_MAX_FUTURE_NS = seconds_to_ns(0.05)
_MAX_LOCAL_AGE_NS = seconds_to_ns(2.0)
_DISAGREEMENT_NS = seconds_to_ns(0.5)
_NEVER_NS = -seconds_to_ns(3600.0)


@dataclass(frozen=True, slots=True)
class Facts:
    """Everything that a state transition may depend on, as plain truths."""

    link: bool
    armed: bool
    airborne: bool
    mode: VehicleMode
    failsafe: bool
    standing: bool
    """The autopilot says that it stands on the ground; unlike `not airborne`, never a guess."""
    odometry_usable: bool
    odometry_lost: bool
    map_jumped: bool
    """The map frame is not the one in which the vehicle took off."""
    estimates_agree: bool
    authorised: bool
    revoked: bool
    finished: bool
    engage_timed_out: bool
    mode_left: bool
    """The autopilot is neither in OFFBOARD nor in the mode from which engaging began."""
    stopping: bool
    stalled: bool
    """The process did not decide for so long that the autopilot may have given it up."""
    problem: str
    """Why the odometry or the link is not usable; empty when both are."""

    @property
    def healthy(self) -> bool:
        """Control may rest on the present data."""
        return self.link and self.odometry_usable and self.estimates_agree

    @property
    def on_ground(self) -> bool:
        """The vehicle is disarmed and not flying."""
        return not self.armed and not self.airborne


class Checks:
    """Watches the newest estimates and the vehicle; turns them into facts at each tick."""

    def __init__(self, settings: SafetySettings) -> None:
        """Begin with nothing known."""
        self._settings = settings
        self._usable_ns = _NEVER_NS
        self._differs_since_ns: int | None = None
        self._map_counter: int | None = None

    def observe(
        self, odometry: Odometry | None, vehicle: VehicleState | None, t_scan_ns: int, t_ns: int
    ) -> None:
        """Note what can be seen at `t_ns`; call once a tick, before `facts`.

        Args:
            odometry: newest own motion.
            vehicle: newest state of the autopilot.
            t_scan_ns: host time of the newest registered scan, 0 before the first.
            t_ns: host time of the tick.
        """
        problem = self.perception_problem(odometry, t_scan_ns, t_ns)
        if not problem:
            self._usable_ns = t_ns
        if odometry is None or vehicle is None:
            return
        if not vehicle.armed and vehicle.landed is LandedState.ON_GROUND:
            # The flight to come refers to the map in which it began.
            self._map_counter = odometry.reset_counter
        if not problem and self._link(vehicle, t_ns):
            # Only a comparison that was made can end a disagreement.
            if not self.disagreement(odometry, vehicle):
                self._differs_since_ns = None
            elif self._differs_since_ns is None:
                self._differs_since_ns = t_ns

    def perception_problem(self, odometry: Odometry | None, t_scan_ns: int, t_ns: int) -> str:
        """Return why odometry and scans must not move the vehicle, or an empty string."""
        if odometry is None:
            return "no odometry yet"
        age_ns = t_ns - odometry.t_ns
        if age_ns > self._settings.max_data_age_ms * 1e6:
            return f"odometry is {age_ns / 1e6:.0f} ms old"
        if age_ns < -_MAX_FUTURE_NS:
            return f"odometry is {-age_ns / 1e6:.0f} ms in the future"
        if odometry.status in (OdometryStatus.INITIALISING, OdometryStatus.LOST):
            return f"odometry {odometry.status.name.lower()}: {odometry.reason or 'not ready'}"
        if odometry.quality < self._settings.min_quality:
            return f"odometry quality {odometry.quality}: {odometry.reason or 'low'}"
        motion = (odometry.p_map, odometry.v_map, odometry.q_map_body, odometry.omega_body)
        if not all(math.isfinite(number) for part in motion for number in part.tolist()):
            return "odometry is not finite"
        if t_scan_ns == 0:
            return "no scan yet"
        scan_age_ns = t_ns - t_scan_ns
        if scan_age_ns > self._settings.max_scan_age_ms * 1e6:
            return f"no scan for {scan_age_ns / 1e6:.0f} ms"
        return ""

    def disagreement(self, odometry: Odometry, vehicle: VehicleState) -> str:
        """Return how our estimate and the autopilot's differ beyond the limits, or an empty string."""
        heading = abs(math.remainder(_yaw(vehicle.q_map_body) - _yaw(odometry.q_map_body), math.tau))
        if not heading <= math.radians(self._settings.max_heading_disagreement_deg):
            return f"PX4's heading differs by {math.degrees(heading):.0f} deg"
        speed = math.dist(vehicle.v_map.tolist(), odometry.v_map.tolist())
        if not speed <= self._settings.max_velocity_disagreement_mps:
            return f"PX4's velocity differs by {speed:.1f} m/s"
        return ""

    def facts(
        self,
        odometry: Odometry | None,
        vehicle: VehicleState | None,
        t_scan_ns: int,
        t_ns: int,
        *,
        authorised: bool,
        revoked: bool,
        finished: bool,
        engage_timed_out: bool,
        mode_left: bool,
        stopping: bool,
        stalled: bool,
    ) -> Facts:
        """Summarise the situation at `t_ns`; the keyword arguments are passed on as they are."""
        link = vehicle is not None and self._link(vehicle, t_ns)
        blindness = self.perception_problem(odometry, t_scan_ns, t_ns)
        difference = ""
        if odometry is not None and vehicle is not None and link and not blindness:
            difference = self.disagreement(odometry, vehicle)
        agree = self._differs_since_ns is None or t_ns - self._differs_since_ns < _DISAGREEMENT_NS
        jumped = (
            odometry is not None
            and self._map_counter is not None
            and odometry.reset_counter != self._map_counter
        )
        return Facts(
            link=link,
            armed=vehicle is not None and vehicle.armed,
            airborne=vehicle is not None
            and vehicle.landed in (LandedState.IN_AIR, LandedState.TAKING_OFF, LandedState.LANDING),
            mode=vehicle.mode if vehicle is not None else VehicleMode.UNKNOWN,
            failsafe=vehicle is not None and vehicle.failsafe,
            standing=vehicle is not None and vehicle.landed is LandedState.ON_GROUND,
            odometry_usable=not blindness,
            odometry_lost=t_ns - self._usable_ns > self._settings.lost_after_ms * 1e6,
            map_jumped=jumped,
            estimates_agree=agree,
            authorised=authorised,
            revoked=revoked,
            finished=finished,
            engage_timed_out=engage_timed_out,
            mode_left=mode_left,
            stopping=stopping,
            stalled=stalled,
            problem=blindness or ("" if link else "no link to the autopilot") or difference,
        )

    def _link(self, vehicle: VehicleState, t_ns: int) -> bool:
        return vehicle.connected and t_ns - vehicle.t_local_ns < _MAX_LOCAL_AGE_NS


def _yaw(q_map_body: FloatArray) -> float:
    """Return `rotation.yaw_of` of one attitude, without arrays."""
    w, x, y, z = q_map_body.tolist()
    return math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
