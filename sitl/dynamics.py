"""Quadrotors under PX4's velocity control, batched over vehicles, in fixed steps of 5 ms.

The chain is PX4's: a delayed velocity setpoint, a PI velocity loop that asks for an acceleration, an
attitude loop that tilts the thrust towards it, body rates and thrust that lag. The defaults reproduce
the step response measured on PX4 1.18 (0 to 1 m/s: 10 % after 0.31 s, 50 % after 0.6 s, 63 % after
0.75 s, 0.95 m/s after 1.3 s, 3 % overshoot). World frame: z up. Body frame: forward, left, up.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.settings import Settings
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
        p_world: (n, 3) m.
        v_world: (n, 3) m/s.
        q_world_body: (n, 4).
        omega_body: (n, 3) rad/s.
        accel_world: (n, 3) mean acceleration of the last step, m/s^2.
        thrust: (n,) along body z by mass, m/s^2; 0 with stopped motors.
        accel_setpoint_world: (n, 3) acceleration asked for, m/s^2.
        accel_integral_world: (n, 3) the integral's share of it, m/s^2.
        pending: (n, delay, 4) velocity setpoints and yaw rates on their way, oldest first.
        on_ground: (n,) standing on the ground.
        touchdown_speed: (n,) speed at the last touchdown, m/s; 0 before the first.
    """

    p_world: FloatArray
    v_world: FloatArray
    q_world_body: FloatArray
    omega_body: FloatArray
    accel_world: FloatArray
    thrust: FloatArray
    accel_setpoint_world: FloatArray
    accel_integral_world: FloatArray
    pending: FloatArray
    on_ground: BoolArray
    touchdown_speed: FloatArray

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
    position = np.array(p_world, dtype=np.float64)
    on_ground = position[:, 2] <= floor
    position[:, 2] = np.maximum(position[:, 2], floor)
    return QuadrotorState(
        p_world=position,
        v_world=np.zeros((n, 3)),
        q_world_body=rotation.from_yaw(yaw),
        omega_body=np.zeros((n, 3)),
        accel_world=np.zeros((n, 3)),
        thrust=np.where(on_ground, 0.0, GRAVITY),
        accel_setpoint_world=np.zeros((n, 3)),
        accel_integral_world=np.zeros((n, 3)),
        pending=np.zeros((n, settings.delay_steps, 4)),
        on_ground=on_ground,
        touchdown_speed=np.zeros(n),
    )


def _norm(vectors: FloatArray) -> FloatArray:
    """Return lengths (n, 1) by elementwise operations, so that batching changes no bit."""
    total = vectors[:, :1] ** 2
    for axis in range(1, vectors.shape[1]):
        total = total + vectors[:, axis : axis + 1] ** 2
    return np.asarray(np.sqrt(total))


def _limited(vectors: FloatArray, length: float) -> FloatArray:
    """Return vectors (n, k) shortened to at most `length`."""
    return vectors * np.minimum(1.0, length / np.maximum(_norm(vectors), 1e-12))


def _accelerations(
    state: QuadrotorState, error_world: FloatArray, flying: BoolArray, settings: QuadrotorSettings
) -> tuple[FloatArray, FloatArray]:
    """Return the acceleration asked for and its integral share (n, 3): PI, bounds, jerk limit."""
    gain = np.array([settings.horizontal_gain_per_s] * 2 + [settings.vertical_gain_per_s])
    integral_gain = np.array([settings.horizontal_integral_per_s2] * 2 + [settings.vertical_integral_per_s2])
    wanted = gain * error_world + state.accel_integral_world
    bounded = np.concatenate(
        [
            _limited(wanted[:, :2], settings.horizontal_acceleration_max_mps2),
            np.clip(wanted[:, 2:], -settings.down_acceleration_max_mps2, settings.up_acceleration_max_mps2),
        ],
        axis=1,
    )
    winding_up = (wanted != bounded) & (error_world * state.accel_integral_world >= 0.0)
    integral = state.accel_integral_world + np.where(winding_up, 0.0, integral_gain * STEP_S * error_world)
    integral = np.clip(integral, -settings.integral_max_mps2, settings.integral_max_mps2)
    change = _limited(bounded - state.accel_setpoint_world, settings.jerk_max_mps3 * STEP_S)
    return (
        np.where(flying[:, None], state.accel_setpoint_world + change, 0.0),
        np.where(flying[:, None], integral, 0.0),
    )


def _rates(
    state: QuadrotorState,
    R_world_body: FloatArray,
    up_world: FloatArray,
    yaw_rate: FloatArray,
    settings: QuadrotorSettings,
) -> FloatArray:
    """Return the next body rates (n, 3): turn body z towards `up_world`, and yaw as asked."""
    up_body = (
        R_world_body[:, 0] * up_world[:, :1]
        + R_world_body[:, 1] * up_world[:, 1:2]
        + R_world_body[:, 2] * up_world[:, 2:]
    )
    tilt_axis = np.stack([-up_body[:, 1], up_body[:, 0]], axis=1)
    sine = _norm(tilt_axis)
    angle = np.arctan2(sine, up_body[:, 2:])
    error = tilt_axis * (angle / np.maximum(sine, 1e-12))
    tilt_rate = _limited(settings.attitude_gain_per_s * error, settings.tilt_rate_max_radps)
    yaw = np.clip(yaw_rate, -settings.yaw_rate_max_radps, settings.yaw_rate_max_radps)
    wanted = np.concatenate([tilt_rate, yaw[:, None]], axis=1)
    share = STEP_S / np.array([settings.rate_time_constant_s] * 2 + [settings.yaw_rate_time_constant_s])
    return state.omega_body + share * (wanted - state.omega_body)


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
    setpoint = state.pending[:, 0]
    arriving = np.concatenate([command.v_world, command.yaw_rate[:, None]], axis=1)
    pending = np.concatenate([state.pending[:, 1:], arriving[:, None]], axis=1)

    flying = command.armed & (~state.on_ground | (setpoint[:, 2] > 0.0))
    accel_setpoint, integral = _accelerations(state, setpoint[:, :3] - v_estimated_world, flying, settings)
    force_world = accel_setpoint + np.array([0.0, 0.0, GRAVITY])
    wanted_thrust = _norm(force_world)
    omega = _rates(
        state,
        rotation.to_matrix(state.q_world_body),
        force_world / wanted_thrust,
        np.where(flying, setpoint[:, 3], 0.0),
        settings,
    )
    limited_thrust = np.clip(wanted_thrust[:, 0], settings.thrust_idle_mps2, settings.thrust_max_mps2)
    thrust_target = np.where(command.armed, np.where(flying, limited_thrust, settings.thrust_idle_mps2), 0.0)
    thrust = state.thrust + STEP_S / settings.thrust_time_constant_s * (thrust_target - state.thrust)

    turn_body = 0.5 * STEP_S * (state.omega_body + omega)
    q = rotation.normalize(rotation.multiply(state.q_world_body, rotation.exp(turn_body)))
    z_world = rotation.to_matrix(q)[:, :, 2]
    accel = thrust[:, None] * z_world - settings.drag_per_s * (state.v_world - wind_world)
    accel[:, 2] -= GRAVITY
    return _contact(
        state,
        QuadrotorState(
            p_world=state.p_world + STEP_S * (state.v_world + 0.5 * STEP_S * accel),
            v_world=state.v_world + STEP_S * accel,
            q_world_body=q,
            omega_body=omega,
            accel_world=accel,
            thrust=thrust,
            accel_setpoint_world=accel_setpoint,
            accel_integral_world=integral,
            pending=pending,
            on_ground=state.on_ground,
            touchdown_speed=state.touchdown_speed,
        ),
        settings,
    )


def _contact(before: QuadrotorState, free: QuadrotorState, settings: QuadrotorSettings) -> QuadrotorState:
    """Return the state with the ground's push: no vehicle sinks below its standing height."""
    floor = settings.ground_height_m + settings.standing_height_m
    held = (free.p_world[:, 2] <= floor) & (free.v_world[:, 2] <= 0.0)
    touching = held & ~before.on_ground
    sliding = before.v_world[:, :2]
    speed = _norm(sliding)
    slowed = sliding * np.maximum(0.0, 1.0 - settings.friction_mps2 * STEP_S / np.maximum(speed, 1e-12))
    v_held = np.concatenate([slowed, np.zeros_like(speed)], axis=1)
    v_world = np.where(held[:, None], v_held, free.v_world)
    p_world = before.p_world + 0.5 * STEP_S * (before.v_world + v_world)
    p_world[:, 2] = np.where(held, floor, p_world[:, 2])
    return QuadrotorState(
        p_world=p_world,
        v_world=v_world,
        q_world_body=free.q_world_body,
        omega_body=free.omega_body,
        accel_world=(v_world - before.v_world) / STEP_S,
        thrust=free.thrust,
        accel_setpoint_world=free.accel_setpoint_world,
        accel_integral_world=free.accel_integral_world,
        pending=free.pending,
        on_ground=held,
        touchdown_speed=np.where(touching, -before.v_world[:, 2], before.touchdown_speed),
    )
