"""Failsafes of the emulated autopilot: what to fly when the chosen mode cannot or must not go on."""

from dataclasses import dataclass

from companion.clock import seconds_to_ns
from companion.messages import VehicleMode
from sitl.autopilot_modes import AUTOMATIC_MODES, Conditions, can_run
from sitl.autopilot_parameters import Parameters

_LATENCY_NS = seconds_to_ns(0.08)
_OFFBOARD_LOSS = {
    0: VehicleMode.POSITION,
    1: VehicleMode.ALTITUDE,
    2: VehicleMode.STABILIZED,
    3: VehicleMode.RETURN,
    4: VehicleMode.LAND,
    5: VehicleMode.HOLD,
}
_LINK_LOSS = {1: VehicleMode.HOLD, 2: VehicleMode.RETURN, 3: VehicleMode.LAND}
_FALLBACKS = {
    VehicleMode.POSITION: (VehicleMode.ALTITUDE, VehicleMode.STABILIZED, VehicleMode.RETURN),
    VehicleMode.ALTITUDE: (VehicleMode.STABILIZED, VehicleMode.RETURN),
    VehicleMode.STABILIZED: (VehicleMode.RETURN,),
    VehicleMode.HOLD: (),
    VehicleMode.RETURN: (),
}
_RANK = (VehicleMode.HOLD, VehicleMode.RETURN, VehicleMode.LAND)
_EXEMPTION_BITS = {VehicleMode.MISSION: 1, VehicleMode.HOLD: 2, VehicleMode.OFFBOARD: 4}


@dataclass(frozen=True, slots=True)
class FailsafeDecision:
    """The failsafe's will.

    Attributes:
        mode: what to fly instead of the user's mode, None for none.
        reason: why.
        holding: COM_FAIL_ACT_T is running; sticks cannot take over yet.
    """

    mode: VehicleMode | None
    reason: str = ""
    holding: bool = False


NO_FAILSAFE = FailsafeDecision(None)


class Failsafe:
    """Watches manual control, setpoints, estimate, ground station and battery while armed."""

    def __init__(self, parameters: Parameters) -> None:
        """Watch nothing yet; `parameters` are read anew at every use."""
        self._parameters = parameters
        self.reset(manual_control=False)

    def reset(self, manual_control: bool) -> None:
        """Forget everything at arming; manual control that was never there cannot be lost."""
        self._had_manual = manual_control
        self._t_blocked_ns: int | None = None
        self._t_manual_lost_ns: int | None = None
        self._manual_lost = False

    def mode_changed(self) -> None:
        """Note that someone selected a mode, which ends a manual control failsafe."""
        self._manual_lost = False
        self._t_manual_lost_ns = None

    def decide(
        self,
        t_ns: int,
        mode: VehicleMode,
        conditions: Conditions,
        landed: bool,
        ground_station_lost: bool,
        battery: float,
    ) -> FailsafeDecision:
        """Return what must be flown instead of the user's `mode`, the most severe first.

        Args:
            t_ns: present time.
            mode: the mode the user intends.
            conditions: what can be relied on.
            landed: the vehicle stands.
            ground_station_lost: no ground station heartbeat for COM_DL_LOSS_T after there was one.
            battery: remaining share, 0 to 1.
        """
        decisions = [
            self._mode_fallback(t_ns, mode, conditions),
            self._manual_loss(t_ns, mode, conditions, landed),
            self._ground_station_loss(conditions, ground_station_lost),
            self._low_battery(conditions, battery),
        ]
        active = [decision for decision in decisions if decision.mode is not None]
        return max(active, key=_severity, default=NO_FAILSAFE)

    def _mode_fallback(self, t_ns: int, mode: VehicleMode, conditions: Conditions) -> FailsafeDecision:
        if can_run(mode, conditions):
            self._t_blocked_ns = None
            return NO_FAILSAFE
        if self._t_blocked_ns is None:
            self._t_blocked_ns = t_ns
        if t_ns - self._t_blocked_ns < _LATENCY_NS:
            return NO_FAILSAFE
        if mode is VehicleMode.OFFBOARD and not conditions.offboard_signal:
            action = _OFFBOARD_LOSS.get(int(self._parameters["COM_OBL_RC_ACT"]), VehicleMode.LAND)
            return FailsafeDecision(first_possible(action, conditions), "offboard signal lost")
        if mode in AUTOMATIC_MODES or mode is VehicleMode.OFFBOARD:
            reason = "position estimate lost"
            action = VehicleMode.ALTITUDE if conditions.manual_control else VehicleMode.RETURN
            return FailsafeDecision(first_possible(action, conditions), reason)
        if conditions.manual_control:
            return FailsafeDecision(first_possible(mode, conditions), "position estimate lost")
        if int(self._parameters["NAV_RCL_ACT"]) in _LINK_LOSS:
            return NO_FAILSAFE
        return FailsafeDecision(first_possible(mode, conditions), "manual control lost")

    def _manual_loss(
        self, t_ns: int, mode: VehicleMode, conditions: Conditions, landed: bool
    ) -> FailsafeDecision:
        self._had_manual |= conditions.manual_control
        exempt = int(self._parameters["COM_RCL_EXCEPT"]) & _EXEMPTION_BITS.get(mode, 0)
        action = _LINK_LOSS.get(int(self._parameters["NAV_RCL_ACT"]))
        if self._had_manual and not conditions.manual_control and not exempt and not landed:
            self._manual_lost = True
        if not self._manual_lost or action is None:
            self._t_manual_lost_ns = None
            return NO_FAILSAFE
        if self._t_manual_lost_ns is None:
            self._t_manual_lost_ns = t_ns
        delay_ns = seconds_to_ns(float(self._parameters["COM_FAIL_ACT_T"]))
        if t_ns - self._t_manual_lost_ns < delay_ns and can_run(VehicleMode.HOLD, conditions):
            return FailsafeDecision(VehicleMode.HOLD, "manual control lost", holding=True)
        return FailsafeDecision(first_possible(action, conditions), "manual control lost")

    def _ground_station_loss(self, conditions: Conditions, lost: bool) -> FailsafeDecision:
        action = _LINK_LOSS.get(int(self._parameters["NAV_DLL_ACT"]))
        if not lost or action is None:
            return NO_FAILSAFE
        return FailsafeDecision(first_possible(action, conditions), "ground station lost")

    def _low_battery(self, conditions: Conditions, battery: float) -> FailsafeDecision:
        action = int(self._parameters["COM_LOW_BAT_ACT"])
        if action == 0:
            return NO_FAILSAFE
        if battery < float(self._parameters["BAT_EMERGEN_THR"]):
            return FailsafeDecision(VehicleMode.LAND, "battery emergency")
        if battery < float(self._parameters["BAT_CRIT_THR"]):
            wanted = VehicleMode.RETURN if action == 3 else VehicleMode.LAND
            return FailsafeDecision(first_possible(wanted, conditions), "battery critical")
        return NO_FAILSAFE


def first_possible(mode: VehicleMode, conditions: Conditions) -> VehicleMode:
    """Return `mode` or its nearest fallback that can run; Land always can."""
    for candidate in (mode, *_FALLBACKS.get(mode, ())):
        if can_run(candidate, conditions):
            return candidate
    return VehicleMode.LAND


def _severity(decision: FailsafeDecision) -> int:
    return _RANK.index(decision.mode) + 1 if decision.mode in _RANK else 0
