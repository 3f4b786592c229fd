"""The quadrotor's step in plain NumPy: slow, readable, the judge of the kernel."""

from dataclasses import dataclass

import numpy as np

from companion.geometry import rotation
from companion.messages import FloatArray
from sitl.dynamics import GRAVITY, STEP_S, BoolArray, QuadrotorCommand, QuadrotorSettings


@dataclass(frozen=True, slots=True, eq=False)
class OracleState:
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
    state: OracleState, error_world: FloatArray, flying: BoolArray, settings: QuadrotorSettings
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
    state: OracleState,
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
    state: OracleState,
    command: QuadrotorCommand,
    v_estimated_world: FloatArray,
    wind_world: FloatArray,
    *,
    settings: QuadrotorSettings,
) -> OracleState:
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
        OracleState(
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


def _contact(before: OracleState, free: OracleState, settings: QuadrotorSettings) -> OracleState:
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
    return OracleState(
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
