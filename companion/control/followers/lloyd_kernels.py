"""The `lloyd` law: fly to the centroid of one's own cell, weighted towards where the flock goes.

The cell is a disc cut by half-planes: between two vehicles half-way, or nearer where they would be closer
than their spacing; before obstacles where there is just room. While the vehicle is stuck the weight narrows,
and the goal turns to the right.

Source: the rule-based Lloyd algorithm of M. Boldrer et al., 2023, and its use for flocking, arXiv 2504.18840;
the goal is what a follower has instead: the neighbours' mean, and where they are going.
"""

import math

from companion.compiled import portable_inlined
from companion.control.followers.layout_kernels import (
    AZIMUTHS,
    EGO_DT,
    EGO_V,
    LLOYD_GAIN,
    LLOYD_HINDERED,
    LLOYD_LEAST_SPREAD,
    LLOYD_LOOK_AHEAD,
    LLOYD_OBSTACLE_ROOM,
    LLOYD_RADIUS,
    LLOYD_RETREAT,
    LLOYD_SPACING,
    LLOYD_SPREAD,
    LLOYD_STUCK,
    PLAIN_COLUMNS,
    PLAIN_STATE,
    ROW_P,
    ROW_PRESENT,
    ROW_V,
    STARTED,
)
from companion.control.followers.sensing_kernels import direction_of, find_columns_up_to
from companion.messages import FloatArray

_HIGHEST_RAD = math.radians(20.0)
_RAYS = 36
_STEPS = 8
_LEAST_DISTANCE_M = 1e-3
_TURN_PER_S = 1.0
_LARGEST_TURN = 0.5 * math.pi
_TURNED_ENOUGH = 0.95 * _LARGEST_TURN


@portable_inlined
def lloyd(
    ego: FloatArray,
    neighbours: FloatArray,
    ranges: FloatArray,
    memory: FloatArray,
    parameters: FloatArray,
    wish: FloatArray,
) -> None:
    """Write the horizontal velocity that `lloyd` wants into `wish`, in the heading frame, m/s."""
    if memory[STARTED] < 0.5:
        memory[PLAIN_STATE] = parameters[LLOYD_SPREAD]
        memory[PLAIN_STATE + 1] = 0.0
    find_columns_up_to(ranges, _HIGHEST_RAD, memory, PLAIN_COLUMNS)
    count, gx, gy = 0, 0.0, 0.0
    ahead = parameters[LLOYD_LOOK_AHEAD]
    for row in range(neighbours.shape[0]):
        if neighbours[row, ROW_PRESENT] < 0.5:
            continue
        count += 1
        gx += neighbours[row, ROW_P] + ahead * (neighbours[row, ROW_V] + ego[EGO_V])
        gy += neighbours[row, ROW_P + 1] + ahead * (neighbours[row, ROW_V + 1] + ego[EGO_V + 1])
    if count > 0:
        gx, gy = gx / count, gy / count
    spread, turn = memory[PLAIN_STATE], memory[PLAIN_STATE + 1]
    cos_turn, sin_turn = math.cos(turn), math.sin(turn)
    tx, ty = cos_turn * gx + sin_turn * gy, cos_turn * gy - sin_turn * gx
    cx, cy, free_x, free_y = _centroid(tx, ty, spread, neighbours, memory, parameters)
    _adapt(math.hypot(cx, cy), math.hypot(cx - free_x, cy - free_y), ego[EGO_DT], memory, parameters)
    if memory[PLAIN_STATE + 1] > _TURNED_ENOUGH:
        straight_x, straight_y, _fx, _fy = _centroid(gx, gy, spread, neighbours, memory, parameters)
        if math.hypot(cx, cy) > math.hypot(straight_x, straight_y):
            memory[PLAIN_STATE + 1] = 0.0
    wish[0] = parameters[LLOYD_GAIN] * cx
    wish[1] = parameters[LLOYD_GAIN] * cy
    _retreat(neighbours, memory, parameters, wish)


@portable_inlined
def _adapt(
    to_centroid: float, hindrance: float, dt: float, memory: FloatArray, parameters: FloatArray
) -> None:
    """Narrow the weight and turn the goal while the vehicle is stuck; let both return otherwise."""
    stuck = to_centroid < parameters[LLOYD_STUCK] and hindrance > parameters[LLOYD_HINDERED]
    spread, turn = memory[PLAIN_STATE], memory[PLAIN_STATE + 1]
    goal = parameters[LLOYD_LEAST_SPREAD] if stuck else parameters[LLOYD_SPREAD]
    memory[PLAIN_STATE] = spread + min(dt, 1.0) * (goal - spread)
    target = _LARGEST_TURN if stuck else 0.0
    memory[PLAIN_STATE + 1] = turn + min(_TURN_PER_S * dt, 1.0) * (target - turn)


@portable_inlined
def _boundary_of_neighbour(distance: float, spacing: float) -> float:
    """Return how far a cell reaches towards a neighbour; negative where it is too near already."""
    return min(0.5 * distance, distance - spacing)


@portable_inlined
def _reach(
    cos_ray: float, sin_ray: float, neighbours: FloatArray, memory: FloatArray, parameters: FloatArray
) -> float:
    """Return how far the cell reaches along a ray."""
    reach: float = parameters[LLOYD_RADIUS]
    for row in range(neighbours.shape[0]):
        if neighbours[row, ROW_PRESENT] < 0.5:
            continue
        x, y = neighbours[row, ROW_P], neighbours[row, ROW_P + 1]
        distance = max(math.hypot(x, y), _LEAST_DISTANCE_M)
        along = (x * cos_ray + y * sin_ray) / distance
        if along > 0.0:
            reach = min(reach, max(_boundary_of_neighbour(distance, parameters[LLOYD_SPACING]), 0.0) / along)
    for column in range(AZIMUTHS):
        distance = memory[PLAIN_COLUMNS + column]
        room = max(distance - parameters[LLOYD_OBSTACLE_ROOM], 0.0)
        if not room < reach:
            continue
        cosine, sine = direction_of(column)
        along = cosine * cos_ray + sine * sin_ray
        if along > 0.0:
            reach = min(reach, room / along)
    return reach


@portable_inlined
def _centroid(
    gx: float, gy: float, spread: float, neighbours: FloatArray, memory: FloatArray, parameters: FloatArray
) -> tuple[float, float, float, float]:
    """Return the weighted centroid of the cell, and that of the whole disc."""
    mass, mass_x, mass_y = 0.0, 0.0, 0.0
    disc, disc_x, disc_y = 0.0, 0.0, 0.0
    radius = parameters[LLOYD_RADIUS]
    # The nearest point of the disc to the goal has weight one, so that far goals do not vanish.
    nearest = max(math.hypot(gx, gy) - radius, 0.0)
    for ray in range(_RAYS):
        angle = 2.0 * math.pi * (ray + 0.5) / _RAYS
        cos_ray, sin_ray = math.cos(angle), math.sin(angle)
        reach = _reach(cos_ray, sin_ray, neighbours, memory, parameters)
        for step in range(_STEPS):
            r = (step + 0.5) / _STEPS * reach
            x, y = r * cos_ray, r * sin_ray
            weight = r * reach * math.exp((nearest - math.hypot(x - gx, y - gy)) / spread)
            mass, mass_x, mass_y = mass + weight, mass_x + weight * x, mass_y + weight * y
            r = (step + 0.5) / _STEPS * radius
            x, y = r * cos_ray, r * sin_ray
            weight = r * radius * math.exp((nearest - math.hypot(x - gx, y - gy)) / spread)
            disc, disc_x, disc_y = disc + weight, disc_x + weight * x, disc_y + weight * y
    if mass <= 1e-12 or disc <= 1e-12:
        return 0.0, 0.0, 0.0, 0.0
    return mass_x / mass, mass_y / mass, disc_x / disc, disc_y / disc


@portable_inlined
def _retreat(neighbours: FloatArray, memory: FloatArray, parameters: FloatArray, wish: FloatArray) -> None:
    """Give way where something is inside the boundary of the cell already."""
    rate = parameters[LLOYD_RETREAT]
    for row in range(neighbours.shape[0]):
        if neighbours[row, ROW_PRESENT] < 0.5:
            continue
        x, y = neighbours[row, ROW_P], neighbours[row, ROW_P + 1]
        distance = max(math.hypot(x, y), _LEAST_DISTANCE_M)
        missing = max(-_boundary_of_neighbour(distance, parameters[LLOYD_SPACING]), 0.0)
        wish[0] -= rate * missing * x / distance
        wish[1] -= rate * missing * y / distance
    nearest = 0
    for column in range(AZIMUTHS):
        if memory[PLAIN_COLUMNS + column] < memory[PLAIN_COLUMNS + nearest]:
            nearest = column
    missing = max(parameters[LLOYD_OBSTACLE_ROOM] - memory[PLAIN_COLUMNS + nearest], 0.0)
    if missing > 0.0:
        cosine, sine = direction_of(nearest)
        wish[0] -= rate * missing * cosine
        wish[1] -= rate * missing * sine
