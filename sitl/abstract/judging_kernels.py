"""How a trial goes, sample by sample: sums for the metrics, and whether it is over.

The formulas are those of `companion.logs.metrics`.
"""

import math

import numpy as np

from companion.compiled import portable, portable_inlined
from companion.messages import FloatArray
from sitl.abstract import layout_kernels as place
from sitl.abstract.leader_kernels import FINISHED, PHASE
from sitl.abstract.motion_kernels import closest_approach

# Places in the sums: how often each was sampled follows it.
FLOCK_RADIUS, SEPARATION, ALIGNMENT, ALIGNED, OBSTACLE, NEAR_OBSTACLE, SAMPLES = range(7)
N_SUMS = 7

# How a trial ended, in the order of `ENDS`.
ENDS = (
    "flying", "success", "uav_uav", "leader_follower", "obstacle", "altitude", "leader_lost", "scattered",
    "timeout",
)  # fmt: skip
(
    FLYING, SUCCESS, UAV_UAV, LEADER_FOLLOWER, OBSTACLE_HIT, ALTITUDE, LEADER_LOST, SCATTERED, TIMEOUT,
) = range(9)  # fmt: skip

_STILL_MPS = 0.05
_NO_DIRECTION = 1e-9
_PLENTY = 1.01


@portable("void(float64[:,::1], float64[::1], float64, float64[::1])")
def add_sample(states: FloatArray, rooms: FloatArray, cap: float, sums: FloatArray) -> None:
    """Add one sample to the sums of the metrics.

    Args:
        states: (n, 10) position, velocity, attitude of all, world.
        rooms: (n,) distance of each to the nearest surface, m.
        cap: a sample without a surface nearer than this does not count for the distance to obstacles, m.
        sums: (7,) changed in place.
    """
    n = states.shape[0]
    cx, cy, cz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        cx, cy, cz = cx + states[i, 0], cy + states[i, 1], cz + states[i, 2]
        mx, my, mz = mx + states[i, 3], my + states[i, 4], mz + states[i, 5]
    cx, cy, cz, mx, my, mz = cx / n, cy / n, cz / n, mx / n, my / n, mz / n
    mean_speed = math.sqrt(mx * mx + my * my + mz * mz)
    radius, separation, nearest = 0.0, math.inf, math.inf
    cosines, moving = 0.0, 0
    for i in range(n):
        x, y, z = states[i, 0] - cx, states[i, 1] - cy, states[i, 2] - cz
        radius = max(radius, x * x + y * y + z * z)
        nearest = min(nearest, rooms[i])
        for j in range(i):
            x, y, z = states[i, 0] - states[j, 0], states[i, 1] - states[j, 1], states[i, 2] - states[j, 2]
            separation = min(separation, x * x + y * y + z * z)
        x, y, z = states[i, 3], states[i, 4], states[i, 5]
        speed = math.sqrt(x * x + y * y + z * z)
        if speed >= _STILL_MPS and mean_speed > _NO_DIRECTION:
            cosines += (x * mx + y * my + z * mz) / (speed * mean_speed)
            moving += 1
    sums[FLOCK_RADIUS] += math.sqrt(radius)
    sums[SEPARATION] += math.sqrt(separation)
    sums[SAMPLES] += 1.0
    if moving > 0:
        sums[ALIGNMENT] += cosines / moving
        sums[ALIGNED] += 1.0
    if nearest < cap:
        sums[OBSTACLE] += nearest
        sums[NEAR_OBSTACLE] += 1.0


@portable_inlined
def _stay_apart(before: FloatArray, states: FloatArray, i: int, j: int, radius: float) -> bool:
    """Whether two are farther apart than both can have flown towards each other; cheap, and rarely False."""
    apart, moved = 0.0, 0.0
    for axis in range(3):
        gap = before[j, axis] - before[i, axis]
        change = states[j, axis] - states[i, axis] - gap
        apart += gap * gap
        moved += change * change
    # (a + b)^2 is at most 2 (a^2 + b^2).
    return bool(apart > 2.0 * (4.0 * radius * radius + moved) * _PLENTY)


@portable(
    "int64(float64, float64[:,::1], float64[:,::1], uint8[::1], float64, float64[::1], float64[::1],"
    " float64[::1], int64[::1])"
)
def judge(
    t: float,
    before: FloatArray,
    states: FloatArray,
    touching: np.ndarray[tuple[int], np.dtype[np.uint8]],
    leader_unseen_s: float,
    goal: FloatArray,
    leader: FloatArray,
    parameters: FloatArray,
    concerned: np.ndarray[tuple[int], np.dtype[np.int64]],
) -> int:
    """Return how the trial ends now, `FLYING` if it goes on.

    Args:
        t: time since the start, s.
        before: (n, 10) states one step ago.
        states: (n, 10) states now.
        touching: (n,) who touches an obstacle.
        leader_unseen_s: how long no follower has perceived the leader.
        goal: (3,) the last waypoint, world, m.
        leader: the leader's memory.
        parameters: see `sitl.abstract.layout_kernels`.
        concerned: (2,) out, numbers of the vehicles by which it ends, -1 if fewer.
    """
    n = states.shape[0]
    concerned[0] = concerned[1] = -1
    for i in range(n):
        for j in range(i):
            if _stay_apart(before, states, i, j, parameters[place.VEHICLE_RADIUS]):
                continue
            gap = closest_approach(before[i, 0:3], states[i, 0:3], before[j, 0:3], states[j, 0:3])
            if gap < 2.0 * parameters[place.VEHICLE_RADIUS]:
                concerned[0], concerned[1] = j, i
                return LEADER_FOLLOWER if j == 0 else UAV_UAV
    for i in range(n):
        if touching[i]:
            concerned[0] = i
            return OBSTACLE_HIT
    for i in range(n):
        height = states[i, 2] - parameters[place.GROUND]
        if height < parameters[place.LOWEST_ALTITUDE] or height > parameters[place.HIGHEST_ALTITUDE]:
            concerned[0] = i
            return ALTITUDE
    if leader_unseen_s > parameters[place.LEADER_UNSEEN] + 1e-9:
        concerned[0] = 0
        return LEADER_LOST
    if leader[PHASE] == FINISHED:
        x, y, z = states[0, 0] - goal[0], states[0, 1] - goal[1], states[0, 2] - goal[2]
        if math.sqrt(x * x + y * y + z * z) > parameters[place.GOAL_TOLERANCE]:
            concerned[0] = 0
            return TIMEOUT
        for i in range(1, n):
            x, y, z = states[i, 0] - states[0, 0], states[i, 1] - states[0, 1], states[i, 2] - states[0, 2]
            if math.sqrt(x * x + y * y + z * z) > parameters[place.GATHERED]:
                concerned[0] = i
                return SCATTERED
        return SUCCESS
    if t >= parameters[place.TIMEOUT]:
        concerned[0] = 0
        return TIMEOUT
    return FLYING
