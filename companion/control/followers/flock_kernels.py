"""The `flock` law: follow those who lead away, keep apart, and never fly faster at anything than it allows.

1. Where everybody is, a little ahead of now, those just out of sight included.
2. Cohesion and the neighbours' own velocity, both weighted towards neighbours that fly away from here: they
   lead, and the others come along by themselves.
3. Separation, and stepping aside from whoever turns back through the flock.
4. A gentle flow round obstacles.
5. Where an obstacle is in the way the wish turns to where it can be flown fastest; what is then left aside
   does not slow down.
6. What remains is projected onto half-planes of the velocities that obstacles and neighbours allow.
"""

import math

from companion.compiled import portable_inlined
from companion.control.followers.flock_limit_kernels import (
    limit_by_neighbours,
    limit_by_obstacles,
    project,
    take_detour,
    turn_past_obstacles,
)
from companion.control.followers.flock_memory_kernels import (
    recall_neighbours,
    remember_neighbours,
    remember_obstacles,
)
from companion.control.followers.layout_kernels import (
    AZIMUTHS,
    EGO_ALONE,
    EGO_DT,
    EGO_HEIGHT,
    EGO_V,
    EGO_YAW,
    FLOCK_BAND_ABOVE,
    FLOCK_BAND_BELOW,
    FLOCK_BELOW,
    FLOCK_BODY_RADIUS,
    FLOCK_COAST,
    FLOCK_COHESION,
    FLOCK_COLUMNS,
    FLOCK_DODGE,
    FLOCK_DODGE_FULL,
    FLOCK_DODGE_ROOM,
    FLOCK_DODGE_TIME,
    FLOCK_FAR,
    FLOCK_FEED_FORWARD,
    FLOCK_FLOW,
    FLOCK_FLOW_REACH,
    FLOCK_FORESIGHT,
    FLOCK_HEED,
    FLOCK_HEIGHT_GAIN,
    FLOCK_KNOWN,
    FLOCK_LEAD,
    FLOCK_LIMITED,
    FLOCK_LINK,
    FLOCK_LINK_BEHIND,
    FLOCK_LINK_LENGTH,
    FLOCK_PURSUIT,
    FLOCK_SEPARATION,
    FLOCK_SEPARATION_REACH,
    FLOCK_TOP_WEIGHT,
    FLOCK_VIEW,
    FLOCK_VIEW_SIZE,
    FLOCK_WISH,
    MAX_SPEED,
    RECOVERY_HEIGHT,
)
from companion.control.followers.sensing_kernels import direction_of, find_columns
from companion.messages import FloatArray

_TOUCHING_M = 0.35
_LEAST_GAP_M = 0.1
_FLOW_COLUMNS = 72.0 / 8.0
_SAME_PLACE_M = 1e-6
_RECOVERY_AFTER_S = 1.0
_LEAST_LINK = 0.1
_STRAIGHT_M = 0.05
_LEAST_SHARE = 0.5


@portable_inlined
def flock(
    ego: FloatArray,
    neighbours: FloatArray,
    ranges: FloatArray,
    memory: FloatArray,
    parameters: FloatArray,
    wish: FloatArray,
    is_new_grid: bool,
) -> None:
    """Write the velocity that `flock` wants into `wish`, in the heading frame, m/s.

    If the grid is not new, it is the one of the call before, and what was found in it holds.
    """
    remember_neighbours(ego, neighbours, memory, parameters)
    if is_new_grid:
        below, above = parameters[FLOCK_BAND_BELOW], parameters[FLOCK_BAND_ABOVE]
        find_columns(ranges, below, above, memory, FLOCK_COLUMNS)
    remember_obstacles(ego, memory, parameters)
    known = recall_neighbours(ego, memory, parameters)
    memory[FLOCK_KNOWN] = known
    _gather(ego, known, memory, parameters, wish)
    _close_gaps(ego, known, memory, parameters, wish)
    _flow_round(memory, parameters, wish)
    count = limit_by_obstacles(ego, memory, parameters)
    _limit_speed(parameters, wish)
    take_detour(ego, count, memory, parameters, wish)
    turn_past_obstacles(count, memory, parameters, wish)
    count = limit_by_neighbours(ego, known, count, memory, parameters)
    memory[FLOCK_LIMITED] = count
    project(count, memory, wish)
    _remember_wish(ego, memory, wish)


@portable_inlined
def _gather(
    ego: FloatArray, known: int, memory: FloatArray, parameters: FloatArray, wish: FloatArray
) -> None:
    """Cohesion, following, separation, stepping aside and height; carry on alone if nobody is known."""
    lead = parameters[FLOCK_LEAD]
    reach = parameters[FLOCK_SEPARATION_REACH]
    sum_x, sum_y = _total_velocity(ego, known, memory)
    total, pull_x, pull_y, heeded, flow_x, flow_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    push_x, push_y, rise, rises, top = 0.0, 0.0, 0.0, 0.0, -math.inf
    for index in range(known):
        row = FLOCK_VIEW + index * FLOCK_VIEW_SIZE
        x, y, z = memory[row], memory[row + 1], memory[row + 2]
        vx, vy, trust = memory[row + 3], memory[row + 4], memory[row + 5]
        wx, wy = vx - ego[EGO_V], vy - ego[EGO_V + 1]
        rest_x, rest_y = (sum_x - vx) / known, (sum_y - vy) / known
        aside_x, aside_y = _step_aside(row, ego, rest_x, rest_y, memory, parameters)
        push_x += trust * aside_x
        push_y += trust * aside_y
        x, y = x + lead * wx, y + lead * wy
        distance = max(math.sqrt(x * x + y * y), _SAME_PLACE_M)
        ex, ey = x / distance, y / distance
        # Both must hold: it leaves, and it is not only left behind.
        away = max(min(wx * ex + wy * ey, vx * ex + vy * ey), 0.0)
        far = max(distance - reach, 0.0) / reach
        weight = trust * (1.0 + parameters[FLOCK_PURSUIT] * away) * (1.0 + parameters[FLOCK_FAR] * far)
        total += weight
        pull_x += weight * x
        pull_y += weight * y
        weight = trust * (1.0 + parameters[FLOCK_HEED] * away)
        heeded += weight
        flow_x += weight * vx
        flow_y += weight * vy
        rise += trust * z
        rises += trust
        top = max(top, z)
        if distance < reach:
            push = trust * parameters[FLOCK_SEPARATION] * (reach - distance) / reach
            push /= max(distance - _TOUCHING_M, _LEAST_GAP_M)
            push_x -= push * ex
            push_y -= push * ey
    if total <= 0.0:
        _coast(ego, memory, parameters, wish)
        return
    cohesion = parameters[FLOCK_COHESION] / (total + 1.0)
    follow = parameters[FLOCK_FEED_FORWARD] / heeded
    wish[0] = cohesion * pull_x + follow * flow_x + push_x
    wish[1] = cohesion * pull_y + follow * flow_y + push_y
    share = parameters[FLOCK_TOP_WEIGHT]
    wanted = (1.0 - share) * rise / rises + share * top - parameters[FLOCK_BELOW]
    wish[2] = parameters[FLOCK_HEIGHT_GAIN] * wanted


@portable_inlined
def _close_gaps(
    ego: FloatArray, known: int, memory: FloatArray, parameters: FloatArray, wish: FloatArray
) -> None:
    """Pull towards far neighbours that nobody else is between.

    Such pairs hold the flock together: if none of them parts, it stays in one piece. Nobody is between two if
    nobody is nearer to both than they are to each other.

    Source: the relative neighbourhood graph, G. T. Toussaint, 1980; it contains a shortest spanning tree.
    """
    for index in range(known):
        row = FLOCK_VIEW + index * FLOCK_VIEW_SIZE
        x, y = memory[row], memory[row + 1]
        square = x * x + y * y
        gap = math.sqrt(square) - parameters[FLOCK_LINK_LENGTH]
        if gap <= 0.0:
            continue
        linked = True
        for other in range(known):
            between = FLOCK_VIEW + other * FLOCK_VIEW_SIZE
            ox, oy = memory[between], memory[between + 1]
            dx, dy = ox - x, oy - y
            if other != index and ox * ox + oy * oy < square and dx * dx + dy * dy < square:
                linked = False
                break
        if linked:
            distance = math.sqrt(square)
            pull = memory[row + 5] * parameters[FLOCK_LINK] * gap / distance
            # Those behind close the gap themselves.
            ahead = (x * ego[EGO_V] + y * ego[EGO_V + 1]) / distance
            pull *= min(max(1.0 + parameters[FLOCK_LINK_BEHIND] * ahead, _LEAST_LINK), 1.0)
            wish[0] += pull * x
            wish[1] += pull * y


@portable_inlined
def _total_velocity(ego: FloatArray, known: int, memory: FloatArray) -> tuple[float, float]:
    """Return the sum of the velocities of the own vehicle and all neighbours, m/s."""
    total_x, total_y = ego[EGO_V], ego[EGO_V + 1]
    for index in range(known):
        row = FLOCK_VIEW + index * FLOCK_VIEW_SIZE
        total_x += memory[row + 3]
        total_y += memory[row + 4]
    return total_x, total_y


@portable_inlined
def _step_aside(
    row: int, ego: FloatArray, rest_x: float, rest_y: float, memory: FloatArray, parameters: FloatArray
) -> tuple[float, float]:
    """Return a velocity away from where a neighbour will pass, if it comes at us against the flock's motion.

    Whoever flies with the flock looks after itself. A leader that turns back does not, and leaves a second to
    get out of its way: it is reckoned with the velocity that it will soon have.

    Args:
        row: of the neighbour in the view.
        ego: the own state.
        rest_x: mean velocity of the flock without that neighbour, m/s.
        rest_y: likewise.
        memory: with the view, and what was wanted last.
        parameters: of the law.
    """
    longest, room = parameters[FLOCK_DODGE_TIME], parameters[FLOCK_DODGE_ROOM]
    x, y = memory[row], memory[row + 1]
    vx = memory[row + 3] + parameters[FLOCK_FORESIGHT] * memory[row + 6]
    vy = memory[row + 4] + parameters[FLOCK_FORESIGHT] * memory[row + 7]
    wx, wy = vx - ego[EGO_V], vy - ego[EGO_V + 1]
    speed_squared = wx * wx + wy * wy
    closing = -(x * wx + y * wy)
    if closing <= 0.0 or speed_squared < 0.01 or longest <= 0.0:
        return 0.0, 0.0
    soon = closing / speed_squared
    if soon >= longest:
        return 0.0, 0.0
    miss_x, miss_y = x + soon * wx, y + soon * wy
    miss = math.sqrt(miss_x * miss_x + miss_y * miss_y)
    if miss >= room:
        return 0.0, 0.0
    distance = max(math.sqrt(x * x + y * y), _SAME_PLACE_M)
    against = -((vx - rest_x) * x + (vy - rest_y) * y) / distance
    size = min(max(against / parameters[FLOCK_DODGE_FULL], 0.0), 1.0)
    # A little even from who comes slowly: a leader that sets out through the flock.
    share = max(2.0 * size - 1.0, _LEAST_SHARE * size * size)
    strength = parameters[FLOCK_DODGE] * share * (1.0 - miss / room) * (1.0 - soon / longest)
    # The side is that of where we are about to fly: by the own velocity, which lags behind, errors of the
    # other's would turn us back and forth. If it comes straight at us, both pass on the same hand.
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    sx = vx - cos_yaw * memory[FLOCK_WISH] - sin_yaw * memory[FLOCK_WISH + 1]
    sy = vy - cos_yaw * memory[FLOCK_WISH + 1] + sin_yaw * memory[FLOCK_WISH]
    if x * sy - y * sx > _STRAIGHT_M * math.sqrt(sx * sx + sy * sy):
        strength = -strength
    speed = math.sqrt(speed_squared)
    return strength * wy / speed, -strength * wx / speed


@portable_inlined
def _coast(ego: FloatArray, memory: FloatArray, parameters: FloatArray, wish: FloatArray) -> None:
    """Nobody is known: go on as before for a while, and look for the others at the usual height."""
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    keep = math.exp(-ego[EGO_DT] / max(parameters[FLOCK_COAST], 1e-3))
    vx, vy = memory[FLOCK_WISH], memory[FLOCK_WISH + 1]
    wish[0] = keep * (cos_yaw * vx + sin_yaw * vy)
    wish[1] = keep * (cos_yaw * vy - sin_yaw * vx)
    wish[2] = 0.0
    if ego[EGO_ALONE] > _RECOVERY_AFTER_S:
        wish[2] = parameters[RECOVERY_HEIGHT] - ego[EGO_HEIGHT]


@portable_inlined
def _flow_round(memory: FloatArray, parameters: FloatArray, wish: FloatArray) -> None:
    """Add a push away from near columns."""
    reach, radius = parameters[FLOCK_FLOW_REACH], parameters[FLOCK_BODY_RADIUS]
    for column in range(AZIMUTHS):
        room = max(memory[FLOCK_COLUMNS + column] - radius, _LEAST_GAP_M)
        if room < reach:
            cosine, sine = direction_of(column)
            strength = parameters[FLOCK_FLOW] * (1.0 / room - 1.0 / reach) / _FLOW_COLUMNS
            wish[0] -= strength * cosine
            wish[1] -= strength * sine


@portable_inlined
def _limit_speed(parameters: FloatArray, wish: FloatArray) -> None:
    speed = math.sqrt(wish[0] * wish[0] + wish[1] * wish[1])
    if speed > parameters[MAX_SPEED]:
        wish[0] *= parameters[MAX_SPEED] / speed
        wish[1] *= parameters[MAX_SPEED] / speed


@portable_inlined
def _remember_wish(ego: FloatArray, memory: FloatArray, wish: FloatArray) -> None:
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    memory[FLOCK_WISH] = cos_yaw * wish[0] - sin_yaw * wish[1]
    memory[FLOCK_WISH + 1] = sin_yaw * wish[0] + cos_yaw * wish[1]
