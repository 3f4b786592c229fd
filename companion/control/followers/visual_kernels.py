"""The `vpf` laws: every visible body, as large as it appears, pushes by its size and pulls by its edges.

Source: R. Bastien, P. Romanczuk, "A model of collective behavior based purely on vision", Science Advances,
2020, eq. 1; the holonomic form states a velocity for both directions and adds alignment.
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
    POLAR_BODY_RADIUS,
    POLAR_CRUISE,
    POLAR_OBSTACLE,
    POLAR_OBSTACLE_REACH,
    POLAR_RELAXATION,
    POLAR_SPEED_EDGE,
    POLAR_SPEED_GAIN,
    POLAR_TURN_EDGE,
    POLAR_TURN_GAIN,
    ROW_P,
    ROW_PRESENT,
    ROW_V,
    STARTED,
    VPF_ALIGNMENT,
    VPF_BODY_RADIUS,
    VPF_EDGE,
    VPF_GAIN,
    VPF_OBSTACLE,
    VPF_OBSTACLE_REACH,
)
from companion.control.followers.sensing_kernels import find_columns_up_to
from companion.messages import FloatArray

_HIGHEST_RAD = math.radians(20.0)
_LEAST_DISTANCE_M = 1e-3


@portable_inlined
def _size_of(neighbours: FloatArray, row: int, radius: float) -> tuple[float, float]:
    """Return a neighbour's distance, and half the angle under which it appears."""
    x, y, z = neighbours[row, ROW_P], neighbours[row, ROW_P + 1], neighbours[row, ROW_P + 2]
    distance = max(math.sqrt(x * x + y * y + z * z), _LEAST_DISTANCE_M)
    return distance, math.asin(min(1.0, radius / distance))


@portable_inlined
def _is_hidden(neighbours: FloatArray, row: int, radius: float) -> bool:
    """Return whether a nearer neighbour stands before the middle of this one."""
    distance, _ = _size_of(neighbours, row, radius)
    for other in range(neighbours.shape[0]):
        if other == row or neighbours[other, ROW_PRESENT] < 0.5:
            continue
        nearer, half = _size_of(neighbours, other, radius)
        if nearer >= distance:
            continue
        along = 0.0
        for axis in range(3):
            along += neighbours[row, ROW_P + axis] * neighbours[other, ROW_P + axis]
        if along > math.cos(half) * distance * nearer:
            return True
    return False


@portable_inlined
def _obstacles(ranges: FloatArray, reach: float, memory: FloatArray) -> tuple[float, float]:
    """Return the sum of the directions of all blobs of near columns, weighted with how wide they appear.

    Only the width counts, as for everything in this law: a thin trunk pushes little however near it is.
    """
    find_columns_up_to(ranges, _HIGHEST_RAD, memory, PLAIN_COLUMNS)
    start = -1
    for column in range(AZIMUTHS):
        if not memory[PLAIN_COLUMNS + column] < reach:
            start = column
            break
    if start < 0:
        return 0.0, 0.0
    sum_x, sum_y, width = 0.0, 0.0, 0
    for offset in range(1, AZIMUTHS + 1):
        column = (start + offset) % AZIMUTHS
        if memory[PLAIN_COLUMNS + column] < reach:
            width += 1
        elif width > 0:
            angle = 2.0 * math.pi * width / AZIMUTHS
            middle = 2.0 * math.pi * (start + offset - 0.5 * width) / AZIMUTHS
            sum_x += 2.0 * math.sin(0.5 * angle) * math.cos(middle)
            sum_y += 2.0 * math.sin(0.5 * angle) * math.sin(middle)
            width = 0
    return sum_x, sum_y


@portable_inlined
def visual_field(
    ego: FloatArray,
    neighbours: FloatArray,
    ranges: FloatArray,
    memory: FloatArray,
    parameters: FloatArray,
    wish: FloatArray,
) -> None:
    """Write the horizontal velocity that `vpf` wants into `wish`, in the heading frame, m/s."""
    radius, edge = parameters[VPF_BODY_RADIUS], parameters[VPF_EDGE]
    count, flow_x, flow_y = 0, 0.0, 0.0
    for row in range(neighbours.shape[0]):
        if neighbours[row, ROW_PRESENT] < 0.5 or _is_hidden(neighbours, row, radius):
            continue
        distance, half = _size_of(neighbours, row, radius)
        pull = parameters[VPF_GAIN] * 2.0 * (edge * math.cos(half) - math.sin(half)) / distance
        wish[0] += pull * neighbours[row, ROW_P]
        wish[1] += pull * neighbours[row, ROW_P + 1]
        count += 1
        flow_x += neighbours[row, ROW_V] + ego[EGO_V]
        flow_y += neighbours[row, ROW_V + 1] + ego[EGO_V + 1]
    if count > 0:
        wish[0] += parameters[VPF_ALIGNMENT] * flow_x / count
        wish[1] += parameters[VPF_ALIGNMENT] * flow_y / count
    away_x, away_y = _obstacles(ranges, parameters[VPF_OBSTACLE_REACH], memory)
    wish[0] -= parameters[VPF_OBSTACLE] * away_x
    wish[1] -= parameters[VPF_OBSTACLE] * away_y


@portable_inlined
def visual_field_polar(
    ego: FloatArray,
    neighbours: FloatArray,
    ranges: FloatArray,
    memory: FloatArray,
    parameters: FloatArray,
    wish: FloatArray,
) -> None:
    """Write the horizontal velocity that `vpf_polar` wants into `wish`, in the heading frame, m/s.

    It keeps a speed and a course in the map, and the field changes both.
    """
    if memory[STARTED] < 0.5:
        memory[PLAIN_STATE] = 0.0
        memory[PLAIN_STATE + 1] = ego[EGO_YAW]
    speed, course = memory[PLAIN_STATE], memory[PLAIN_STATE + 1] - ego[EGO_YAW]
    cos_course, sin_course = math.cos(course), math.sin(course)
    radius = parameters[POLAR_BODY_RADIUS]
    faster, turn = 0.0, 0.0
    for row in range(neighbours.shape[0]):
        if neighbours[row, ROW_PRESENT] < 0.5 or _is_hidden(neighbours, row, radius):
            continue
        distance, half = _size_of(neighbours, row, radius)
        x, y = neighbours[row, ROW_P] / distance, neighbours[row, ROW_P + 1] / distance
        ahead, left = cos_course * x + sin_course * y, cos_course * y - sin_course * x
        faster += 2.0 * (parameters[POLAR_SPEED_EDGE] * math.cos(half) - math.sin(half)) * ahead
        turn += 2.0 * (parameters[POLAR_TURN_EDGE] * math.cos(half) - math.sin(half)) * left
    x, y = _obstacles(ranges, parameters[POLAR_OBSTACLE_REACH], memory)
    faster -= parameters[POLAR_OBSTACLE] * (cos_course * x + sin_course * y)
    turn -= parameters[POLAR_OBSTACLE] * (cos_course * y - sin_course * x)
    dt = ego[EGO_DT]
    speed += dt * parameters[POLAR_RELAXATION] * (parameters[POLAR_CRUISE] - speed)
    speed += dt * parameters[POLAR_SPEED_GAIN] * faster
    speed = min(max(speed, -parameters[MAX_SPEED]), parameters[MAX_SPEED])
    course += dt * parameters[POLAR_TURN_GAIN] * turn
    memory[PLAIN_STATE] = speed
    memory[PLAIN_STATE + 1] = (course + ego[EGO_YAW]) % (2.0 * math.pi)
    wish[0] = speed * math.cos(course)
    wish[1] = speed * math.sin(course)
