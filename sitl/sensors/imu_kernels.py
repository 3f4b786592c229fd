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


@compiled(
    "void(float64, float64[:, ::1], float64[::1], float64[::1], float64[::1], float64[::1], float64[:, ::1])"
)
def blur_inertial(
    kept: float,
    errors: FloatArray,
    truth: FloatArray,
    vibration: FloatArray,
    deviates: FloatArray,
    wander: FloatArray,
    measured: FloatArray,
) -> None:
    """Turn what an ideal chip would measure into what this one does.

    Args:
        kept: share of the wandering bias that stays.
        errors: (5, 6) bias at power-on, deviation of the wandering bias, deviation of the noise, scale
            factors and range of each component.
        truth: (6,) of an ideal chip.
        vibration: (6,) that the motors add.
        deviates: (12,) standard normal: of the wandering bias, then of the noise.
        wander: (6,) in and out, wandering bias.
        measured: (2, 3) out, rate and specific force.
    """
    fresh = math.sqrt(1.0 - kept * kept)
    for i in range(6):
        wander[i] = kept * wander[i] + fresh * errors[1, i] * deviates[i]
        noise = errors[2, i] * deviates[6 + i]
        value = errors[3, i] * (truth[i] + vibration[i]) + (errors[0, i] + wander[i]) + noise
        measured[i // 3, i % 3] = min(max(value, -errors[4, i]), errors[4, i])


@compiled("void(float64, float64[::1], float64[::1], float64[:, ::1], float64[:, ::1])")
def turn_rotors(
    step_s: float, rotor_hz: FloatArray, turns: FloatArray, offsets: FloatArray, phases: FloatArray
) -> None:
    """Turn rotors for `step_s` at `rotor_hz` (r,); write the phases (r, 2) of their two tones, rad.

    Args:
        step_s: time, s.
        rotor_hz: (r,) turns per second.
        turns: (r,) in and out, 0 to 1.
        offsets: (r, 2) of the tones, in turns.
        phases: (r, 2) out.
    """
    for i in range(turns.shape[0]):
        turns[i] = (turns[i] + step_s * rotor_hz[i]) % 1.0
        phases[i, 0] = 2.0 * math.pi * (turns[i] + offsets[i, 0])
        phases[i, 1] = 2.0 * math.pi * (2.0 * turns[i] + offsets[i, 1])


@compiled(
    "void(float64, float64, float64[:, ::1], float64[:, ::1], float64[::1], float64[::1], float64[::1])"
)
def shake(
    level: float,
    harmonic_share: float,
    mixing: FloatArray,
    sines: FloatArray,
    rms: FloatArray,
    deviates: FloatArray,
    vibration: FloatArray,
) -> None:
    """Write the vibration (6,) of four rotors with two tones each.

    Args:
        level: thrust by that in hover.
        harmonic_share: share of the power in the tones.
        mixing: (6, 8) part of each tone in each component.
        sines: (4, 2) of the tones.
        rms: (6,) in hover.
        deviates: (6,) standard normal, of the broadband part.
        vibration: (6,) out.
    """
    tonal, broad = math.sqrt(harmonic_share), math.sqrt(1.0 - harmonic_share)
    for i in range(6):
        row = mixing[i]
        tones = (
            (row[0] * sines[0, 0] + row[1] * sines[0, 1]) + (row[2] * sines[1, 0] + row[3] * sines[1, 1])
        ) + ((row[4] * sines[2, 0] + row[5] * sines[2, 1]) + (row[6] * sines[3, 0] + row[7] * sines[3, 1]))
        vibration[i] = level * rms[i] * (tonal * tones + broad * deviates[i])
