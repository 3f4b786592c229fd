"""What velocity the emulated autopilot wants in each flight mode, in its own local frame.

Everything here acts on the estimate alone; the vehicle moves as wrongly as the estimate is wrong.
"""

import math
from dataclasses import dataclass

from companion.messages import VehicleMode
from sitl.autopilot_estimator import Estimator
from sitl.autopilot_filter import seconds_between, turn_about_z, wrap_angle
from sitl.autopilot_inputs import OffboardSetpoint, Sticks, Vector
from sitl.autopilot_parameters import Parameters

_GRAVITY = 9.81
_STANDSTILL_M_S = 0.2
_SLOW_LANDING_HEIGHT_M = 0.6
_SLOW_LANDING_M_S = 0.45
_RAMP_START_M_S = -2.45
_STICK_DEAD_ZONE = 0.05
_RETURN_ARRIVAL_M = 1.0


@dataclass(frozen=True, slots=True)
class Demand:
    """What one mode wants.

    Attributes:
        v_local: velocity in m/s; its horizontal part counts only if `horizontal`.
        horizontal: horizontal velocity is controlled; otherwise the vehicle accelerates as tilted.
        accel_heading: forward and left acceleration in m/s^2 by deliberate tilt, if not controlled.
        yaw_rate: rad/s, counter-clockwise.
        p_local: the position held, None where none is.
        done: takeoff has reached its height.
        descending: the mode is bringing the vehicle down.
    """

    v_local: Vector
    horizontal: bool = True
    accel_heading: tuple[float, float] = (0.0, 0.0)
    yaw_rate: float = 0.0
    p_local: Vector | None = None
    done: bool = False
    descending: bool = False


class Guidance:
    """Turns mode, setpoint and sticks into a velocity, remembering what is being held."""

    def __init__(self, parameters: Parameters) -> None:
        """Hold nothing yet; `parameters` are read anew at every use."""
        self._parameters = parameters
        self._mode: VehicleMode | None = None
        self._p_hold: Vector | None = None
        self._p_shift: Vector = (0.0, 0.0, 0.0)
        self._yaw_hold: float | None = None
        self._t_takeoff_ns: int | None = None
        self._takeoff_height = 0.0
        self._descending = False
        self.p_home: Vector = (0.0, 0.0, 0.0)

    def armed_at(self, t_ns: int, estimator: Estimator) -> None:
        """Note that motors started: home is here, and the thrust ramp begins."""
        self.p_home = estimator.p_local
        self._p_shift = estimator.motion.p_shift
        self._p_hold = None
        self._t_takeoff_ns = t_ns
        self._mode = None

    def demand(
        self,
        t_ns: int,
        mode: VehicleMode,
        estimator: Estimator,
        setpoint: OffboardSetpoint | None,
        sticks: Sticks,
        landed: bool,
    ) -> Demand:
        """Return what `mode` wants now.

        Args:
            t_ns: present time.
            mode: the mode in force.
            estimator: the estimate to act on.
            setpoint: the last offboard setpoint.
            sticks: the pilot's.
            landed: the land detector's verdict.
        """
        if mode is not self._mode:
            self._enter(mode, estimator)
        self._follow_jumps(estimator)
        if mode is VehicleMode.OFFBOARD:
            wanted = self._offboard(estimator, setpoint)
        elif mode is VehicleMode.TAKEOFF:
            wanted = self._takeoff(estimator)
        elif mode is VehicleMode.LAND:
            wanted = self._land(estimator)
        elif mode is VehicleMode.RETURN:
            wanted = self._return(estimator)
        elif mode in (VehicleMode.HOLD, VehicleMode.MISSION):
            wanted = self._hold(estimator)
        else:
            wanted = self._manual(mode, estimator, sticks)
        return self._limited(t_ns, wanted, landed)

    def _enter(self, mode: VehicleMode, estimator: Estimator) -> None:
        keep = {self._mode, mode} == {VehicleMode.TAKEOFF, VehicleMode.HOLD}
        self._mode = mode
        self._descending = False
        if not keep or self._p_hold is None:
            self._p_hold = None
            self._yaw_hold = estimator.yaw
        if mode is VehicleMode.TAKEOFF:
            altitude = float(self._parameters["MIS_TAKEOFF_ALT"])
            p = estimator.p_local
            self._takeoff_height = max(self.p_home[2] + altitude, p[2])
            self._p_hold = (p[0], p[1], self._takeoff_height)

    def _follow_jumps(self, estimator: Estimator) -> None:
        shift, last = estimator.motion.p_shift, self._p_shift
        if shift != last:
            moved = (shift[0] - last[0], shift[1] - last[1], shift[2] - last[2])
            self.p_home = _sum(self.p_home, moved)
            self._takeoff_height += moved[2]
            if self._p_hold is not None:
                self._p_hold = _sum(self._p_hold, moved)
            self._p_shift = shift

    def _offboard(self, estimator: Estimator, setpoint: OffboardSetpoint | None) -> Demand:
        if setpoint is None:
            return self._hold(estimator)
        v = setpoint.v_local or (0.0, 0.0, 0.0)
        if setpoint.v_in_heading:
            v = turn_about_z(estimator.yaw, v)
        if setpoint.p_local is not None:
            v = _sum(v, self._towards(estimator, setpoint.p_local, float(self._parameters["MPC_XY_VEL_MAX"])))
        if setpoint.yaw is not None:
            self._yaw_hold = setpoint.yaw
            return Demand(v, yaw_rate=self._turn_rate(estimator), p_local=setpoint.p_local)
        if setpoint.yaw_rate is not None:
            self._yaw_hold = estimator.yaw
            return Demand(v, yaw_rate=setpoint.yaw_rate, p_local=setpoint.p_local)
        return Demand(v, yaw_rate=self._turn_rate(estimator), p_local=setpoint.p_local)

    def _takeoff(self, estimator: Estimator) -> Demand:
        p_hold = self._p_hold or estimator.p_local
        v = self._towards(estimator, p_hold, float(self._parameters["MPC_XY_CRUISE"]))
        climb = min(v[2], float(self._parameters["MPC_TKO_SPEED"]))
        reached = estimator.p_local[2] >= p_hold[2] - min(0.5, float(self._parameters["NAV_MC_ALT_RAD"]))
        return Demand(
            (v[0], v[1], climb),
            horizontal=estimator.position_valid,
            yaw_rate=self._turn_rate(estimator),
            p_local=p_hold,
            done=reached,
        )

    def _land(self, estimator: Estimator) -> Demand:
        if not estimator.position_valid:
            self._p_hold = None
            v: Vector = (0.0, 0.0, 0.0)
        else:
            v = self._standing(estimator)
        above_home = estimator.p_local[2] - self.p_home[2]
        speed = float(self._parameters["MPC_LAND_SPEED"])
        if above_home < _SLOW_LANDING_HEIGHT_M:
            speed = min(speed, _SLOW_LANDING_M_S)
        return Demand(
            (v[0], v[1], -speed),
            horizontal=estimator.position_valid,
            yaw_rate=self._turn_rate(estimator),
            descending=True,
        )

    def _return(self, estimator: Estimator) -> Demand:
        p, home = estimator.p_local, self.p_home
        distance = math.hypot(home[0] - p[0], home[1] - p[1])
        if self._descending or distance < _RETURN_ARRIVAL_M:
            if not self._descending:
                self._p_hold = (home[0], home[1], p[2])
            self._descending = True
            return self._land(estimator)
        near = distance < float(self._parameters["RTL_MIN_DIST"])
        climb = float(self._parameters["RTL_DESCEND_ALT" if near else "RTL_RETURN_ALT"])
        height = max(p[2], home[2] + climb)
        climbing = p[2] < home[2] + climb - 0.5
        if climbing and self._p_hold is None:
            self._p_hold = (p[0], p[1], height)
        target = (self._p_hold or p) if climbing else (home[0], home[1], height)
        v = self._towards(estimator, (target[0], target[1], height), float(self._parameters["MPC_XY_CRUISE"]))
        return Demand(v, yaw_rate=self._turn_rate(estimator), p_local=(target[0], target[1], height))

    def _hold(self, estimator: Estimator) -> Demand:
        v = self._standing(estimator)
        return Demand(v, estimator.position_valid, yaw_rate=self._turn_rate(estimator), p_local=self._p_hold)

    def _manual(self, mode: VehicleMode, estimator: Estimator, sticks: Sticks) -> Demand:
        turning = abs(sticks.yaw) > _STICK_DEAD_ZONE
        yaw_rate = -math.radians(float(self._parameters["MPC_MAN_Y_MAX"])) * sticks.yaw if turning else 0.0
        if turning:
            self._yaw_hold = estimator.yaw
        else:
            yaw_rate = self._turn_rate(estimator)
        climb = sticks.throttle * float(self._parameters["MPC_Z_VEL_MAX_UP"])
        if mode is not VehicleMode.POSITION:
            tilt = math.radians(float(self._parameters["MPC_MAN_TILT_MAX"]))
            accel = (_GRAVITY * math.tan(tilt * sticks.pitch), -_GRAVITY * math.tan(tilt * sticks.roll))
            return Demand((0.0, 0.0, climb), horizontal=False, accel_heading=accel, yaw_rate=yaw_rate)
        if max(abs(sticks.pitch), abs(sticks.roll), abs(sticks.throttle)) <= _STICK_DEAD_ZONE:
            v = self._standing(estimator)
        else:
            self._p_hold = None
            speed = float(self._parameters["MPC_VEL_MANUAL"])
            v = turn_about_z(estimator.yaw, (speed * sticks.pitch, -speed * sticks.roll, climb))
        return Demand(v, estimator.position_valid, yaw_rate=yaw_rate, p_local=self._p_hold)

    def _standing(self, estimator: Estimator) -> Vector:
        """Brake, then hold the place where the vehicle came to rest."""
        if self._p_hold is None:
            v = estimator.v_local
            if math.hypot(v[0], v[1]) > _STANDSTILL_M_S or (
                abs(v[2]) > _STANDSTILL_M_S and self._mode is not VehicleMode.LAND
            ):
                return (0.0, 0.0, 0.0)
            self._p_hold = estimator.p_local
        return self._towards(estimator, self._p_hold, float(self._parameters["MPC_XY_CRUISE"]))

    def _towards(self, estimator: Estimator, p_local: Vector, speed: float) -> Vector:
        p = estimator.p_local
        gain, gain_z = float(self._parameters["MPC_XY_P"]), float(self._parameters["MPC_Z_P"])
        v_x, v_y = gain * (p_local[0] - p[0]), gain * (p_local[1] - p[1])
        scale = min(1.0, speed / max(math.hypot(v_x, v_y), 1.0e-9))
        return (scale * v_x, scale * v_y, gain_z * (p_local[2] - p[2]))

    def _turn_rate(self, estimator: Estimator) -> float:
        if self._yaw_hold is None:
            return 0.0
        rate = float(self._parameters["MC_YAW_P"]) * wrap_angle(self._yaw_hold - estimator.yaw)
        limit = math.radians(float(self._parameters["MPC_YAWRAUTO_MAX"]))
        return max(-limit, min(limit, rate))

    def _limited(self, t_ns: int, wanted: Demand, landed: bool) -> Demand:
        v = wanted.v_local
        speed_max = float(self._parameters["MPC_XY_VEL_MAX"])
        scale = min(1.0, speed_max / max(math.hypot(v[0], v[1]), 1.0e-9))
        up = float(self._parameters["MPC_Z_VEL_MAX_UP"])
        climb = max(-float(self._parameters["MPC_Z_VEL_MAX_DN"]), min(up, v[2]))
        v_limited = (scale * v[0], scale * v[1], self._ramped(t_ns, climb, landed))
        return Demand(
            v_limited,
            wanted.horizontal,
            wanted.accel_heading,
            wanted.yaw_rate,
            wanted.p_local,
            wanted.done,
            wanted.descending,
        )

    def _ramped(self, t_ns: int, climb: float, landed: bool) -> float:
        """Limit the climb rate while motors spool up and thrust ramps from below hover to flight."""
        if self._t_takeoff_ns is None:
            return climb
        since_s = seconds_between(self._t_takeoff_ns, t_ns) - float(self._parameters["COM_SPOOLUP_TIME"])
        if landed and climb <= 0.0:
            self._t_takeoff_ns = max(
                self._t_takeoff_ns, t_ns - round(1e9 * float(self._parameters["COM_SPOOLUP_TIME"]))
            )
            return climb
        duration_s = float(self._parameters["MPC_TKO_RAMP_T"])
        if since_s >= duration_s:
            self._t_takeoff_ns = None
            return climb
        progress = max(0.0, since_s) / max(duration_s, 1.0e-3)
        return min(climb, _RAMP_START_M_S + progress * (max(climb, 0.0) - _RAMP_START_M_S))


def _sum(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])
