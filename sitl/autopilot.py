"""The emulated autopilot: PX4's modes, arming, offboard rules, failsafes and control, without sockets.

A pure state machine in steps of a few milliseconds. It receives commands, setpoints, sticks and external
vision through plain calls, sees the true motion only as its sensors would, and answers with the velocity
that the vehicle's inner loops are to follow. Rules and figures are those measured on PX4 1.18.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from companion.clock import seconds_to_ns
from companion.messages import FloatArray, LandedState, VehicleMode
from companion.settings import Settings
from sitl.autopilot_estimator import Estimator, EstimatorSettings
from sitl.autopilot_failsafe import NO_FAILSAFE, Failsafe, FailsafeDecision
from sitl.autopilot_filter import rotate_by, seconds_between, turn_about_z
from sitl.autopilot_guidance import Demand, Guidance
from sitl.autopilot_inputs import ExternalVision, OffboardSetpoint, Sticks, Vector
from sitl.autopilot_landing import LandDetector
from sitl.autopilot_modes import AUTOMATIC_MODES, CommandResult, Conditions, can_arm, can_run
from sitl.autopilot_parameters import Parameters
from sitl.vehicle_truth import VehicleTruth

_VISION_QUEUE = 16
_NOTICE_QUEUE = 32
_TILT_RESPONSE_S = 0.6
_GRAVITY = 9.81
_STILL = Demand((0.0, 0.0, 0.0))


class AutopilotSettings(Settings):
    """The emulated autopilot's build: boot state, power and sensor quality."""

    boot_mode: VehicleMode = VehicleMode.HOLD
    """Mode after power-on."""
    battery_endurance_s: float = Field(900.0, gt=0.0, le=1.0e6)
    """Armed time that empties the battery."""
    battery_start: float = Field(1.0, ge=0.0, le=1.0)
    """Charge at power-on."""
    estimator: EstimatorSettings = EstimatorSettings()
    """Imperfections of the estimate."""


@dataclass(frozen=True, slots=True, eq=False)
class AutopilotOutput:
    """What the vehicle's inner loops get.

    Attributes:
        v_command_world: (3,) wanted velocity in m/s, turned into the world by the believed heading.
        v_estimated_world: (3,) believed velocity turned likewise; its error becomes real drift.
        yaw_rate: rad/s, counter-clockwise.
        armed: motors turn.
        mode: the mode being flown.
        horizontal_controlled: False in modes and failsafes without horizontal velocity control.
    """

    v_command_world: FloatArray
    v_estimated_world: FloatArray
    yaw_rate: float
    armed: bool
    mode: VehicleMode
    horizontal_controlled: bool


class Autopilot:
    """PX4's flight logic.

    Attributes:
        parameters: PX4 parameters by name.
        estimator: own motion as believed.
        armed: motors turn.
        demand: what the present mode wants, in the local frame.
        battery: remaining charge, 0 to 1.
        omega_body: measured angular rate of the forward-left-up body, rad/s.
        specific_force_body: measured specific force, m/s^2.
        notices: (severity, text) lines for the ground station, oldest first, to be drained by the owner.
    """

    def __init__(self, settings: AutopilotSettings, parameters: Parameters, rng: np.random.Generator) -> None:
        """Power on, disarmed, on the ground.

        Args:
            settings: the build.
            parameters: PX4 parameters, changed in place by parameter messages.
            rng: source of all noise.
        """
        self._settings = settings
        self.parameters = parameters
        self.estimator = Estimator(settings.estimator, parameters, rng)
        self.armed = False
        self.demand = _STILL
        self.battery = settings.battery_start
        self.notices: deque[tuple[int, str]] = deque(maxlen=_NOTICE_QUEUE)
        self._user_mode = settings.boot_mode
        self._mode = settings.boot_mode
        self._guidance = Guidance(parameters)
        self._land_detector = LandDetector()
        self._failsafe = Failsafe(parameters)
        self._decision: FailsafeDecision = NO_FAILSAFE
        self._visions: deque[ExternalVision] = deque(maxlen=_VISION_QUEUE)
        self._setpoint: OffboardSetpoint | None = None
        self._t_setpoint_ns: int | None = None
        self._sticks = Sticks()
        self._t_sticks_ns: int | None = None
        self._t_ground_station_ns: int | None = None
        self.omega_body: Vector = (0.0, 0.0, 0.0)
        self.specific_force_body: Vector = (0.0, 0.0, _GRAVITY)
        self._t_ns = 0
        self._t_armed_ns = 0
        self._t_landed_ns: int | None = None
        self._has_flown = False

    @property
    def mode(self) -> VehicleMode:
        """The mode being flown, which a failsafe may have chosen."""
        return self._mode

    @property
    def user_mode(self) -> VehicleMode:
        """The mode that was asked for last."""
        return self._user_mode

    @property
    def failsafe(self) -> bool:
        """Whether a failsafe overrides the chosen mode."""
        return self._decision.mode is not None

    @property
    def landed(self) -> bool:
        """The land detector's verdict."""
        return self._land_detector.landed

    @property
    def landed_state(self) -> LandedState:
        """What EXTENDED_SYS_STATE reports."""
        if self.landed:
            return LandedState.ON_GROUND
        if self._mode is VehicleMode.TAKEOFF and not self.demand.done:
            return LandedState.TAKING_OFF
        return LandedState.LANDING if self.demand.descending else LandedState.IN_AIR

    @property
    def manual_control(self) -> bool:
        """Whether sticks arrived within COM_RC_LOSS_T."""
        return self._is_recent(self._t_sticks_ns, float(self.parameters["COM_RC_LOSS_T"]))

    @property
    def ready_to_arm(self) -> bool:
        """Whether an arm command would succeed in the present mode."""
        return can_arm(self._user_mode, self.conditions())

    def conditions(self) -> Conditions:
        """Return what can be relied on now."""
        estimator = self.estimator
        return Conditions(
            local_position=estimator.position_valid,
            local_velocity=estimator.velocity_valid,
            altitude=estimator.height_valid,
            global_position=estimator.global_valid,
            manual_control=self.manual_control,
            offboard_signal=self._is_recent(self._t_setpoint_ns, float(self.parameters["COM_OF_LOSS_T"])),
        )

    def request_mode(self, mode: VehicleMode) -> CommandResult:
        """Select a mode, as a ground station, companion or pilot's switch does.

        A mode that cannot run is refused while armed; Offboard without a fresh setpoint always is.
        """
        conditions = self.conditions()
        blocked = mode is VehicleMode.OFFBOARD and not conditions.offboard_signal
        if blocked or (self.armed and not can_run(mode, conditions)):
            self._notice(4, f"Mode {mode.value} refused")
            return CommandResult.TEMPORARILY_REJECTED
        self._user_mode = mode
        self._failsafe.mode_changed()
        if self.armed:
            self._decide(self._t_ns, conditions)
        else:
            self._mode = mode
        return CommandResult.ACCEPTED

    def pilot_select_mode(self, mode: VehicleMode) -> CommandResult:
        """Flick the pilot's mode switch; Position falls back to Altitude without a position estimate."""
        result = self.request_mode(mode)
        if result is not CommandResult.ACCEPTED and mode is VehicleMode.POSITION:
            return self.request_mode(VehicleMode.ALTITUDE)
        return result

    def request_arming(self, arm: bool, force: bool = False) -> CommandResult:
        """Start or stop the motors; in the air they stop only by force."""
        if arm == self.armed:
            return CommandResult.ACCEPTED
        if not arm:
            if not self.landed and not force:
                return CommandResult.TEMPORARILY_REJECTED
            self._disarm()
            return CommandResult.ACCEPTED
        if not self.ready_to_arm and not force:
            self._notice(2, f"Arming denied in mode {self._user_mode.value}")
            return CommandResult.TEMPORARILY_REJECTED
        self.armed = True
        self._t_armed_ns = self._t_ns
        self._has_flown = False
        self._t_landed_ns = None
        self._failsafe.reset(self.manual_control)
        self._guidance.armed_at(self._t_ns, self.estimator)
        return CommandResult.ACCEPTED

    def offboard_setpoint(self, t_ns: int, setpoint: OffboardSetpoint) -> None:
        """Take one offboard setpoint: the proof of life and what to fly."""
        self._setpoint = setpoint
        self._t_setpoint_ns = t_ns

    def external_vision(self, sample: ExternalVision) -> None:
        """Queue one external vision sample for the next step."""
        self._visions.append(sample)

    def pilot_sticks(self, t_ns: int, sticks: Sticks) -> None:
        """Take stick positions; a fast movement in an automatic or Offboard flight takes over."""
        previous, t_previous_ns, fresh = self._sticks, self._t_sticks_ns, self.manual_control
        self._sticks, self._t_sticks_ns = sticks, t_ns
        if not (self.armed and fresh and t_previous_ns is not None) or self._decision.holding:
            return
        interval_s = max(seconds_between(t_previous_ns, t_ns), 1.0e-3)
        movement = max(
            abs(sticks.pitch - previous.pitch),
            abs(sticks.roll - previous.roll),
            abs(sticks.throttle - previous.throttle),
            abs(sticks.yaw - previous.yaw),
        )
        automatic = self._mode is VehicleMode.OFFBOARD or self._mode in AUTOMATIC_MODES
        if automatic and movement / interval_s > float(self.parameters["MAN_OVERRIDE_SPD"]):
            self._t_ns = max(self._t_ns, t_ns)
            self.pilot_select_mode(VehicleMode.POSITION)

    def ground_station_heartbeat(self, t_ns: int) -> None:
        """Note that a ground station is there."""
        self._t_ground_station_ns = t_ns

    def step(self, t_ns: int, truth: VehicleTruth) -> AutopilotOutput:
        """Advance to `t_ns` and return what the vehicle is to do.

        Args:
            t_ns: present time, increasing from step to step.
            truth: true motion at that time.
        """
        elapsed_s = seconds_between(self._t_ns, t_ns)
        self._t_ns = t_ns
        self._sense(truth)
        self.estimator.step(truth, self.landed)
        while self._visions:
            self.estimator.fuse_vision(self._visions.popleft())
        if self.armed:
            self._drain_battery(elapsed_s)
            self._decide(t_ns, self.conditions())
            self.demand = self._guidance.demand(
                t_ns, self._mode, self.estimator, self._setpoint, self._sticks, self.landed
            )
            self._finish_takeoff()
        else:
            self.demand = _STILL
        landed = self._land_detector.step(t_ns, truth.on_ground, self.armed, self.demand.v_local[2])
        self._auto_disarm(t_ns, landed)
        return self._output(truth)

    def _sense(self, truth: VehicleTruth) -> None:
        o_x, o_y, o_z = truth.omega_body.tolist()
        a_x, a_y, a_z = truth.accel_world.tolist()
        w, x, y, z = truth.q_world_body.tolist()
        self.omega_body = (o_x, o_y, o_z)
        self.specific_force_body = rotate_by((w, -x, -y, -z), (a_x, a_y, a_z + _GRAVITY))

    def _is_recent(self, t_last_ns: int | None, within_s: float) -> bool:
        return t_last_ns is not None and self._t_ns - t_last_ns <= seconds_to_ns(within_s)

    def _decide(self, t_ns: int, conditions: Conditions) -> None:
        ground_station_lost = self._t_ground_station_ns is not None and not self._is_recent(
            self._t_ground_station_ns, float(self.parameters["COM_DL_LOSS_T"])
        )
        decision = self._failsafe.decide(
            t_ns, self._user_mode, conditions, self.landed, ground_station_lost, self.battery
        )
        if decision.mode is not None and decision != self._decision:
            self._notice(2, f"Failsafe {decision.mode.value}: {decision.reason}")
        self._decision = decision
        self._mode = decision.mode or self._user_mode

    def _finish_takeoff(self) -> None:
        done = self._user_mode is VehicleMode.TAKEOFF and self._mode is VehicleMode.TAKEOFF
        if done and self.demand.done and can_run(VehicleMode.HOLD, self.conditions()):
            self._user_mode = self._mode = VehicleMode.HOLD

    def _auto_disarm(self, t_ns: int, landed: bool) -> None:
        if not self.armed:
            return
        if not landed:
            self._has_flown, self._t_landed_ns = True, None
            return
        if self._t_landed_ns is None:
            self._t_landed_ns = t_ns
        name = "COM_DISARM_LAND" if self._has_flown else "COM_DISARM_PRFLT"
        delay_s = float(self.parameters[name])
        since_ns = self._t_landed_ns if self._has_flown else self._t_armed_ns
        if delay_s > 0.0 and t_ns - since_ns >= seconds_to_ns(delay_s):
            self._disarm()

    def _disarm(self) -> None:
        self.armed = False
        self._decision = NO_FAILSAFE
        if self._user_mode in (VehicleMode.TAKEOFF, VehicleMode.LAND, VehicleMode.RETURN):
            self._user_mode = VehicleMode.HOLD
        self._mode = self._user_mode

    def _drain_battery(self, dt_s: float) -> None:
        self.battery = max(0.0, self.battery - dt_s / self._settings.battery_endurance_s)

    def _notice(self, severity: int, text: str) -> None:
        self.notices.append((severity, text))

    def _output(self, truth: VehicleTruth) -> AutopilotOutput:
        turn_back = -self.estimator.motion.turn
        demand = self.demand
        v_command = turn_about_z(turn_back, demand.v_local)
        v_estimated = turn_about_z(turn_back, self.estimator.v_local)
        if self.armed and not demand.horizontal:
            v_x, v_y, _ = truth.v_world.tolist()
            forward, left = demand.accel_heading
            a_x, a_y, _ = turn_about_z(self.estimator.yaw + turn_back, (forward, left, 0.0))
            error = self._settings.estimator.coasting_acceleration_m_s2
            e_x, e_y = self.estimator.coasting_direction_local
            e_x, e_y, _ = turn_about_z(turn_back, (error * e_x, error * e_y, 0.0))
            v_command = (
                v_x + _TILT_RESPONSE_S * (a_x + e_x),
                v_y + _TILT_RESPONSE_S * (a_y + e_y),
                v_command[2],
            )
            v_estimated = (v_x, v_y, v_estimated[2])
        return AutopilotOutput(
            v_command_world=np.array(v_command),
            v_estimated_world=np.array(v_estimated),
            yaw_rate=demand.yaw_rate,
            armed=self.armed,
            mode=self._mode,
            horizontal_controlled=demand.horizontal,
        )
