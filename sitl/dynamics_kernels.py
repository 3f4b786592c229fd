"""One step of all quadrotors, vehicle by vehicle; `sitl.dynamics` says what it means.

Scalar arithmetic only, in the common subset of compilers for processors and graphics cards.
"""

import math

from companion.compiled import portable, portable_inlined
from companion.messages import FloatArray

# Places of the settings in the parameter array.
(
    STEP, GRAVITY, HORIZONTAL_GAIN, HORIZONTAL_INTEGRAL, VERTICAL_GAIN, VERTICAL_INTEGRAL, INTEGRAL_MAX,
    HORIZONTAL_MAX, UP_MAX, DOWN_MAX, JERK_MAX, ATTITUDE_GAIN, TILT_RATE_MAX, YAW_RATE_MAX, RATE_TIME,
    YAW_RATE_TIME, THRUST_TIME, THRUST_MAX, THRUST_IDLE, DRAG, FRICTION, FLOOR,
) = range(22)  # fmt: skip
N_PARAMETERS = 22

# Columns of the motion and of the controller's memory.
P, V, Q, OMEGA, ACCEL, THRUST, ON_GROUND, TOUCHDOWN = 0, 3, 6, 10, 13, 16, 17, 18
MOTION_WIDTH = 19
ACCEL_SETPOINT, ACCEL_INTEGRAL = 0, 3
MEMORY_WIDTH = 6


@portable_inlined
def _integral_after(
    integral: float, error: float, rate: float, saturated: bool, limit: float, dt: float
) -> float:
    """Return the integral's share after a step; it stops growing where the wish is out of bounds."""
    if not (saturated and error * integral >= 0.0):
        integral += rate * dt * error
    return min(max(integral, -limit), limit)


@portable_inlined
def advance_one(
    i: int,
    motion: FloatArray,
    memory: FloatArray,
    setpoint: FloatArray,
    vx: float,
    vy: float,
    vz: float,
    wind: FloatArray,
    parameters: FloatArray,
) -> None:
    """Advance vehicle i, which believes to fly at (vx, vy, vz), by one step; the arrays are `advance`'s."""
    dt = parameters[STEP]
    armed = setpoint[i, 4] > 0.5
    flying = armed and (motion[i, ON_GROUND] < 0.5 or setpoint[i, 2] > 0.0)

    # Velocity loop: PI, bounds, anti-windup, jerk limit.
    error_x, error_y, error_z = setpoint[i, 0] - vx, setpoint[i, 1] - vy, setpoint[i, 2] - vz
    wanted_x = parameters[HORIZONTAL_GAIN] * error_x + memory[i, ACCEL_INTEGRAL]
    wanted_y = parameters[HORIZONTAL_GAIN] * error_y + memory[i, ACCEL_INTEGRAL + 1]
    wanted_z = parameters[VERTICAL_GAIN] * error_z + memory[i, ACCEL_INTEGRAL + 2]
    x, y = wanted_x, wanted_y
    horizontal = math.sqrt(wanted_x * wanted_x + wanted_y * wanted_y)
    if horizontal > parameters[HORIZONTAL_MAX]:
        x *= parameters[HORIZONTAL_MAX] / horizontal
        y *= parameters[HORIZONTAL_MAX] / horizontal
    z = min(max(wanted_z, -parameters[DOWN_MAX]), parameters[UP_MAX])
    if flying:
        rate, limit = parameters[HORIZONTAL_INTEGRAL], parameters[INTEGRAL_MAX]
        memory[i, ACCEL_INTEGRAL] = _integral_after(
            memory[i, ACCEL_INTEGRAL], error_x, rate, wanted_x != x, limit, dt
        )
        memory[i, ACCEL_INTEGRAL + 1] = _integral_after(
            memory[i, ACCEL_INTEGRAL + 1], error_y, rate, wanted_y != y, limit, dt
        )
        memory[i, ACCEL_INTEGRAL + 2] = _integral_after(
            memory[i, ACCEL_INTEGRAL + 2], error_z, parameters[VERTICAL_INTEGRAL], wanted_z != z, limit, dt
        )
        x -= memory[i, ACCEL_SETPOINT]
        y -= memory[i, ACCEL_SETPOINT + 1]
        z -= memory[i, ACCEL_SETPOINT + 2]
        change = math.sqrt(x * x + y * y + z * z)
        share = min(1.0, parameters[JERK_MAX] * dt / max(change, 1e-12))
        memory[i, ACCEL_SETPOINT] += share * x
        memory[i, ACCEL_SETPOINT + 1] += share * y
        memory[i, ACCEL_SETPOINT + 2] += share * z
    else:
        for axis in range(3):
            memory[i, ACCEL_INTEGRAL + axis] = 0.0
            memory[i, ACCEL_SETPOINT + axis] = 0.0

    # Attitude loop: turn body z towards the force asked for, yaw as asked.
    fx, fy = memory[i, ACCEL_SETPOINT], memory[i, ACCEL_SETPOINT + 1]
    fz = memory[i, ACCEL_SETPOINT + 2] + parameters[GRAVITY]
    force = math.sqrt(fx * fx + fy * fy + fz * fz)
    w, x, y, z = motion[i, Q], motion[i, Q + 1], motion[i, Q + 2], motion[i, Q + 3]
    ux = (1.0 - 2.0 * (y * y + z * z)) * fx + 2.0 * (x * y + w * z) * fy + 2.0 * (x * z - w * y) * fz
    uy = 2.0 * (x * y - w * z) * fx + (1.0 - 2.0 * (x * x + z * z)) * fy + 2.0 * (y * z + w * x) * fz
    uz = 2.0 * (x * z + w * y) * fx + 2.0 * (y * z - w * x) * fy + (1.0 - 2.0 * (x * x + y * y)) * fz
    sine = math.sqrt(ux * ux + uy * uy)
    angle = math.atan2(sine, uz)
    tilt_rate = min(parameters[ATTITUDE_GAIN] * angle, parameters[TILT_RATE_MAX])
    scale = tilt_rate / max(sine, 1e-12)
    yaw_limit = parameters[YAW_RATE_MAX]
    yaw_rate = min(max(setpoint[i, 3], -yaw_limit), yaw_limit) if flying else 0.0
    rate_share = dt / parameters[RATE_TIME]
    omega_x = motion[i, OMEGA] + rate_share * (-uy * scale - motion[i, OMEGA])
    omega_y = motion[i, OMEGA + 1] + rate_share * (ux * scale - motion[i, OMEGA + 1])
    yaw_share = dt / parameters[YAW_RATE_TIME]
    omega_z = motion[i, OMEGA + 2] + yaw_share * (yaw_rate - motion[i, OMEGA + 2])

    # Motors.
    target = 0.0
    if armed:
        target = parameters[THRUST_IDLE]
        if flying:
            target = min(max(force, parameters[THRUST_IDLE]), parameters[THRUST_MAX])
    thrust = motion[i, THRUST]
    thrust += dt / parameters[THRUST_TIME] * (target - thrust)

    # Rotation by the mean rate of the step.
    tx = 0.25 * dt * (motion[i, OMEGA] + omega_x)
    ty = 0.25 * dt * (motion[i, OMEGA + 1] + omega_y)
    tz = 0.25 * dt * (motion[i, OMEGA + 2] + omega_z)
    half = math.sqrt(tx * tx + ty * ty + tz * tz)
    sinc = math.sin(half) / half if half > 1e-12 else 1.0
    ew, ex, ey, ez = math.cos(half), tx * sinc, ty * sinc, tz * sinc
    nw = w * ew - x * ex - y * ey - z * ez
    nx = w * ex + x * ew + y * ez - z * ey
    ny = w * ey - x * ez + y * ew + z * ex
    nz = w * ez + x * ey - y * ex + z * ew
    norm = math.copysign(math.sqrt(nw * nw + nx * nx + ny * ny + nz * nz), nw)
    w, x, y, z = nw / norm, nx / norm, ny / norm, nz / norm

    # Translation under thrust, drag and gravity.
    ax = thrust * 2.0 * (x * z + w * y) - parameters[DRAG] * (motion[i, V] - wind[i, 0])
    ay = thrust * 2.0 * (y * z - w * x) - parameters[DRAG] * (motion[i, V + 1] - wind[i, 1])
    az = thrust * (1.0 - 2.0 * (x * x + y * y)) - parameters[DRAG] * (motion[i, V + 2] - wind[i, 2])
    az -= parameters[GRAVITY]
    v_up = motion[i, V + 2] + dt * az
    height = motion[i, P + 2] + dt * (motion[i, V + 2] + 0.5 * dt * az)
    held = height <= parameters[FLOOR] and v_up <= 0.0
    if held:
        # The ground takes the vertical speed at once and the horizontal by friction.
        if motion[i, ON_GROUND] < 0.5:
            motion[i, TOUCHDOWN] = -motion[i, V + 2]
        speed = math.sqrt(motion[i, V] ** 2 + motion[i, V + 1] ** 2)
        kept = max(0.0, 1.0 - parameters[FRICTION] * dt / max(speed, 1e-12))
        ax = (kept - 1.0) * motion[i, V] / dt
        ay = (kept - 1.0) * motion[i, V + 1] / dt
        az = -motion[i, V + 2] / dt
    for axis in range(3):
        accel = ax if axis == 0 else (ay if axis == 1 else az)
        v_old = motion[i, V + axis]
        v_new = v_old + dt * accel
        motion[i, P + axis] += 0.5 * dt * (v_old + v_new)
        motion[i, V + axis] = v_new
        motion[i, ACCEL + axis] = accel
    motion[i, OMEGA], motion[i, OMEGA + 1], motion[i, OMEGA + 2] = omega_x, omega_y, omega_z
    if held:
        motion[i, P + 2] = parameters[FLOOR]
        motion[i, V + 2] = 0.0
    motion[i, Q], motion[i, Q + 1], motion[i, Q + 2], motion[i, Q + 3] = w, x, y, z
    motion[i, THRUST] = thrust
    motion[i, ON_GROUND] = 1.0 if held else 0.0


@portable(
    "void(float64[:,::1], float64[:,::1], float64[:,::1], float64[:,::1], float64[:,::1], float64[::1])"
)
def advance(
    motion: FloatArray,
    memory: FloatArray,
    setpoint: FloatArray,
    v_estimated: FloatArray,
    wind: FloatArray,
    parameters: FloatArray,
) -> None:
    """Advance vehicles in place by one step.

    Args:
        motion: (n, 19) position, velocity, attitude, rates, acceleration, thrust, on ground, touchdown speed.
        memory: (n, 6) acceleration asked for, and the integral's share of it.
        setpoint: (n, 5) velocity (3), yaw rate, armed.
        v_estimated: (n, 3) velocity the autopilot believes to have.
        wind: (n, 3) velocity of the air.
        parameters: (22,) in the order of the constants above.
    """
    for i in range(motion.shape[0]):
        advance_one(
            i, motion, memory, setpoint, v_estimated[i, 0], v_estimated[i, 1], v_estimated[i, 2], wind,
            parameters,
        )  # fmt: skip
