"""What the autopilot says about the vehicle: telemetry folded into the latest state."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from companion.clock import seconds_to_ns
from companion.drivers.mavlink_fields import first_or_nan, integer, reals, text
from companion.drivers.px4_modes import (
    AUTOPILOT_PX4,
    is_armed,
    is_failsafe,
    landed_state_of,
    mode_of,
)
from companion.errors import ProtocolError
from companion.geometry import frames, rotation
from companion.messages import (
    LandedState,
    MavlinkMessage,
    Severity,
    StatusText,
    VehicleMode,
    VehicleState,
)

CONNECTION_TIMEOUT_NS = seconds_to_ns(3.0)
_HEARTBEAT_WINDOW_NS = seconds_to_ns(1.0)
# PX4 beats at 1 Hz; a router may double it. More than this has another author.
_MAX_HEARTBEATS = 4
_MAX_TEXTS = 32
_UINT32 = 2**32 - 1
_PREARM_CHECK = 0x10000000
_RC_RECEIVER = 0x10000


@dataclass(frozen=True, slots=True)
class AutopilotHealth:
    """The autopilot's view of itself, for preflight checks and the log.

    Attributes:
        t_estimator_ns: host time of the newest ESTIMATOR_STATUS, 0 if none yet.
        estimator_flags: its ESTIMATOR_STATUS_FLAGS.
        position_variance_m2: of the autopilot's own position, NaN if unknown.
        ready_to_arm: its pre-arm checks pass, for the mode it is in.
        manual_control: a radio control receiver is heard.
        battery_percent: -1 if unknown.
        battery_v: NaN if unknown.
    """

    t_estimator_ns: int
    estimator_flags: int
    position_variance_m2: float
    ready_to_arm: bool
    manual_control: bool
    battery_percent: int
    battery_v: float


class Px4Vehicle:
    """Latest state of the configured autopilot."""

    def __init__(self) -> None:
        """Begin unheard of."""
        self.texts: deque[StatusText] = deque(maxlen=_MAX_TEXTS)
        """The autopilot's own status texts, oldest first."""
        self._heartbeats: deque[int] = deque(maxlen=_MAX_HEARTBEATS + 1)
        self._mode_changes = 0
        self._custom_mode: int | None = None
        self.forget()

    def forget(self) -> None:
        """Drop everything known about a vehicle that has started anew; it counts as a mode change."""
        self._mode_changes += self._custom_mode is not None
        self._custom_mode = None
        self._t_heartbeat_ns: int | None = None
        self._armed = False
        self._failsafe = False
        self._landed = LandedState.UNKNOWN
        self._t_local_ns = 0
        self._t_attitude_ns = 0
        self._p_map = np.zeros(3)
        self._v_map = np.zeros(3)
        self._q_map_body = rotation.IDENTITY.copy()
        self._reset_counter = 0
        self._t_estimator_ns = 0
        self._estimator_flags = 0
        self._position_variance_m2 = float("nan")
        self._sensors_healthy = 0
        self._battery_percent = -1
        self._battery_v = float("nan")

    @property
    def mode(self) -> VehicleMode:
        """Present flight mode."""
        return VehicleMode.UNKNOWN if self._custom_mode is None else mode_of(self._custom_mode)

    @property
    def armed(self) -> bool:
        """The last heartbeat said armed."""
        return self._armed

    @property
    def mode_changes(self) -> int:
        """Mode changes seen so far; never goes back."""
        return self._mode_changes

    def connected(self, t_ns: int) -> bool:
        """Tell whether a heartbeat arrived within 3 s before `t_ns`."""
        return self._t_heartbeat_ns is not None and t_ns - self._t_heartbeat_ns <= CONNECTION_TIMEOUT_NS

    def suspect(self, t_ns: int) -> bool:
        """Tell whether heartbeats come faster than one autopilot sends them."""
        recent = [beat for beat in self._heartbeats if t_ns - beat <= _HEARTBEAT_WINDOW_NS]
        return len(recent) > _MAX_HEARTBEATS

    def state(self, t_ns: int) -> VehicleState:
        """Return the latest values at host time `t_ns`."""
        return VehicleState(
            t_ns=t_ns,
            connected=self.connected(t_ns),
            armed=self._armed,
            mode=self.mode,
            landed=self._landed,
            failsafe=self._failsafe,
            t_local_ns=min(self._t_local_ns, self._t_attitude_ns),
            p_map=self._p_map,
            v_map=self._v_map,
            q_map_body=self._q_map_body,
            estimator_reset_counter=self._reset_counter,
            mode_changes=self._mode_changes,
        )

    def health(self) -> AutopilotHealth:
        """Return the autopilot's view of itself."""
        return AutopilotHealth(
            t_estimator_ns=self._t_estimator_ns,
            estimator_flags=self._estimator_flags,
            position_variance_m2=self._position_variance_m2,
            ready_to_arm=bool(self._sensors_healthy & _PREARM_CHECK),
            manual_control=bool(self._sensors_healthy & _RC_RECEIVER),
            battery_percent=self._battery_percent,
            battery_v=self._battery_v,
        )

    def receive(self, message: MavlinkMessage, t_ns: int) -> bool:
        """Take one telemetry message; return whether it is one that is used.

        Raises:
            ProtocolError: if a field is missing or unusable; the state is then unchanged.
        """
        match message.name:
            case "HEARTBEAT":
                self._take_heartbeat(message, t_ns)
            case "CURRENT_MODE":
                self._take_mode(integer(message, "custom_mode", 0, _UINT32))
            case "LOCAL_POSITION_NED":
                local = reals(message, ("x", "y", "z", "vx", "vy", "vz"))
                self._p_map = frames.flu_from_frd(local[:3])
                self._v_map = frames.flu_from_frd(local[3:])
                self._t_local_ns = t_ns
            case "ATTITUDE_QUATERNION":
                self._take_attitude(reals(message, ("q1", "q2", "q3", "q4")))
                self._t_attitude_ns = t_ns
            case "ODOMETRY":
                variance = first_or_nan(message, "pose_covariance")
                self._reset_counter = integer(message, "reset_counter", 0, 0xFF)
                self._position_variance_m2 = variance
            case "EXTENDED_SYS_STATE":
                self._landed = landed_state_of(integer(message, "landed_state", 0, 0xFF))
            case "ESTIMATOR_STATUS":
                self._estimator_flags = integer(message, "flags", 0, 0xFFFF)
                self._t_estimator_ns = t_ns
            case "SYS_STATUS":
                healthy = integer(message, "onboard_control_sensors_health", 0, _UINT32)
                millivolts = integer(message, "voltage_battery", 0, 0xFFFF)
                self._battery_percent = integer(message, "battery_remaining", -1, 100)
                self._battery_v = millivolts / 1000.0 if millivolts != 0xFFFF else float("nan")
                self._sensors_healthy = healthy
            case "BATTERY_STATUS":
                if integer(message, "id", 0, 0xFF) == 0:
                    self._battery_percent = integer(message, "battery_remaining", -1, 100)
            case "STATUSTEXT":
                severity = Severity(min(max(integer(message, "severity", 0, 7), 2), 6))
                self.texts.append(StatusText(t_ns, severity, text(message, "text", 50)))
            case _:
                return False
        return True

    def _take_heartbeat(self, message: MavlinkMessage, t_ns: int) -> None:
        autopilot = integer(message, "autopilot", 0, 0xFF)
        if autopilot != AUTOPILOT_PX4:
            raise ProtocolError(f"the autopilot is of kind {autopilot}, not PX4 ({AUTOPILOT_PX4})")
        base_mode = integer(message, "base_mode", 0, 0xFF)
        custom_mode = integer(message, "custom_mode", 0, _UINT32)
        status = integer(message, "system_status", 0, 0xFF)
        self._armed = is_armed(base_mode)
        self._failsafe = is_failsafe(status)
        self._t_heartbeat_ns = t_ns
        self._heartbeats.append(t_ns)
        self._take_mode(custom_mode)

    def _take_mode(self, custom_mode: int) -> None:
        self._mode_changes += self._custom_mode is not None and custom_mode != self._custom_mode
        self._custom_mode = custom_mode

    def _take_attitude(self, q_frd: list[float]) -> None:
        norm = sum(value * value for value in q_frd) ** 0.5
        if abs(norm - 1.0) > 0.01:
            raise ProtocolError(f"an attitude of norm {norm:.3f} is none")
        self._q_map_body = frames.q_flu_from_frd(q_frd)
