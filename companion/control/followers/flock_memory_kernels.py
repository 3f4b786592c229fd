"""What `flock` remembers: neighbours just out of sight, and obstacles that have left the field of view."""

import math

from companion.compiled import portable_inlined
from companion.control.followers.layout_kernels import (
    AZIMUTHS,
    EGO_DT,
    EGO_P,
    EGO_V,
    EGO_YAW,
    FLOCK_BAND_ABOVE,
    FLOCK_BAND_BELOW,
    FLOCK_COLUMNS,
    FLOCK_NEIGHBOUR_MEMORY,
    FLOCK_OBSTACLE_MEMORY,
    FLOCK_POINT_COUNT,
    FLOCK_POINT_SIZE,
    FLOCK_POINTS,
    FLOCK_SCAN_DELAY,
    FLOCK_SLOT_COUNT,
    FLOCK_SLOT_SIZE,
    FLOCK_SLOTS,
    FLOCK_VIEW,
    FLOCK_VIEW_SIZE,
    ROW_ID,
    ROW_P,
    ROW_PRESENT,
    ROW_V,
)
from companion.control.followers.sensing_kernels import direction_of
from companion.messages import FloatArray

_SAME_BODY_M = 0.8
_SAME_OBSTACLE_M = 0.15
_REMEMBERED_WITHIN_M = 2.0
_LONGEST_PREDICTION_S = 1.0
_SHORTEST_MEMORY_S = 1e-3
_SMOOTHED_OVER_S = 0.3


@portable_inlined
def remember_neighbours(
    ego: FloatArray, neighbours: FloatArray, memory: FloatArray, parameters: FloatArray
) -> None:
    """Write the present neighbours into their slots, in the map; forget those unseen for too long."""
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    longest = parameters[FLOCK_NEIGHBOUR_MEMORY]
    newer = ego[EGO_DT] / (_SMOOTHED_OVER_S + ego[EGO_DT])
    for slot in range(FLOCK_SLOT_COUNT):
        at = FLOCK_SLOTS + slot * FLOCK_SLOT_SIZE
        if memory[at] == 0.0:
            continue
        memory[at + 1] += ego[EGO_DT]
        if memory[at + 1] > longest:
            memory[at] = 0.0
    for row in range(neighbours.shape[0]):
        if neighbours[row, ROW_PRESENT] < 0.5:
            continue
        x, y = neighbours[row, ROW_P], neighbours[row, ROW_P + 1]
        vx = neighbours[row, ROW_V] + ego[EGO_V]
        vy = neighbours[row, ROW_V + 1] + ego[EGO_V + 1]
        px = ego[EGO_P] + cos_yaw * x - sin_yaw * y
        py = ego[EGO_P + 1] + sin_yaw * x + cos_yaw * y
        pz = ego[EGO_P + 2] + neighbours[row, ROW_P + 2]
        at = _slot_for(memory, neighbours[row, ROW_ID] + 1.0, px, py, pz)
        vx, vy = cos_yaw * vx - sin_yaw * vy, sin_yaw * vx + cos_yaw * vy
        if memory[at] != neighbours[row, ROW_ID] + 1.0:
            memory[at + 8] = vx
            memory[at + 9] = vy
        memory[at] = neighbours[row, ROW_ID] + 1.0
        memory[at + 1] = 0.0
        memory[at + 2] = px
        memory[at + 3] = py
        memory[at + 4] = pz
        memory[at + 5] = vx
        memory[at + 6] = vy
        memory[at + 7] = neighbours[row, ROW_V + 2] + ego[EGO_V + 2]
        memory[at + 8] += newer * (vx - memory[at + 8])
        memory[at + 9] += newer * (vy - memory[at + 9])


@portable_inlined
def _slot_for(memory: FloatArray, number: float, px: float, py: float, pz: float) -> int:
    """Return the slot of this number; or of a lost body where this one is; or a free one; or the oldest."""
    same, free, oldest = -1, -1, FLOCK_SLOTS
    for slot in range(FLOCK_SLOT_COUNT):
        at = FLOCK_SLOTS + slot * FLOCK_SLOT_SIZE
        if memory[at] == number:
            return at
        if memory[at] == 0.0:
            if free < 0:
                free = at
            continue
        age = memory[at + 1]
        if age > memory[oldest + 1]:
            oldest = at
        if age > 0.0:
            ahead = min(age, _LONGEST_PREDICTION_S)
            dx = memory[at + 2] + ahead * memory[at + 5] - px
            dy = memory[at + 3] + ahead * memory[at + 6] - py
            dz = memory[at + 4] + ahead * memory[at + 7] - pz
            if dx * dx + dy * dy + dz * dz < _SAME_BODY_M * _SAME_BODY_M:
                same = at
    if same >= 0:
        return same
    return free if free >= 0 else oldest


@portable_inlined
def recall_neighbours(ego: FloatArray, memory: FloatArray, parameters: FloatArray) -> int:
    """Write where everybody is believed to be; return how many are known.

    Rows of the view are relative position and own velocity in the heading frame; trust, 1 for those seen and
    less and less for others; acceleration, from how the velocity differs from what it was of late.
    """
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    longest = max(parameters[FLOCK_NEIGHBOUR_MEMORY], _SHORTEST_MEMORY_S)
    count = 0
    for slot in range(FLOCK_SLOT_COUNT):
        at = FLOCK_SLOTS + slot * FLOCK_SLOT_SIZE
        if memory[at] == 0.0:
            continue
        ahead = min(memory[at + 1], _LONGEST_PREDICTION_S)
        dx = memory[at + 2] + ahead * memory[at + 5] - ego[EGO_P]
        dy = memory[at + 3] + ahead * memory[at + 6] - ego[EGO_P + 1]
        row = FLOCK_VIEW + count * FLOCK_VIEW_SIZE
        memory[row] = cos_yaw * dx + sin_yaw * dy
        memory[row + 1] = cos_yaw * dy - sin_yaw * dx
        memory[row + 2] = memory[at + 4] + ahead * memory[at + 7] - ego[EGO_P + 2]
        memory[row + 3] = cos_yaw * memory[at + 5] + sin_yaw * memory[at + 6]
        memory[row + 4] = cos_yaw * memory[at + 6] - sin_yaw * memory[at + 5]
        memory[row + 5] = max(1.0 - memory[at + 1] / longest, 0.0)
        ax = (memory[at + 5] - memory[at + 8]) / _SMOOTHED_OVER_S
        ay = (memory[at + 6] - memory[at + 9]) / _SMOOTHED_OVER_S
        memory[row + 6] = cos_yaw * ax + sin_yaw * ay
        memory[row + 7] = cos_yaw * ay - sin_yaw * ax
        count += 1
    return count


@portable_inlined
def remember_obstacles(ego: FloatArray, memory: FloatArray, parameters: FloatArray) -> None:
    """Keep the nearest obstacles of the columns for a while, as points of the map.

    A stone that is passed over sinks under the field of view, and a thin branch is not hit by every scan;
    both are still there.
    """
    longest = parameters[FLOCK_OBSTACLE_MEMORY]
    for point in range(FLOCK_POINT_COUNT):
        at = FLOCK_POINTS + point * FLOCK_POINT_SIZE
        memory[at] = max(memory[at] - ego[EGO_DT], 0.0)
    if longest <= 0.0:
        return
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    delay = parameters[FLOCK_SCAN_DELAY]
    for column in range(AZIMUTHS):
        distance = memory[FLOCK_COLUMNS + column]
        if not distance < _REMEMBERED_WITHIN_M:
            continue
        cosine, sine = direction_of(column)
        x = distance * cosine - delay * ego[EGO_V]
        y = distance * sine - delay * ego[EGO_V + 1]
        px = ego[EGO_P] + cos_yaw * x - sin_yaw * y
        py = ego[EGO_P + 1] + sin_yaw * x + cos_yaw * y
        pz = ego[EGO_P + 2]
        at = FLOCK_POINTS
        for point in range(FLOCK_POINT_COUNT):
            here = FLOCK_POINTS + point * FLOCK_POINT_SIZE
            if memory[here] < memory[at]:
                at = here
            dx, dy = memory[here + 1] - px, memory[here + 2] - py
            if memory[here] > 0.0 and dx * dx + dy * dy < _SAME_OBSTACLE_M * _SAME_OBSTACLE_M:
                at = here
                break
        memory[at] = longest
        memory[at + 1] = px
        memory[at + 2] = py
        memory[at + 3] = pz


@portable_inlined
def recall_obstacle(
    point: int, ego: FloatArray, cos_yaw: float, sin_yaw: float, memory: FloatArray, parameters: FloatArray
) -> tuple[float, float, float]:
    """Return where a remembered obstacle is: horizontal position in the heading frame, and distance.

    The distance is infinite if there is none, or if it was met at another height.
    """
    at = FLOCK_POINTS + point * FLOCK_POINT_SIZE
    rise = ego[EGO_P + 2] - memory[at + 3]
    if memory[at] <= 0.0 or rise > parameters[FLOCK_BAND_ABOVE] or rise < -parameters[FLOCK_BAND_BELOW]:
        return 0.0, 0.0, math.inf
    dx, dy = memory[at + 1] - ego[EGO_P], memory[at + 2] - ego[EGO_P + 1]
    return (
        cos_yaw * dx + sin_yaw * dy,
        cos_yaw * dy - sin_yaw * dx,
        math.sqrt(dx * dx + dy * dy),
    )
