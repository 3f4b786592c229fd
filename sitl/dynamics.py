"""Quadrotors under PX4's velocity control, batched over vehicles, in fixed steps of 5 ms.

The chain is PX4's: a delayed velocity setpoint, a PI velocity loop that asks for an acceleration, an
attitude loop that tilts the thrust towards it, body rates and thrust that lag. The defaults reproduce
the step response measured on PX4 1.18 (0 to 1 m/s: 10 % after 0.31 s, 50 % after 0.6 s, 63 % after
0.75 s, 0.95 m/s after 1.3 s, 3 % overshoot). World frame: z up. Body frame: forward, left, up.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.settings import Settings
from sitl import dynamics_kernels as kernels
from sitl.kinematics import Kinematics

STEP_S = 0.005
STEP_NS = 5_000_000
GRAVITY = 9.81

BoolArray = NDArray[np.bool_]


class QuadrotorSettings(Settings):
    """Response of one type of vehicle."""

    command_delay_s: float = Field(default=0.06, ge=STEP_S, le=1.0)
    """From a setpoint's arrival to the velocity loop using it."""
    horizontal_gain_per_s: float = Field(default=1.7, gt=0.0, le=20.0)
    """Acceleration asked for per velocity error, horizontally."""
    horizontal_integral_per_s2: float = Field(default=0.6, ge=0.0, le=20.0)
    """Integral gain of the same loop."""
    vertical_gain_per_s: float = Field(default=4.0, gt=0.0, le=20.0)
    """Acceleration asked for per velocity error, vertically."""
    vertical_integral_per_s2: float = Field(default=2.0, ge=0.0, le=20.0)
    """Integral gain of the same loop."""
    integral_max_mps2: float = Field(default=4.0, ge=0.0, le=20.0)
    """Bound on each component of the integral's share."""
    horizontal_acceleration_max_mps2: float = Field(default=3.0, gt=0.0, le=30.0)
    """Bound on the horizontal acceleration asked for (MPC_ACC_HOR)."""
    up_acceleration_max_mps2: float = Field(default=4.0, gt=0.0, le=30.0)
    """Bound on the upward acceleration asked for (MPC_ACC_UP_MAX)."""
    down_acceleration_max_mps2: float = Field(default=3.0, gt=0.0, le=9.0)
    """Bound on the downward acceleration asked for (MPC_ACC_DOWN_MAX)."""
    jerk_max_mps3: float = Field(default=11.0, gt=0.0, le=1000.0)
    """Bound on the change of the acceleration asked for."""
    attitude_gain_per_s: float = Field(default=6.5, gt=0.0, le=50.0)
    """Body rate asked for per tilt error (MC_ROLL_P)."""
    tilt_rate_max_radps: float = Field(default=3.84, gt=0.0, le=50.0)
    """Bound on the rates that tilt the vehicle (MC_ROLLRATE_MAX, 220 deg/s)."""
    yaw_rate_max_radps: float = Field(default=1.0, gt=0.0, le=10.0)
    """Bound on the yaw rate."""
    rate_time_constant_s: float = Field(default=0.05, ge=STEP_S, le=1.0)
    """Lag of the body rates behind the rates asked for."""
    yaw_rate_time_constant_s: float = Field(default=0.2, ge=STEP_S, le=2.0)
    """The same about the yaw axis."""
    thrust_time_constant_s: float = Field(default=0.05, ge=STEP_S, le=1.0)
    """Lag of the motors."""
    thrust_max_mps2: float = Field(default=20.0, gt=GRAVITY, le=100.0)
    """Greatest thrust by mass."""
    thrust_idle_mps2: float = Field(default=1.0, ge=0.0, lt=GRAVITY)
    """Thrust by mass of armed motors on the ground, and the least in the air."""
    drag_per_s: float = Field(default=0.3, ge=0.0, le=5.0)
    """Deceleration per speed through the air."""
    friction_mps2: float = Field(default=5.0, ge=0.0, le=50.0)
    """Horizontal deceleration while sliding on the ground."""
    ground_height_m: float = Field(default=0.0, ge=-1000.0, le=1000.0)
    """z of the ground the vehicle stands on."""
    standing_height_m: float = Field(default=0.1, ge=0.0, le=5.0)
    """Height of the body's origin above the ground when landed."""

    @property
    def delay_steps(self) -> int:
        """Return the number of whole steps a command waits."""
        return max(1, round(self.command_delay_s / STEP_S))

    def packed(self) -> FloatArray:
        """Return the numbers in the order of the kernel's parameters."""
        return _packed(self)


@lru_cache(maxsize=64)
def _packed(settings: QuadrotorSettings) -> FloatArray:
    parameters = np.array(
        [
            STEP_S,
            GRAVITY,
            settings.horizontal_gain_per_s,
            settings.horizontal_integral_per_s2,
            settings.vertical_gain_per_s,
            settings.vertical_integral_per_s2,
            settings.integral_max_mps2,
            settings.horizontal_acceleration_max_mps2,
            settings.up_acceleration_max_mps2,
            settings.down_acceleration_max_mps2,
            settings.jerk_max_mps3,
            settings.attitude_gain_per_s,
            settings.tilt_rate_max_radps,
            settings.yaw_rate_max_radps,
            settings.rate_time_constant_s,
            settings.yaw_rate_time_constant_s,
            settings.thrust_time_constant_s,
            settings.thrust_max_mps2,
            settings.thrust_idle_mps2,
            settings.drag_per_s,
            settings.friction_mps2,
            settings.ground_height_m + settings.standing_height_m,
        ]
    )
    assert len(parameters) == kernels.N_PARAMETERS
    return parameters


@dataclass(frozen=True, slots=True, eq=False)
class QuadrotorCommand:
    """What the autopilot is to do, for n vehicles.

    Attributes:
        v_world: (n, 3) velocity setpoint, m/s.
        yaw_rate: (n,) rad/s, positive counter-clockwise seen from above.
        armed: (n,) motors allowed to turn.
    """

    v_world: FloatArray
    yaw_rate: FloatArray
    armed: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class QuadrotorState:
    """Motion and controller memory of n vehicles.

    Attributes:
        motion: (n, 19) see `sitl.dynamics_kernels`; the properties below name its columns.
        memory: (n, 6) acceleration asked for and the integral's share of it, m/s^2.
        pending: (n, delay, 4) velocity setpoints and yaw rates on their way, oldest first.
    """

    motion: FloatArray
    memory: FloatArray
    pending: FloatArray

    @property
    def p_world(self) -> FloatArray:
        """Positions (n, 3), m."""
        return self.motion[:, kernels.P : kernels.P + 3]

    @property
    def v_world(self) -> FloatArray:
        """Velocities (n, 3), m/s."""
        return self.motion[:, kernels.V : kernels.V + 3]

    @property
    def q_world_body(self) -> FloatArray:
        """Attitudes (n, 4)."""
        return self.motion[:, kernels.Q : kernels.Q + 4]

    @property
    def omega_body(self) -> FloatArray:
        """Body rates (n, 3), rad/s."""
        return self.motion[:, kernels.OMEGA : kernels.OMEGA + 3]

    @property
    def accel_world(self) -> FloatArray:
        """Mean accelerations of the last step (n, 3), m/s^2."""
        return self.motion[:, kernels.ACCEL : kernels.ACCEL + 3]

    @property
    def accel_setpoint_world(self) -> FloatArray:
        """Accelerations asked for (n, 3), m/s^2."""
        return self.memory[:, kernels.ACCEL_SETPOINT : kernels.ACCEL_SETPOINT + 3]

    @property
    def thrust(self) -> FloatArray:
        """Thrust along body z by mass (n,), m/s^2; 0 with stopped motors."""
        return self.motion[:, kernels.THRUST]

    @property
    def on_ground(self) -> BoolArray:
        """Which vehicles stand on the ground (n,)."""
        return self.motion[:, kernels.ON_GROUND] > 0.5

    @property
    def touchdown_speed(self) -> FloatArray:
        """Speed at the last touchdown (n,), m/s; 0 before the first."""
        return self.motion[:, kernels.TOUCHDOWN]

    def kinematics(self, vehicle: int) -> Kinematics:
        """Return the motion of one vehicle."""
        return Kinematics(
            p_world=self.p_world[vehicle],
            v_world=self.v_world[vehicle],
            q_world_body=self.q_world_body[vehicle],
            omega_body=self.omega_body[vehicle],
        )


def at_rest(p_world: FloatArray, yaw: FloatArray, *, settings: QuadrotorSettings) -> QuadrotorState:
    """Return n level, motionless vehicles.

    Args:
        p_world: (n, 3) positions, m; a vehicle at or below standing height is put on the ground, one
            above it hovers (arm it in the first step, or it falls).
        yaw: (n,) headings, rad.
        settings: the vehicles' type.
    """
    n = len(p_world)
    floor = settings.ground_height_m + settings.standing_height_m
    motion = np.zeros((n, kernels.MOTION_WIDTH))
    on_ground = np.asarray(p_world)[:, 2] <= floor
    motion[:, kernels.P : kernels.P + 3] = p_world
    motion[:, kernels.P + 2] = np.maximum(motion[:, kernels.P + 2], floor)
    motion[:, kernels.Q : kernels.Q + 4] = rotation.from_yaw(yaw)
    motion[:, kernels.THRUST] = np.where(on_ground, 0.0, GRAVITY)
    motion[:, kernels.ON_GROUND] = on_ground
    return QuadrotorState(motion, np.zeros((n, kernels.MEMORY_WIDTH)), np.zeros((n, settings.delay_steps, 4)))


def step(
    state: QuadrotorState,
    command: QuadrotorCommand,
    v_estimated_world: FloatArray,
    wind_world: FloatArray,
    *,
    settings: QuadrotorSettings,
) -> QuadrotorState:
    """Return the state 5 ms later.

    Args:
        state: n vehicles.
        command: their setpoints, taken up after the command delay; arming acts at once.
        v_estimated_world: (n, 3) velocities the autopilots believe to have, in the axes of the command;
            whatever they err by becomes real drift.
        wind_world: (n, 3) velocity of the air, m/s.
        settings: the vehicles' type.
    """
    n = len(state.motion)
    setpoint = np.empty((n, 5))
    setpoint[:, :4] = state.pending[:, 0]
    setpoint[:, 4] = command.armed
    pending = np.empty_like(state.pending)
    pending[:, :-1] = state.pending[:, 1:]
    pending[:, -1, :3] = command.v_world
    pending[:, -1, 3] = command.yaw_rate
    motion, memory = state.motion.copy(), state.memory.copy()
    kernels.advance(
        motion,
        memory,
        setpoint,
        np.ascontiguousarray(v_estimated_world, dtype=np.float64),
        np.ascontiguousarray(wind_world, dtype=np.float64),
        settings.packed(),
    )
    return QuadrotorState(motion, memory, pending)
