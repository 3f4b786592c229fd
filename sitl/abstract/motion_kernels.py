"""How vehicles move in one control step, and what they touch on the way.

Scalar arithmetic only, in the common subset of compilers for processors and graphics cards.
"""

import math

import numpy as np

from companion.compiled import portable, portable_inlined
from companion.messages import FloatArray
from sitl.abstract import layout_kernels as place
from sitl.abstract.grid_kernels import IndexArray
from sitl.abstract.random_kernels import normal_pair, stream, uniform
from sitl.dynamics_kernels import P, Q, V, advance_one
from sitl.worlds.clearance_kernels import distance_to_primitive

_WIND_STREAM, _LAG_STREAM = 3, 4
_GRAVITY = 9.81
_CONTACT_TOLERANCE_M = 1e-3
_PAIR_PARTS = 1e-12


@portable_inlined
def _blow(seed: np.uint64, step: int, i: int, parameters: FloatArray, gusts: FloatArray) -> None:
    """Move the gust at vehicle i on by one control step; it begins in its stationary distribution."""
    dt = parameters[place.CONTROL_STEP]
    chance = stream(seed, step, i, _WIND_STREAM)
    a, b = normal_pair(chance, 0)
    c, _ = normal_pair(chance, 1)
    kept = math.exp(-dt / parameters[place.GUST_TIME]) if step > 0 else 0.0
    fresh = parameters[place.GUST] * math.sqrt(1.0 - kept * kept)
    gusts[i, 0] = kept * gusts[i, 0] + fresh * a
    gusts[i, 1] = kept * gusts[i, 1] + fresh * b
    kept = math.exp(-dt / parameters[place.VERTICAL_GUST_TIME]) if step > 0 else 0.0
    gusts[i, 2] = kept * gusts[i, 2] + parameters[place.VERTICAL_GUST] * math.sqrt(1.0 - kept * kept) * c


@portable_inlined
def _lag(
    seed: np.uint64, step: int, i: int, commands: FloatArray, parameters: FloatArray, motion: FloatArray
) -> None:
    """Move a vehicle whose velocity follows the command with a first-order lag of its own."""
    dt = parameters[place.CONTROL_STEP]
    delay = int(parameters[place.COMMAND_DELAY] + parameters[place.SUBSTEPS] - 1.0) // int(
        parameters[place.SUBSTEPS]
    )
    row = max(step - delay, 0) % commands.shape[0]
    share = uniform(stream(seed, 0, i, _LAG_STREAM), 0)
    time = parameters[place.LAG_LEAST]
    time += share * (parameters[place.LAG_GREATEST] - parameters[place.LAG_LEAST])
    gain = -math.expm1(-dt / time) / dt
    ax = gain * (commands[row, i, 0] - motion[i, V])
    ay = gain * (commands[row, i, 1] - motion[i, V + 1])
    az = gain * (commands[row, i, 2] - motion[i, V + 2])
    size = math.sqrt(ax * ax + ay * ay + az * az)
    if size > parameters[place.LAG_ACCELERATION]:
        scale = parameters[place.LAG_ACCELERATION] / size
        ax, ay, az = ax * scale, ay * scale, az * scale
    for axis in range(3):
        a = ax if axis == 0 else (ay if axis == 1 else az)
        motion[i, P + axis] += dt * (motion[i, V + axis] + 0.5 * dt * a)
        motion[i, V + axis] += dt * a
    # Level flight tilts by what it accelerates; the heading stays.
    w, z = motion[i, Q], motion[i, Q + 3]
    yaw = 2.0 * math.atan2(z, w) if motion[i, Q + 1] == 0.0 and motion[i, Q + 2] == 0.0 else 0.0
    if motion[i, Q + 1] != 0.0 or motion[i, Q + 2] != 0.0:
        x, y = motion[i, Q + 1], motion[i, Q + 2]
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    _tilt(motion[i], ax, ay, az + _GRAVITY, yaw)


@portable_inlined
def _tilt(row: FloatArray, fx: float, fy: float, fz: float, yaw: float) -> None:
    """Write the attitude with a heading whose z axis points along a force, f_z > 0."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    forward, left = cosine * fx + sine * fy, cosine * fy - sine * fx
    pitch = math.atan2(forward, fz)
    roll = math.atan2(-left, math.sqrt(forward * forward + fz * fz))
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    row[Q] = cr * cp * cy + sr * sp * sy
    row[Q + 1] = sr * cp * cy - cr * sp * sy
    row[Q + 2] = cr * sp * cy + sr * cp * sy
    row[Q + 3] = cr * cp * sy - sr * sp * cy


@portable_inlined
def move_one(
    seed: np.uint64,
    step: int,
    i: int,
    commands: FloatArray,
    parameters: FloatArray,
    quadrotor: FloatArray,
    gusts: FloatArray,
    motion: FloatArray,
    loop: FloatArray,
    setpoint: FloatArray,
    wind: FloatArray,
) -> None:
    """Move vehicle i on by one control step; the arrays are those of `move`."""
    if parameters[place.QUADROTOR] < 0.5:
        _lag(seed, step, i, commands, parameters, motion)
        return
    _blow(seed, step, i, parameters, gusts)
    for axis in range(3):
        wind[i, axis] = parameters[place.WIND_X + axis] + gusts[i, axis]
    setpoint[i, 3] = 0.0
    setpoint[i, 4] = 1.0
    substeps = int(parameters[place.SUBSTEPS])
    delay = int(parameters[place.COMMAND_DELAY])
    for substep in range(substeps):
        # The command in force was given at least the delay ago; before the first, vehicles hover.
        late = max(delay - substep + substeps - 1, 0) // substeps
        for axis in range(3):
            setpoint[i, axis] = commands[(step - late) % commands.shape[0], i, axis] if step >= late else 0.0
        advance_one(
            i, motion, loop, setpoint, motion[i, V], motion[i, V + 1], motion[i, V + 2], wind, quadrotor
        )  # fmt: skip


@portable(
    "void(uint64, int64, float64[:,:,::1], float64[::1], float64[::1], float64[:,::1], float64[:,::1],"
    " float64[:,::1], float64[:,::1], float64[:,::1])"
)
def move(
    seed: np.uint64,
    step: int,
    commands: FloatArray,
    parameters: FloatArray,
    quadrotor: FloatArray,
    gusts: FloatArray,
    motion: FloatArray,
    loop: FloatArray,
    setpoint: FloatArray,
    wind: FloatArray,
) -> None:
    """Move all vehicles on by one control step.

    Args:
        seed: of the trial.
        step: number of the control step that begins.
        commands: (h, n, 3) recent velocities asked for, world, step k in row k mod h.
        parameters: see `sitl.abstract.layout_kernels`.
        quadrotor: (22,) parameters of `dynamics_kernels.advance`, for the length of a substep.
        gusts: (n, 3) changed in place.
        motion: (n, 19) changed in place.
        loop: (n, 6) memory of the velocity loop, changed in place.
        setpoint: (n, 5) scratch.
        wind: (n, 3) scratch.
    """
    for i in range(motion.shape[0]):
        move_one(seed, step, i, commands, parameters, quadrotor, gusts, motion, loop, setpoint, wind)


@portable("float64(int32[::1], float64[:,::1], float64[:,::1], int32[::1], int64, float64, float64, float64)")
def room_at(
    kinds: IndexArray,
    rows: FloatArray,
    discs: FloatArray,
    candidates: IndexArray,
    count: int,
    x: float,
    y: float,
    z: float,
) -> float:
    """Return the distance from a point to the nearest surface of the first `count` candidates, m."""
    best = math.inf
    for slot in range(count):
        k = candidates[slot]
        dx, dy, bound = discs[k, 0] - x, discs[k, 1] - y, discs[k, 2] + max(best, 0.0)
        if dx * dx + dy * dy <= bound * bound:
            best = min(best, distance_to_primitive(kinds[k], rows[k], x, y, z))
    return best


@portable(
    "boolean(int32[::1], float64[:,::1], float64[:,::1], int32[::1], int64, float64[::1], float64[::1],"
    " float64, float64)"
)
def touches(
    kinds: IndexArray,
    rows: FloatArray,
    discs: FloatArray,
    candidates: IndexArray,
    count: int,
    start: FloatArray,
    end: FloatArray,
    radius: float,
    room_at_end: float,
) -> bool:
    """Whether a ball that moves from start to end (3,) touches a candidate.

    Args:
        kinds: (m,) kind of each primitive.
        rows: (m, 8) its shape.
        discs: (m, 3) its enclosing vertical cylinder.
        candidates: primitives that may be near, the first `count` of them.
        count: how many.
        start: where it was, m.
        end: where it is, m.
        radius: of the ball, m.
        room_at_end: distance from the end to the nearest surface, m.
    """
    if room_at_end < radius:
        return True
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    # Distance changes by at most a metre a metre, so whoever ends this far off has touched nothing.
    travelled = length - (room_at_end - radius)
    while travelled > 0.0:
        share = travelled / length
        free = room_at(
            kinds, rows, discs, candidates, count,
            start[0] + share * dx, start[1] + share * dy, start[2] + share * dz,
        ) - radius  # fmt: skip
        if free < 0.0:
            return True
        travelled -= max(free, _CONTACT_TOLERANCE_M)
    return False


@portable("float64(float64[::1], float64[::1], float64[::1], float64[::1])")
def closest_approach(a_start: FloatArray, a_end: FloatArray, b_start: FloatArray, b_end: FloatArray) -> float:
    """Return the least distance of two points (3,) that move straight and evenly during a step, m."""
    x, y, z = b_start[0] - a_start[0], b_start[1] - a_start[1], b_start[2] - a_start[2]
    dx, dy, dz = b_end[0] - a_end[0] - x, b_end[1] - a_end[1] - y, b_end[2] - a_end[2] - z
    square = dx * dx + dy * dy + dz * dz
    share = 0.0
    if square > _PAIR_PARTS:
        share = min(max(-(x * dx + y * dy + z * dz) / square, 0.0), 1.0)
    x, y, z = x + share * dx, y + share * dy, z + share * dz
    return math.sqrt(x * x + y * y + z * z)
