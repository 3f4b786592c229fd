"""The terms of the reward of one follower, without their weights.

Everything but the grid and who is perceived is the truth. Scalar arithmetic only, in the common subset of
compilers for processors and graphics cards.

Source: the reward function of the paper on communication-free collective navigation; terms from `LOSS` on are
our own.
"""

import math

from companion.compiled import portable, portable_inlined
from companion.messages import FloatArray
from sitl.abstract.sight_kernels import up_of, yaw_of
from sitl.training import reward_layout_kernels as place

_STILL_MPS = 0.05
_MEAN, _SUM = 0, 1


@portable(
    "void(int64, float64[:,::1], float64, float64, int64, float64[:,::1], float64[:,:,::1], float64[::1],"
    " float64[::1])"
)
def reward_terms(
    i: int,
    states: FloatArray,
    room: float,
    ground: float,
    perceived: int,
    ranges: FloatArray,
    directions: FloatArray,
    numbers: FloatArray,
    terms: FloatArray,
) -> None:
    """Write the terms that depend on where everybody is; the others stay as they are.

    Args:
        i: whose reward.
        states: (n, 10) position, velocity, attitude of all, world; 0 is the leader.
        room: distance of i to the nearest surface, m.
        ground: height of the ground, m.
        perceived: how many others i perceives.
        ranges: (72, 12) the obstacle grid of i, m, infinite where nothing returns.
        directions: (72, 12, 3) unit vector of each cell in the heading frame.
        numbers: see `reward_layout_kernels`.
        terms: (15,) out.
    """
    n = states.shape[0]
    radius = numbers[place.RADIUS]
    px, py, pz = states[i, 0], states[i, 1], states[i, 2]
    vx, vy, vz = states[i, 3], states[i, 4], states[i, 5]
    cx, cy, cz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    reach, crowded = numbers[place.SEPARATION_REACH], 0.0
    for j in range(n):
        cx, cy, cz = cx + states[j, 0], cy + states[j, 1], cz + states[j, 2]
        mx, my, mz = mx + states[j, 3], my + states[j, 4], mz + states[j, 5]
        if j != i:
            x, y, z = states[j, 0] - px, states[j, 1] - py, states[j, 2] - pz
            distance = math.sqrt(x * x + y * y + z * z)
            if distance < reach:
                crowded += (reach - distance) / (reach - 2.0 * radius)
    terms[place.SEPARATION] = -crowded
    x, y, z = cx / n - px, cy / n - py, cz / n - pz
    off = math.sqrt(x * x + y * y + z * z)
    floor = numbers[place.COHESION_FLOOR]
    terms[place.COHESION] = -min(max(off - numbers[place.COHESION_REACH], 0.0), floor)
    terms[place.SPREAD] = -min(max(off - numbers[place.SPREAD_REACH], 0.0), floor)
    x, y, z = states[0, 0] - px, states[0, 1] - py, states[0, 2] - pz
    away = math.sqrt(x * x + y * y + z * z)
    terms[place.LEASHED] = -min(max(away - numbers[place.LEASH], 0.0), floor)

    reach = numbers[place.PROXIMITY_REACH]
    near = max(reach - room, 0.0) / (reach - radius)
    terms[place.PROXIMITY] = -(near * near * near * near)
    terms[place.DIRECTION] = _towards_obstacles(states, i, ranges, directions, numbers)

    rise = (pz - states[0, 2]) / numbers[place.ALTITUDE_SCALE]
    terms[place.ALTITUDE] = math.exp(-rise * rise)
    _, _, upright = up_of(states[i, 6:10])
    lean = (upright - 1.0) / numbers[place.ATTITUDE_SCALE]
    terms[place.ATTITUDE] = math.exp(-lean * lean)

    enough = min(float(n - 1), numbers[place.MOST_VISIBLE])
    terms[place.VISIBILITY] = min(perceived / enough, 1.0)
    terms[place.RECOVERY] = -abs(pz - ground - numbers[place.RECOVERY_HEIGHT]) if perceived == 0 else 0.0

    speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    mean_speed = math.sqrt(mx * mx + my * my + mz * mz)
    terms[place.ALIGNMENT] = 0.0
    if speed >= _STILL_MPS and mean_speed >= _STILL_MPS * n:
        # Below zero, so that nobody is paid for moving: whoever rests is out of AL, too.
        terms[place.ALIGNMENT] = (vx * mx + vy * my + vz * mz) / (speed * mean_speed) - 1.0


@portable_inlined
def _towards_obstacles(
    states: FloatArray, i: int, ranges: FloatArray, directions: FloatArray, numbers: FloatArray
) -> float:
    """Return the paper's direction term: how fast i flies at what is in the cone about its velocity."""
    vx, vy, vz = states[i, 3], states[i, 4], states[i, 5]
    speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    if speed <= _STILL_MPS:
        return 0.0
    yaw = yaw_of(states[i, 6:10])
    cosine, sine = math.cos(yaw), math.sin(yaw)
    ex, ey, ez = (cosine * vx + sine * vy) / speed, (cosine * vy - sine * vx) / speed, vz / speed
    reach, least = numbers[place.PROXIMITY_REACH], numbers[place.DIRECTION_COSINE]
    # No cell of a column whose azimuth is farther off than this lies in the cone: the level part of a cell's
    # direction is never longer than one, and that of the lowest cell is as long in all columns.
    level = directions[0, 0, 0] * directions[0, 0, 0] + directions[0, 0, 1] * directions[0, 0, 1]
    barely = level * (least * least * (1.0 - 1e-9) - ez * ez)
    columns, elevations = ranges.shape
    total, cells = 0.0, 0
    for column in range(columns):
        across = max(ex * directions[column, 0, 0] + ey * directions[column, 0, 1], 0.0)
        if across * across < barely:
            continue
        for row in range(elevations):
            along = (
                ex * directions[column, row, 0] + ey * directions[column, row, 1]
                + ez * directions[column, row, 2]
            )  # fmt: skip
            if along > least:
                cells += 1
                total += max(reach - ranges[column, row], 0.0)
    mode = int(numbers[place.DIRECTION_MODE])
    if mode == _MEAN:
        return -speed * total / max(cells, 1)
    return -speed * total if mode == _SUM else -speed * total / (columns * elevations)
