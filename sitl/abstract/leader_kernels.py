"""The leader's flight along a route that is known beforehand: its own rules, without map and search.

The same mission, pure pursuit and potential field as `companion.control.leader`, in scalar code.
"""

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import portable, portable_inlined
from companion.control.leader.field_kernels import find_nearest, repulsion
from companion.control.leader.rrt_kernels import clearance_at, locate, point_at, segment_free
from companion.messages import FloatArray

# Places in the leader's memory.
WAYPOINT, PHASE, PAUSE_START, ALONG, FILTER, SIDE, RAN = 0, 1, 2, 3, 4, 7, 8
LEADER_WIDTH = 9
WAITING, FLYING, PAUSING, FINISHED = 0.0, 1.0, 2.0, 3.0

# Places in the array of its settings.
(
    RADIUS, SPEED, MAX_SPEED, WAIT, RAMP, ARRIVAL, BRAKE_GAIN, VERTICAL_GAIN, MAX_VERTICAL, LOOK_AHEAD,
    ATTRACTION, REPULSION, REPULSION_DISTANCE, MAX_REPULSION, ESCAPE, LEAST_DRIVE, SPEED_PER_ROOM,
    LEAST_SPEED, PREDICTION, LOW_PASS, MAX_ACCELERATION, CORNER_X, CORNER_Y, CELL,
) = range(24)  # fmt: skip
N_LEADER_PARAMETERS = 24

_BACKWARD_M, _FORWARD_M = 0.5, 3.0
_CLEARANCE_SLACK_M = 0.15
_LEAST_LOOK_AHEAD_M = 0.4
_BEYOND_M = 3.0
_NO_DIRECTION = 1e-9


@portable_inlined
def _move_on(t: float, p: FloatArray, waypoints: FloatArray, holds: FloatArray, rules: FloatArray,
             memory: FloatArray) -> None:  # fmt: skip
    """Advance the mission: `companion.control.leader.mission.Mission.update`."""
    last = waypoints.shape[0] - 1
    if memory[PHASE] == WAITING and t >= rules[WAIT] - 1e-9:
        memory[PHASE] = FLYING
    index = int(memory[WAYPOINT])
    if memory[PHASE] == FLYING:
        dx, dy, dz = waypoints[index, 0] - p[0], waypoints[index, 1] - p[1], waypoints[index, 2] - p[2]
        if math.sqrt(dx * dx + dy * dy + dz * dz) < rules[ARRIVAL]:
            if holds[index] > 0.0 or index == last:
                memory[PHASE] = PAUSING
                memory[PAUSE_START] = t
            else:
                memory[WAYPOINT] += 1.0
                memory[ALONG] = 0.0
    index = int(memory[WAYPOINT])
    if memory[PHASE] == PAUSING and t - memory[PAUSE_START] >= holds[index] - 1e-9:
        if index == last:
            memory[PHASE] = FINISHED
        else:
            memory[PHASE] = FLYING
            memory[WAYPOINT] += 1.0
            memory[ALONG] = 0.0


@portable_inlined
def _along_path(
    x: float, y: float, speed: float, goal_distance: float, leg: FloatArray, clearance: float,
    granted: FloatArray, distance: NDArray[np.float32], blocked: NDArray[np.uint8],
    surface: NDArray[np.float32], first: NDArray[np.int64], rules: FloatArray, memory: FloatArray,
    sectors: FloatArray,
) -> tuple[float, float]:  # fmt: skip
    """Return the horizontal velocity along the path: `Route.ahead` and `PotentialField.velocity`."""
    x0, y0, cell = rules[CORNER_X], rules[CORNER_Y], rules[CELL]
    memory[ALONG], _, _ = locate(leg, x, y, memory[ALONG] - _BACKWARD_M, memory[ALONG] + _FORWARD_M)
    wanted = clearance - _CLEARANCE_SLACK_M
    here = clearance_at(distance, x0, y0, cell, x, y)
    granted[0, 0], granted[0, 1], granted[0, 2] = x, y, here - _CLEARANCE_SLACK_M
    look = rules[LOOK_AHEAD]
    while True:
        ax, ay = point_at(leg, memory[ALONG] + look)
        is_open = segment_free(distance, x0, y0, cell, x, y, ax, ay, wanted, granted)
        if is_open or look <= _LEAST_LOOK_AHEAD_M:
            break
        look = max(0.75 * look, _LEAST_LOOK_AHEAD_M)
    room = min(here, clearance_at(distance, x0, y0, cell, ax, ay)) - rules[RADIUS]
    speed = min(speed, max(rules[SPEED_PER_ROOM] * room, rules[LEAST_SPEED]))
    dx, dy = ax - x, ay - y
    left = math.sqrt(dx * dx + dy * dy)
    if left > _NO_DIRECTION:
        dx, dy = dx / left, dy / left
    else:
        dx, dy = 0.0, 0.0
    find_nearest(blocked, surface, first, cell, x, y, rules[REPULSION_DISTANCE] + rules[RADIUS], sectors)
    push_x, push_y = repulsion(
        sectors, rules[RADIUS], rules[REPULSION], rules[REPULSION_DISTANCE], rules[MAX_REPULSION]
    )
    # Close to the goal obstacles must not hold the vehicle off it.
    share = min(1.0, goal_distance / rules[REPULSION_DISTANCE])
    push_x, push_y = push_x * share, push_y * share
    fx, fy = rules[ATTRACTION] * dx + push_x, rules[ATTRACTION] * dy + push_y
    push = math.sqrt(push_x * push_x + push_y * push_y)
    drive = fx * dx + fy * dy
    if is_open:
        more = max(rules[LEAST_DRIVE] - drive, 0.0)
        fx, fy = fx + more * dx, fy + more * dy
        memory[SIDE] = 0.0
    elif push > _NO_DIRECTION and drive < rules[ESCAPE]:
        tx, ty = -push_y / push, push_x / push
        if memory[SIDE] == 0.0:
            bx, by = point_at(leg, memory[ALONG] + rules[LOOK_AHEAD] + _BEYOND_M)
            memory[SIDE] = 1.0 if tx * (bx - x) + ty * (by - y) >= 0.0 else -1.0
        fx, fy = fx + memory[SIDE] * tx, fy + memory[SIDE] * ty
    else:
        memory[SIDE] = 0.0
    scale = speed / max(1.0, math.sqrt(fx * fx + fy * fy))
    return scale * fx, scale * fy


@portable(
    "void(float64, float64, float64[::1], float64[:,::1], float64[::1], float64[:,:,::1], float64[:,:,::1],"
    " float64[::1], float32[:,::1], uint8[:,::1], float32[:,:,::1], int64[::1], float64[::1], float64[::1],"
    " float64[:,::1], float64[:,::1], float64[::1])"
)
def lead(
    t: float,
    dt: float,
    state: FloatArray,
    waypoints: FloatArray,
    holds: FloatArray,
    legs: FloatArray,
    ends: FloatArray,
    clearances: FloatArray,
    distance: NDArray[np.float32],
    blocked: NDArray[np.uint8],
    surface: NDArray[np.float32],
    first: NDArray[np.int64],
    rules: FloatArray,
    memory: FloatArray,
    sectors: FloatArray,
    granted: FloatArray,
    command: FloatArray,
) -> None:
    """Say how the leader flies now: `companion.control.leader.planner.LeaderPlanner.decide`.

    Args:
        t: time since the start, s.
        dt: since the last call, s.
        state: (10,) its position, velocity and attitude, world.
        waypoints: (k, 3) its way, m.
        holds: (k,) pause at each, s.
        legs: (k, r, 2) path to each waypoint; the last point is repeated to fill the row.
        ends: (k, 2, 3) first and last point of each path with the clearance found there.
        clearances: (k,) room that each path keeps, m.
        distance: clearance field of the flight plane, see `ClearanceField`.
        blocked: its columns.
        surface: where in them the obstacle is.
        first: its lowest voxel.
        rules: the leader's settings in the order of the constants above.
        memory: (9,) what it remembers, changed in place.
        sectors: (s, 3) scratch.
        granted: (2, 3) scratch.
        command: (3,) out, velocity in the world, m/s.
    """
    _move_on(t, state, waypoints, holds, rules, memory)
    # The first call finds the filter at rest, as after a reset.
    step_s = dt if memory[RAN] > 0.5 else 0.0
    memory[RAN] = 1.0
    tx, ty, tz = 0.0, 0.0, 0.0
    if memory[PHASE] != WAITING:
        index = int(memory[WAYPOINT])
        x, y = state[0] + rules[PREDICTION] * state[3], state[1] + rules[PREDICTION] * state[4]
        z = state[2] + rules[PREDICTION] * state[5]
        granted[0, 2] = granted[1, 2] = math.inf
        x0, y0, cell = rules[CORNER_X], rules[CORNER_Y], rules[CELL]
        if not segment_free(distance, x0, y0, cell, state[0], state[1], x, y, rules[RADIUS], granted):
            x, y, z = state[0], state[1], state[2]
        gx, gy = waypoints[index, 0] - x, waypoints[index, 1] - y
        left = math.sqrt(gx * gx + gy * gy)
        moving = t - rules[WAIT]
        speed = rules[SPEED] * (min(1.0, moving / rules[RAMP]) if rules[RAMP] > 0.0 else 1.0)
        if holds[index] > 0.0 or index == waypoints.shape[0] - 1:
            speed = min(speed, rules[BRAKE_GAIN] * left)
        climb = rules[VERTICAL_GAIN] * (waypoints[index, 2] - z)
        tz = min(max(climb, -rules[MAX_VERTICAL]), rules[MAX_VERTICAL])
        if memory[PHASE] != FLYING:
            share = min(1.0, speed / left) if left > 0.0 else 0.0
            tx, ty = share * gx, share * gy
        else:
            for axis in range(3):
                granted[1, axis] = ends[index, 1, axis]
            tx, ty = _along_path(
                x, y, speed, left, legs[index], clearances[index], granted, distance, blocked, surface,
                first, rules, memory, sectors,
            )  # fmt: skip
        size = math.sqrt(tx * tx + ty * ty + tz * tz)
        if size > rules[MAX_SPEED]:
            share = rules[MAX_SPEED] / size
            tx, ty, tz = tx * share, ty * share, tz * share
    gain = -math.expm1(-step_s / rules[LOW_PASS]) if rules[LOW_PASS] > 0.0 else 1.0
    cx, cy, cz = gain * (tx - memory[4]), gain * (ty - memory[5]), gain * (tz - memory[6])
    size = math.sqrt(cx * cx + cy * cy + cz * cz)
    limit = rules[MAX_ACCELERATION] * step_s
    share = limit / size if size > limit else 1.0
    memory[4] += share * cx
    memory[5] += share * cy
    memory[6] += share * cz
    for axis in range(3):
        command[axis] = memory[FILTER + axis]
