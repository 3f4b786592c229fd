"""A point mass under the emulated autopilot, with external vision from its true motion."""

import math
from collections.abc import Callable

import numpy as np

from companion.geometry import rotation
from companion.messages import LandedState, VehicleMode
from sitl.autopilot import Autopilot, AutopilotOutput, AutopilotSettings
from sitl.autopilot_inputs import ExternalVision, OffboardSetpoint, VisionFrame
from sitl.autopilot_parameters import GNSS_DENIED, Parameters
from sitl.vehicle_truth import VehicleTruth

STEP_NS = 5_000_000
RESPONSE_S = 0.4


class Body:
    """A vehicle whose velocity follows the command with a first-order lag, on flat ground."""

    def __init__(self, yaw: float = 0.0) -> None:
        self.p = np.zeros(3)
        self.v = np.zeros(3)
        self.accel = np.zeros(3)
        self.yaw = yaw
        self.yaw_rate = 0.0

    def truth(self, t_ns: int) -> VehicleTruth:
        return VehicleTruth(
            t_ns=t_ns,
            p_world=self.p.copy(),
            v_world=self.v.copy(),
            q_world_body=rotation.from_yaw(self.yaw),
            omega_body=np.array([0.0, 0.0, self.yaw_rate]),
            accel_world=self.accel.copy(),
            on_ground=bool(self.p[2] <= 1e-9),
        )

    def move(self, output: AutopilotOutput, dt: float) -> None:
        error = output.v_command_world - output.v_estimated_world
        accel = error / RESPONSE_S if output.armed else np.array([0.0, 0.0, -9.81])
        before = self.v.copy()
        self.v = self.v + accel * dt
        if self.p[2] <= 0.0 and (self.v[2] <= 0.0 or output.v_command_world[2] <= 0.0):
            self.v = np.zeros(3)
        self.accel = (self.v - before) / dt
        self.p = self.p + 0.5 * (before + self.v) * dt
        self.p[2] = max(0.0, self.p[2])
        self.yaw_rate = output.yaw_rate if output.armed else 0.0
        self.yaw += self.yaw_rate * dt


class Rig:
    """Autopilot and body in lockstep; external vision at 30 Hz from a map turned against the world."""

    def __init__(
        self,
        overrides: dict[str, int | float] | None = None,
        *,
        gnss: bool = False,
        map_yaw: float = 0.0,
        seed: int = 1,
    ) -> None:
        base = {} if gnss else dict(GNSS_DENIED)
        self.parameters = Parameters({**base, **(overrides or {})})
        self.autopilot = Autopilot(AutopilotSettings(), self.parameters, np.random.default_rng(seed))
        self.body = Body()
        self.t_ns = 0
        self.map_yaw = map_yaw
        self.vision = not gnss
        self.vision_period_ns = 33_333_333
        self.vision_age_ns = 0
        self.change: Callable[[ExternalVision], ExternalVision | None] = lambda sample: sample
        self.setpoint: OffboardSetpoint | None = None
        self.setpoint_period_ns = 50_000_000
        self.output: AutopilotOutput | None = None
        self._next_vision_ns = 0
        self._next_setpoint_ns = 0
        self._delayed: list[tuple[int, ExternalVision]] = []

    def sample(self) -> ExternalVision:
        """External vision of the body now, in a map whose axes are turned by `map_yaw` from the world's."""
        back = rotation.from_yaw(-self.map_yaw)
        q = rotation.from_yaw(self.body.yaw - self.map_yaw)
        p, v = (
            rotation.rotate(back, self.body.p),
            rotation.rotate(rotation.from_yaw(-self.body.yaw), self.body.v),
        )
        return ExternalVision(
            t_ns=self.t_ns,
            frame=VisionFrame.ODOMETRY,
            p_local=(float(p[0]), float(p[1]), float(p[2])),
            v=(float(v[0]), float(v[1]), float(v[2])),
            v_in_body=True,
            q_local_body=(float(q[0]), float(q[1]), float(q[2]), float(q[3])),
            position_variance=(4e-4, 4e-4, 4e-4),
            velocity_variance=(2.5e-3, 2.5e-3, 2.5e-3),
            yaw_variance=1e-4,
            quality=100,
            reset_counter=0,
        )

    def run(self, seconds: float, until: Callable[[], bool] | None = None) -> bool:
        """Simulate; return whether `until` became true."""
        end_ns = self.t_ns + round(seconds * 1e9)
        while self.t_ns < end_ns:
            self.t_ns += STEP_NS
            self._feed()
            self.output = self.autopilot.step(self.t_ns, self.body.truth(self.t_ns))
            self.body.move(self.output, STEP_NS * 1e-9)
            if until is not None and until():
                return True
        return until is None

    def mode(self) -> VehicleMode:
        """The mode being flown."""
        return self.autopilot.mode

    def landed_state(self) -> LandedState:
        """What the land detector reports."""
        return self.autopilot.landed_state

    def aided(self) -> bool:
        """Whether something corrects the horizontal estimate."""
        return self.autopilot.estimator.aided

    def fly_offboard(self, v_local: tuple[float, float, float], yaw: float | None = None) -> None:
        """Stream a velocity from now on."""
        self.setpoint = OffboardSetpoint(None, v_local, False, yaw, None if yaw is not None else 0.0)

    def take_off(self) -> None:
        """Arm in Takeoff mode without GNSS and climb."""
        self.run(1.0)
        assert self.autopilot.request_mode(VehicleMode.TAKEOFF) == 0
        assert self.autopilot.request_arming(True) == 0
        assert self.run(20.0, lambda: self.autopilot.demand.done)
        self.run(3.0)

    def take_off_to_offboard(self, v_local: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """Take off, then hover in Offboard."""
        self.take_off()
        self.fly_offboard(v_local)
        self.run(0.1)
        assert self.autopilot.request_mode(VehicleMode.OFFBOARD) == 0
        self.run(1.0)

    def estimate_error(self) -> float:
        """Horizontal distance between the estimate and the truth in the map, metres."""
        p = rotation.rotate(rotation.from_yaw(-self.map_yaw), self.body.p)
        estimate = self.autopilot.estimator.p_local
        return math.hypot(estimate[0] - p[0], estimate[1] - p[1])

    def _feed(self) -> None:
        if self.vision and self.t_ns >= self._next_vision_ns:
            self._next_vision_ns = self.t_ns + self.vision_period_ns - STEP_NS // 2
            sample = self.change(self.sample())
            if sample is not None:
                self._delayed.append((self.t_ns + self.vision_age_ns, sample))
        while self._delayed and self._delayed[0][0] <= self.t_ns:
            self.autopilot.external_vision(self._delayed.pop(0)[1])
        if self.setpoint is not None and self.t_ns >= self._next_setpoint_ns:
            self._next_setpoint_ns = self.t_ns + self.setpoint_period_ns - STEP_NS // 2
            self.autopilot.offboard_setpoint(self.t_ns, self.setpoint)
