"""What an inertial chip feels during one simulation step."""

import math

from companion.compiled import compiled, inlined
from companion.messages import FloatArray

GRAVITY = 9.81


@inlined
def _multiply(
    aw: float, ax: float, ay: float, az: float, bw: float, bx: float, by: float, bz: float
) -> tuple[float, float, float, float]:
    """Return the product of two quaternions."""
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@inlined
def _rotate(
    w: float, x: float, y: float, z: float, vx: float, vy: float, vz: float
) -> tuple[float, float, float]:
    """Return a vector turned by a unit quaternion."""
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


@inlined
def _chip_velocity(
    v_world: FloatArray, q: FloatArray, omega: FloatArray, arm: FloatArray
) -> tuple[float, float, float]:
    """Return the velocity of a point at `arm` on a turning body, world frame."""
    rx, ry, rz = _rotate(
        q[0], q[1], q[2], q[3],
        omega[1] * arm[2] - omega[2] * arm[1],
        omega[2] * arm[0] - omega[0] * arm[2],
        omega[0] * arm[1] - omega[1] * arm[0],
    )  # fmt: skip
    return v_world[0] + rx, v_world[1] + ry, v_world[2] + rz


@compiled(
    "void(float64, float64[::1], float64[::1], float64[::1], float64[::1], float64[::1], float64[::1], "
    "float64[::1], float64[::1], float64[::1])"
)
def average_inertial(
    step_s: float,
    v_start: FloatArray,
    q_start: FloatArray,
    omega_start: FloatArray,
    v_end: FloatArray,
    q_end: FloatArray,
    omega_end: FloatArray,
    p_body_imu: FloatArray,
    q_body_imu: FloatArray,
    inertial: FloatArray,
) -> None:
    """Write the mean rate and specific force (6,) of one step in the chip's frame at mid-step."""
    w, x, y, z = _multiply(
        q_start[0], -q_start[1], -q_start[2], -q_start[3], q_end[0], q_end[1], q_end[2], q_end[3]
    )
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    angle = 2.0 * math.atan2(sine, w)
    scale = angle / sine if sine > 1e-12 else 2.0
    half = math.sin(0.25 * angle) / sine if sine > 1e-12 else 0.5
    mw, mx, my, mz = _multiply(
        q_start[0], q_start[1], q_start[2], q_start[3],
        math.cos(0.25 * angle), half * x, half * y, half * z,
    )  # fmt: skip
    sx, sy, sz = _chip_velocity(v_start, q_start, omega_start, p_body_imu)
    ex, ey, ez = _chip_velocity(v_end, q_end, omega_end, p_body_imu)
    fx, fy, fz = (ex - sx) / step_s, (ey - sy) / step_s, (ez - sz) / step_s + GRAVITY
    bx, by, bz = _rotate(mw, -mx, -my, -mz, fx, fy, fz)
    iw, ix, iy, iz = q_body_imu[0], -q_body_imu[1], -q_body_imu[2], -q_body_imu[3]
    inertial[3], inertial[4], inertial[5] = _rotate(iw, ix, iy, iz, bx, by, bz)
    rate = scale / step_s
    inertial[0], inertial[1], inertial[2] = _rotate(iw, ix, iy, iz, rate * x, rate * y, rate * z)
