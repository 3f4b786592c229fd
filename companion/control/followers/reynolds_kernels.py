"""The `reynolds_apf` law: cohesion, separation and alignment, and a potential field of obstacles.

Source: C. W. Reynolds, "Flocks, herds and schools", 1987, in the form of F. Schilling et al., "Learning
vision-based flight in drone swarms by imitation", 2019, eqs. 1 to 4; O. Khatib, "Real-time obstacle avoidance
for manipulators and mobile robots", 1986, eq. 18.
"""

import math

from companion.compiled import portable_inlined
from companion.control.followers.layout_kernels import (
    AZIMUTHS,
    EGO_DT,
    EGO_V,
    EGO_YAW,
    MAX_SPEED,
    PLAIN_COLUMNS,
    PLAIN_STATE,
    REYNOLDS_ALIGNMENT,
    REYNOLDS_BODY_RADIUS,
    REYNOLDS_COHESION,
    REYNOLDS_LOW_PASS,
    REYNOLDS_OBSTACLE,
    REYNOLDS_OBSTACLE_REACH,
    REYNOLDS_SEPARATION,
    ROW_P,
    ROW_PRESENT,
    ROW_V,
)
from companion.control.followers.sensing_kernels import direction_of, find_columns_up_to
from companion.messages import FloatArray

_HIGHEST_RAD = math.radians(20.0)
_SECTORS = 12
_LEAST_GAP_M = 0.05


@portable_inlined
def reynolds(
    ego: FloatArray,
    neighbours: FloatArray,
    ranges: FloatArray,
    memory: FloatArray,
    parameters: FloatArray,
    wish: FloatArray,
) -> None:
    """Write the horizontal velocity that `reynolds_apf` wants into `wish`, in the heading frame, m/s."""
    count, vx, vy = 0, 0.0, 0.0
    for row in range(neighbours.shape[0]):
        if neighbours[row, ROW_PRESENT] < 0.5:
            continue
        count += 1
        x, y = neighbours[row, ROW_P], neighbours[row, ROW_P + 1]
        square = max(x * x + y * y, _LEAST_GAP_M * _LEAST_GAP_M)
        pull = parameters[REYNOLDS_COHESION] - parameters[REYNOLDS_SEPARATION] / square
        vx += pull * x + parameters[REYNOLDS_ALIGNMENT] * (neighbours[row, ROW_V] + ego[EGO_V])
        vy += pull * y + parameters[REYNOLDS_ALIGNMENT] * (neighbours[row, ROW_V + 1] + ego[EGO_V + 1])
    if count > 0:
        vx, vy = vx / count, vy / count
    vx, vy = _smoothed(vx, vy, ego, memory, parameters)
    wish[0] = vx
    wish[1] = vy
    _avoid(ranges, memory, parameters, wish)


@portable_inlined
def _smoothed(
    vx: float, vy: float, ego: FloatArray, memory: FloatArray, parameters: FloatArray
) -> tuple[float, float]:
    """Pass the flocking part through a low-pass, in the map."""
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    mx, my = cos_yaw * vx - sin_yaw * vy, sin_yaw * vx + cos_yaw * vy
    share = 1.0
    if parameters[REYNOLDS_LOW_PASS] > 0.0:
        share = 1.0 - math.exp(-ego[EGO_DT] / parameters[REYNOLDS_LOW_PASS])
    memory[PLAIN_STATE] += share * (mx - memory[PLAIN_STATE])
    memory[PLAIN_STATE + 1] += share * (my - memory[PLAIN_STATE + 1])
    mx, my = memory[PLAIN_STATE], memory[PLAIN_STATE + 1]
    return cos_yaw * mx + sin_yaw * my, cos_yaw * my - sin_yaw * mx


@portable_inlined
def _avoid(ranges: FloatArray, memory: FloatArray, parameters: FloatArray, wish: FloatArray) -> None:
    """Add the repulsion of the nearest return in each sector."""
    find_columns_up_to(ranges, _HIGHEST_RAD, memory, PLAIN_COLUMNS)
    reach = parameters[REYNOLDS_OBSTACLE_REACH]
    wide = AZIMUTHS // _SECTORS
    for sector in range(_SECTORS):
        nearest = sector * wide
        for column in range(sector * wide, (sector + 1) * wide):
            if memory[PLAIN_COLUMNS + column] < memory[PLAIN_COLUMNS + nearest]:
                nearest = column
        gap = max(memory[PLAIN_COLUMNS + nearest] - parameters[REYNOLDS_BODY_RADIUS], _LEAST_GAP_M)
        if not gap < reach:
            continue
        size = parameters[REYNOLDS_OBSTACLE] * (1.0 / gap - 1.0 / reach) / (gap * gap)
        size = min(size, parameters[MAX_SPEED])
        cosine, sine = direction_of(nearest)
        wish[0] -= size * cosine
        wish[1] -= size * sine
