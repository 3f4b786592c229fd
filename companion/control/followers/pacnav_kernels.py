"""The `pacnav` law: follow whoever flies most purposefully, by persistence and similarity of paths.

Source: A. Ahmad, D. B. Licea, G. Silano, T. Baca, M. Saska, "PACNav: a collective navigation approach for
UAV swarms deprived of communication and external localization", 2022. Virtual obstacles come from the columns
of the obstacle grid; whether a neighbour leads nobody knows, so nobody slows down as a leader.
"""

import math

from companion.compiled import portable_inlined
from companion.control.followers.layout_kernels import (
    AZIMUTHS,
    EGO_P,
    EGO_YAW,
    PACNAV_BEAT,
    PACNAV_BEAT_LENGTH,
    PACNAV_BODY_RADIUS,
    PACNAV_COLUMNS,
    PACNAV_FLOCK_RADIUS,
    PACNAV_FORCE,
    PACNAV_FORCE_REACH,
    PACNAV_LAST_P,
    PACNAV_MAX_SPEED,
    PACNAV_NAVIGATION,
    PACNAV_OBSTACLE,
    PACNAV_OBSTACLE_REACH,
    PACNAV_PATH_COUNT,
    PACNAV_SETTLE,
    PACNAV_TARGET,
    PREVIOUS,
)
from companion.control.followers.pacnav_path_kernels import (
    first_beat,
    is_known,
    is_near,
    last_beat,
    path_at,
    remember_paths,
    sample,
    score,
)
from companion.control.followers.sensing_kernels import direction_of, find_columns_up_to
from companion.messages import FloatArray

_HIGHEST_RAD = math.radians(20.0)
_LEAST_GAP_M = 0.01
_STANDING_MPS = 0.017
_COLUMNS_PER_OBSTACLE = 3
_BRAKING_POWER = 8.0


@portable_inlined
def pacnav(
    ego: FloatArray,
    neighbours: FloatArray,
    ranges: FloatArray,
    memory: FloatArray,
    parameters: FloatArray,
    wish: FloatArray,
) -> None:
    """Write the horizontal velocity that `pacnav` wants into `wish`, in the heading frame, m/s."""
    remember_paths(ego, neighbours, memory, parameters)
    find_columns_up_to(ranges, _HIGHEST_RAD, memory, PACNAV_COLUMNS)
    _choose_target(ego, memory, parameters)
    _navigate(ego, memory, parameters, wish)
    _keep_clear(ego, memory, parameters, wish)
    speed = math.sqrt(wish[0] * wish[0] + wish[1] * wish[1])
    if speed > parameters[PACNAV_MAX_SPEED]:
        wish[0] *= parameters[PACNAV_MAX_SPEED] / speed
        wish[1] *= parameters[PACNAV_MAX_SPEED] / speed


@portable_inlined
def _distance(ego: FloatArray, memory: FloatArray, path: int) -> float:
    at = path_at(path) + PACNAV_LAST_P
    return math.hypot(memory[at] - ego[EGO_P], memory[at + 1] - ego[EGO_P + 1])


@portable_inlined
def _relative(ego: FloatArray, memory: FloatArray, path: int) -> tuple[float, float]:
    """Return where a neighbour is, or was when it went out of sight, in the heading frame."""
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    at = path_at(path) + PACNAV_LAST_P
    dx, dy = memory[at] - ego[EGO_P], memory[at + 1] - ego[EGO_P + 1]
    return cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx


@portable_inlined
def _choose_target(ego: FloatArray, memory: FloatArray, parameters: FloatArray) -> None:
    """Keep the target, unless somebody who is not on the way to it flies more purposefully.

    The first target is the nearest. There is none before there has been time to watch, for the first who
    stirs would draw all the others.
    """
    target = -1
    nearest, nearest_distance = -1, math.inf
    anybody = False
    for path in range(PACNAV_PATH_COUNT):
        if not is_known(memory, path):
            continue
        anybody = anybody or is_near(memory, path, parameters)
        if memory[path_at(path)] == memory[PACNAV_TARGET]:
            target = path
        distance = _distance(ego, memory, path)
        if parameters[PACNAV_FLOCK_RADIUS] < distance < nearest_distance:
            nearest, nearest_distance = path, distance
    if not anybody or memory[PACNAV_BEAT] * parameters[PACNAV_BEAT_LENGTH] < parameters[PACNAV_SETTLE] - 1e-6:
        memory[PACNAV_TARGET] = 0.0
        return
    if target < 0:
        target = nearest
    if target < 0:
        memory[PACNAV_TARGET] = 0.0
        return
    best = score(memory, target, parameters)
    for path in range(PACNAV_PATH_COUNT):
        if path == target or not is_known(memory, path):
            continue
        if _distance(ego, memory, path) <= parameters[PACNAV_FLOCK_RADIUS]:
            continue
        at = path_at(target) + PACNAV_LAST_P
        x_old, y_old = sample(memory, path, first_beat(memory, path))
        x_new, y_new = sample(memory, path, last_beat(memory, path))
        before = math.hypot(x_old - memory[at], y_old - memory[at + 1])
        after = math.hypot(x_new - memory[at], y_new - memory[at + 1])
        if after < before:
            continue
        other = score(memory, path, parameters)
        if other > best:
            target, best = path, other
    memory[PACNAV_TARGET] = memory[path_at(target)]


@portable_inlined
def _navigate(ego: FloatArray, memory: FloatArray, parameters: FloatArray, wish: FloatArray) -> None:
    """Fly to the target, braked towards every neighbour that is nearer than the flock's radius."""
    nx, ny = 0.0, 0.0
    for path in range(PACNAV_PATH_COUNT):
        if memory[PACNAV_TARGET] > 0.0 and memory[path_at(path)] == memory[PACNAV_TARGET]:
            nx, ny = _relative(ego, memory, path)
    for path in range(PACNAV_PATH_COUNT):
        if not is_near(memory, path, parameters):
            continue
        x, y = _relative(ego, memory, path)
        distance = math.hypot(x, y)
        if distance < _LEAST_GAP_M:
            continue
        ex, ey = x / distance, y / distance
        ahead = nx * ex + ny * ey
        gap = max(distance - parameters[PACNAV_BODY_RADIUS], _LEAST_GAP_M)
        if ahead > 0.0 and gap <= parameters[PACNAV_FLOCK_RADIUS]:
            less = 1.0 - (gap / parameters[PACNAV_FLOCK_RADIUS]) ** _BRAKING_POWER
            nx -= less * ahead * ex
            ny -= less * ahead * ey
    wish[0] = parameters[PACNAV_NAVIGATION] * nx
    wish[1] = parameters[PACNAV_NAVIGATION] * ny


@portable_inlined
def _keep_clear(ego: FloatArray, memory: FloatArray, parameters: FloatArray, wish: FloatArray) -> None:
    """Add the mean force of the obstacles and that of the neighbours."""
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    vx = cos_yaw * memory[PREVIOUS] + sin_yaw * memory[PREVIOUS + 1]
    vy = cos_yaw * memory[PREVIOUS + 1] - sin_yaw * memory[PREVIOUS]
    radius = parameters[PACNAV_BODY_RADIUS]
    reach = parameters[PACNAV_OBSTACLE_REACH]
    count, sum_x, sum_y = 0, 0.0, 0.0
    column = 0
    while column < AZIMUTHS:
        distance = memory[PACNAV_COLUMNS + column]
        if distance < reach + radius:
            cosine, sine = direction_of(column)
            x, y = distance * cosine, distance * sine
            fx, fy = _force(x, y, parameters[PACNAV_OBSTACLE], reach, vx, vy, parameters)
            count, sum_x, sum_y = count + 1, sum_x + fx, sum_y + fy
            column += _COLUMNS_PER_OBSTACLE
        else:
            column += 1
    if count > 0:
        wish[0] += sum_x / count
        wish[1] += sum_y / count
    reach = parameters[PACNAV_FORCE_REACH] + radius
    count, sum_x, sum_y = 0, 0.0, 0.0
    for path in range(PACNAV_PATH_COUNT):
        if not is_near(memory, path, parameters):
            continue
        x, y = _relative(ego, memory, path)
        if max(math.hypot(x, y) - radius, _LEAST_GAP_M) > reach:
            continue
        fx, fy = _force(x, y, parameters[PACNAV_FORCE], reach, vx, vy, parameters)
        count, sum_x, sum_y = count + 1, sum_x + fx, sum_y + fy
    if count > 0:
        wish[0] += sum_x / count
        wish[1] += sum_y / count


@portable_inlined
def _force(
    x: float, y: float, strength: float, reach: float, vx: float, vy: float, parameters: FloatArray
) -> tuple[float, float]:
    """Return the force of what is at (x, y): along it when far, straight away from it when near."""
    distance = math.hypot(x, y)
    if distance < _LEAST_GAP_M:
        x, y, distance = _LEAST_GAP_M, 0.0, _LEAST_GAP_M
    gap = max(distance - parameters[PACNAV_BODY_RADIUS], _LEAST_GAP_M)
    if gap > reach:
        return 0.0, 0.0
    size = strength * (1.0 / math.sqrt(gap) - 1.0 / math.sqrt(reach))
    bx, by = -size * x / distance, -size * y / distance
    if math.hypot(vx, vy) < _STANDING_MPS:
        return bx, by
    turn = 0.5 * math.pi * gap / reach
    cos_turn, sin_turn = math.cos(turn), math.sin(turn)
    left_x, left_y = cos_turn * bx - sin_turn * by, sin_turn * bx + cos_turn * by
    right_x, right_y = cos_turn * bx + sin_turn * by, cos_turn * by - sin_turn * bx
    if left_x * vx + left_y * vy >= right_x * vx + right_y * vy:
        return left_x, left_y
    return right_x, right_y
