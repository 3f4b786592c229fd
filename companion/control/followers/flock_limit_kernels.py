"""What `flock` allows: half-planes of velocity, the way round what is in the way, and the projection.

Towards an obstacle at distance d, v.n <= a (d - margin); towards a neighbour the same, plus the velocity at
which it flies away, or less a share of that at which it comes, and less what that will soon be more.
Distances are those that will be left once a new command takes effect. What will be left aside with enough
clearance does not slow down, however near.
"""

import math

import numpy as np

from companion.compiled import portable_inlined
from companion.control.followers.flock_memory_kernels import recall_obstacle
from companion.control.followers.layout_kernels import (
    AZIMUTHS,
    EGO_V,
    EGO_YAW,
    FLOCK_BODY_RADIUS,
    FLOCK_COLUMNS,
    FLOCK_DETOUR,
    FLOCK_FORESIGHT,
    FLOCK_LIMIT_SIZE,
    FLOCK_LIMITED,
    FLOCK_LIMITS,
    FLOCK_NEIGHBOUR_MARGIN,
    FLOCK_NEIGHBOUR_RATE,
    FLOCK_NEIGHBOUR_SHARE,
    FLOCK_NEIGHBOUR_STOP,
    FLOCK_OBSTACLE_MARGIN,
    FLOCK_OBSTACLE_RATE,
    FLOCK_PASS,
    FLOCK_POINT_COUNT,
    FLOCK_RETREAT,
    FLOCK_SCAN_DELAY,
    FLOCK_STOP,
    FLOCK_VIEW,
    FLOCK_VIEW_SIZE,
    FLOCK_WISH,
    MAX_SPEED,
)
from companion.control.followers.sensing_kernels import direction_of
from companion.messages import FloatArray

_PASSES = 6
_RETREAT_MPS = 1.0
_SAME_PLACE_M = 1e-6
_TURNS = 11
_TURN_RAD = math.radians(10.0)
_COSINES = np.array([math.cos(turn * _TURN_RAD) for turn in range(_TURNS + 1)])
_SINES = np.array([math.sin(turn * _TURN_RAD) for turn in range(_TURNS + 1)])
_SAME_SIDE = 0.1


@portable_inlined
def _limit(count: int, nx: float, ny: float, bound: float, x: float, y: float, memory: FloatArray) -> int:
    """Append the half-plane v.n <= bound of what will be at (x, y); return how many there are then."""
    at = FLOCK_LIMITS + count * FLOCK_LIMIT_SIZE
    memory[at] = nx
    memory[at + 1] = ny
    memory[at + 2] = bound
    memory[at + 3] = x
    memory[at + 4] = y
    return count + 1


@portable_inlined
def limit_by_obstacles(ego: FloatArray, memory: FloatArray, parameters: FloatArray) -> int:
    """Write the half-planes of columns and remembered obstacles that matter; return their number."""
    rate, fastest = parameters[FLOCK_OBSTACLE_RATE], parameters[MAX_SPEED]
    room = parameters[FLOCK_OBSTACLE_MARGIN] + parameters[FLOCK_BODY_RADIUS]
    stop = parameters[FLOCK_STOP]
    ahead = stop + parameters[FLOCK_SCAN_DELAY]
    speed = math.sqrt(ego[EGO_V] * ego[EGO_V] + ego[EGO_V + 1] * ego[EGO_V + 1])
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    count = 0
    for column in range(AZIMUTHS):
        distance = memory[FLOCK_COLUMNS + column]
        if not rate * (distance - room - ahead * speed) < fastest:
            continue
        nx, ny = direction_of(column)
        bound = rate * (distance - room - ahead * (nx * ego[EGO_V] + ny * ego[EGO_V + 1]))
        if bound < fastest:
            x, y = distance * nx - ahead * ego[EGO_V], distance * ny - ahead * ego[EGO_V + 1]
            count = _limit(count, nx, ny, max(bound, -_RETREAT_MPS), x, y, memory)
    for point in range(FLOCK_POINT_COUNT):
        x, y, distance = recall_obstacle(point, ego, cos_yaw, sin_yaw, memory, parameters)
        if distance < _SAME_PLACE_M or not rate * (distance - room - stop * speed) < fastest:
            continue
        nx, ny = x / distance, y / distance
        bound = rate * (distance - room - stop * (nx * ego[EGO_V] + ny * ego[EGO_V + 1]))
        if bound < fastest:
            x, y = x - stop * ego[EGO_V], y - stop * ego[EGO_V + 1]
            count = _limit(count, nx, ny, max(bound, -_RETREAT_MPS), x, y, memory)
    return count


@portable_inlined
def limit_by_neighbours(
    ego: FloatArray, known: int, count: int, memory: FloatArray, parameters: FloatArray
) -> int:
    """Append the half-planes of all neighbours; return how many there are then."""
    stop, soon = parameters[FLOCK_NEIGHBOUR_STOP], parameters[FLOCK_FORESIGHT]
    for index in range(known):
        row = FLOCK_VIEW + index * FLOCK_VIEW_SIZE
        x, y, vx, vy = memory[row], memory[row + 1], memory[row + 3], memory[row + 4]
        x, y = x + stop * (vx - ego[EGO_V]), y + stop * (vy - ego[EGO_V + 1])
        distance = max(math.sqrt(x * x + y * y), _SAME_PLACE_M)
        ex, ey = x / distance, y / distance
        bound = parameters[FLOCK_NEIGHBOUR_RATE] * (distance - parameters[FLOCK_NEIGHBOUR_MARGIN])
        away = vx * ex + vy * ey
        away += min(soon * (memory[row + 6] * ex + memory[row + 7] * ey), 0.0)
        bound += away if away > 0.0 else parameters[FLOCK_NEIGHBOUR_SHARE] * away
        count = _limit(count, ex, ey, max(bound, -parameters[FLOCK_RETREAT]), x, y, memory)
    return count


@portable_inlined
def _clearance(parameters: FloatArray) -> float:
    """Return how far from the own centre an obstacle must be left aside not to slow down, m."""
    clear: float = parameters[FLOCK_BODY_RADIUS] + parameters[FLOCK_OBSTACLE_MARGIN] + parameters[FLOCK_PASS]
    return clear


@portable_inlined
def _passes(dx: float, dy: float, at: int, clear: float, memory: FloatArray) -> bool:
    """Return whether flying along a unit vector leaves the obstacle of a half-plane `clear` aside."""
    x, y = memory[at + 3], memory[at + 4]
    along = max(x * dx + y * dy, 0.0)
    left: bool = (x - along * dx) ** 2 + (y - along * dy) ** 2 >= clear * clear
    return left


@portable_inlined
def _allowed(dx: float, dy: float, speed: float, count: int, clear: float, memory: FloatArray) -> float:
    """Return the speed up to `speed` that the first `count` obstacles allow along a unit vector."""
    allowed = speed
    for index in range(count):
        at = FLOCK_LIMITS + index * FLOCK_LIMIT_SIZE
        along = memory[at] * dx + memory[at + 1] * dy
        if along * allowed > memory[at + 2] and not _passes(dx, dy, at, clear, memory):
            allowed = max(memory[at + 2], 0.0) / along if along > 0.0 else 0.0
    return allowed


@portable_inlined
def take_detour(
    ego: FloatArray, count: int, memory: FloatArray, parameters: FloatArray, wish: FloatArray
) -> None:
    """Turn the wish to where it can be flown fastest, where obstacles are in its way.

    Of directions up to 110 deg to either side the best is where speed allowed times (cosine of the turn, plus
    the worth of a detour) is greatest; the side to which the vehicle is flying already counts a little more.
    """
    speed = math.sqrt(wish[0] * wish[0] + wish[1] * wish[1])
    worth = parameters[FLOCK_DETOUR]
    if count == 0 or worth <= 0.0 or speed < _SAME_PLACE_M:
        return
    ux, uy = wish[0] / speed, wish[1] / speed
    clear = _clearance(parameters)
    straight = _allowed(ux, uy, speed, count, clear, memory)
    if straight >= speed:
        return
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    px = cos_yaw * memory[FLOCK_WISH] + sin_yaw * memory[FLOCK_WISH + 1]
    py = cos_yaw * memory[FLOCK_WISH + 1] - sin_yaw * memory[FLOCK_WISH]
    favoured = 1.0 if ux * py - uy * px >= 0.0 else -1.0
    best = straight * (1.0 + worth)
    for turn in range(1, _TURNS + 1):
        for side in (1.0, -1.0):
            cosine, sine = _COSINES[turn], side * _SINES[turn]
            dx, dy = cosine * ux - sine * uy, sine * ux + cosine * uy
            value = cosine + worth
            if side == favoured:
                value += _SAME_SIDE
            if value * speed <= best:
                continue
            allowed = _allowed(dx, dy, speed, count, clear, memory)
            if value * allowed > best:
                best = value * allowed
                wish[0] = allowed * dx
                wish[1] = allowed * dy


@portable_inlined
def turn_past_obstacles(count: int, memory: FloatArray, parameters: FloatArray, wish: FloatArray) -> None:
    """Where the wish leaves an obstacle aside, no longer forbid to come nearer but only to turn towards it.

    The half-plane then ends at the tangent to the circle of the needed clearance about the obstacle, on the
    side that it is passed on.

    Source: the sides of a velocity obstacle, P. Fiorini and Z. Shiller, "Motion planning in dynamic
    environments using velocity obstacles", 1998.
    """
    speed = math.sqrt(wish[0] * wish[0] + wish[1] * wish[1])
    if speed < _SAME_PLACE_M:
        return
    ux, uy = wish[0] / speed, wish[1] / speed
    clear = _clearance(parameters)
    for index in range(count):
        at = FLOCK_LIMITS + index * FLOCK_LIMIT_SIZE
        x, y = memory[at + 3], memory[at + 4]
        distance = math.sqrt(x * x + y * y)
        if distance <= clear or not _passes(ux, uy, at, clear, memory):
            continue
        sine = clear / distance
        cosine = math.sqrt(1.0 - sine * sine)
        if x * uy < y * ux:
            cosine = -cosine
        ex, ey = x / distance, y / distance
        memory[at] = sine * ex + cosine * ey
        memory[at + 1] = sine * ey - cosine * ex
        memory[at + 2] = max(sine * memory[at + 2], 0.0)


@portable_inlined
def project(count: int, memory: FloatArray, wish: FloatArray) -> None:
    """Project the wish onto the first `count` half-planes in turn, the last first.

    Obstacles come last, so that they have the last word where neighbours push towards them.

    Source: cyclic projections, L. M. Bregman, "The method of successive projection for finding a common point
    of convex sets", 1965: they end in a common point if there is one.
    """
    for _ in range(_PASSES):
        changed = False
        for index in range(count - 1, -1, -1):
            at = FLOCK_LIMITS + index * FLOCK_LIMIT_SIZE
            excess = wish[0] * memory[at] + wish[1] * memory[at + 1] - memory[at + 2]
            if excess > 1e-9:
                wish[0] -= excess * memory[at]
                wish[1] -= excess * memory[at + 1]
                changed = True
        if not changed:
            return


@portable_inlined
def keep_to_limits(x: float, y: float, memory: FloatArray, command: FloatArray) -> None:
    """Project another command onto the half-planes of this tick, as far as the law's (x, y) keeps to them.

    What the law itself cannot keep, as it changes its command only so fast, is not asked of others: who flies
    what the law does is not held back at all.
    """
    count = int(memory[FLOCK_LIMITED])
    for index in range(count):
        at = FLOCK_LIMITS + index * FLOCK_LIMIT_SIZE
        memory[at + 2] = max(memory[at + 2], memory[at] * x + memory[at + 1] * y)
    project(count, memory, command)
