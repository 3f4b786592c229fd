"""What a vehicle perceives: late, noisy, held between scans, and only what is in view.

A follower's knowledge of another vehicle is a row of `TRACK_WIDTH` numbers: position and velocity in the
world as measured, own position and velocity when they were, the time for which they hold, the time of the
last sighting since it is known, sightings in a row, whether it is known at all, and the errors of position
and velocity in units of their standard deviation.

Scalar arithmetic only, in the common subset of compilers for processors and graphics cards.
"""

import math

import numpy as np

from companion.compiled import portable, portable_inlined
from companion.messages import FloatArray
from sitl.abstract import layout_kernels as place
from sitl.abstract.grid_kernels import AN_OBSTACLE, KNOWN, LEFT_OUT, IndexArray, draw_grid
from sitl.abstract.random_kernels import normal_pair, stream, uniform
from sitl.abstract.sight_kernels import sees, up_of, yaw_of

OWN_P, OWN_V, T_VALID, T_SEEN, STREAK, IS_KNOWN, ERRORS = 6, 9, 12, 13, 14, 15, 16
TRACK_WIDTH = 22

_SIGHT_STREAM, _OWN_STREAM = 1, 2
_DROPOUT_DRAW = 64
_NO_MEMORY_S = 1e-6


@portable_inlined
def past(history: FloatArray, step: int, delay: int) -> int:
    """Return the row of the history that held `delay` steps ago; the first state before there was any."""
    return int(max(step - delay, 0) % history.shape[0])


@portable(
    "void(uint64, int64, int64, float64[:,:,::1], int32[::1], float64[:,::1], float64[:,::1], int32[::1],"
    " int64, float64[::1], float64[:,::1])"
)
def look_around(
    seed: np.uint64,
    i: int,
    step: int,
    history: FloatArray,
    kinds: IndexArray,
    rows: FloatArray,
    discs: FloatArray,
    candidates: IndexArray,
    count: int,
    parameters: FloatArray,
    tracks: FloatArray,
) -> None:
    """Bring one follower's knowledge of the others up to date with the scan that arrives now.

    Args:
        seed: of the trial.
        i: whose knowledge.
        step: number of the control step.
        history: (h, n, 10) recent positions, velocities and attitudes, step k in row k mod h.
        kinds: (m,) kind of each primitive.
        rows: (m, 8) its shape.
        discs: (m, 3) its enclosing vertical cylinder.
        candidates: primitives that may be near, the first `count` of them.
        count: how many.
        parameters: see `sitl.abstract.layout_kernels`.
        tracks: (n, 22) what i knows of each, changed in place.
    """
    delay = int(parameters[place.NEIGHBOUR_DELAY])
    states = history[past(history, step, delay)]
    t_valid = (step - delay) * parameters[place.CONTROL_STEP]
    for j in range(states.shape[0]):
        if j == i:
            continue
        seen = sees(
            i, j, states, kinds, rows, discs, candidates, count, parameters[place.SIGHT_RANGE],
            parameters[place.SIGHT_LOWEST], parameters[place.SIGHT_HIGHEST], parameters[place.BODY_RADIUS],
            int(parameters[place.FREE_RAYS]),
        )  # fmt: skip
        track = tracks[j]
        chance = stream(seed, step, i * states.shape[0] + j, _SIGHT_STREAM)
        distance = 0.0
        for axis in range(3):
            distance += (states[j, axis] - states[i, axis]) ** 2
        distance = math.sqrt(distance)
        if seen:
            share = distance / parameters[place.SIGHT_RANGE]
            missed = parameters[place.DROPOUT] + parameters[place.DROPOUT_FAR] * share * share
            seen = not (missed > 0.0 and uniform(chance, _DROPOUT_DRAW) < missed)
        if not seen:
            track[STREAK] = 0.0
            if t_valid - track[T_SEEN] > parameters[place.COAST] - 1e-9:
                track[IS_KNOWN] = 0.0
            continue
        # Whoever hovers beside others before the trial begins knows them by then.
        track[STREAK] = track[STREAK] + 1.0 if step > 0 else parameters[place.SIGHTINGS]
        if track[STREAK] >= parameters[place.SIGHTINGS]:
            track[IS_KNOWN] = 1.0
        # Errors fade exponentially; those of a new neighbour, or without memory, are fresh.
        gap = math.inf
        if track[STREAK] > 1.0 and step > 0:
            gap = parameters[place.SCAN_STEPS] * parameters[place.CONTROL_STEP]
        kept_p = math.exp(-gap / max(parameters[place.POSITION_MEMORY], _NO_MEMORY_S))
        kept_v = math.exp(-gap / max(parameters[place.VELOCITY_MEMORY], _NO_MEMORY_S))
        sigma_p = parameters[place.POSITION_SIGMA] + parameters[place.POSITION_SIGMA_FAR] * distance
        sigma_v = parameters[place.VELOCITY_SIGMA] + parameters[place.VELOCITY_SIGMA_FAR] * distance
        for pair in range(3):
            first, second = normal_pair(chance, pair)
            for part in range(2):
                axis = 2 * pair + part
                kept, sigma = (kept_p, sigma_p) if axis < 3 else (kept_v, sigma_v)
                fresh = math.sqrt(1.0 - kept * kept) * (first if part == 0 else second)
                track[ERRORS + axis] = kept * track[ERRORS + axis] + fresh
                track[axis] = states[j, axis] + sigma * track[ERRORS + axis]
        for axis in range(6):
            track[OWN_P + axis] = states[i, axis]
        track[T_VALID] = t_valid
        if track[IS_KNOWN] > 0.0:
            track[T_SEEN] = t_valid


@portable(
    "void(int64, int64, float64[:,:,::1], int32[::1], float64[:,::1], float64[:,::1], int32[::1], int64,"
    " float64[::1], float64[::1], float64[:,::1], float64[:,::1], float64[:,::1], float64[:,::1],"
    " float64[:,::1], uint8[::1], float64[::1], float64[:,::1])"
)
def look_at_obstacles(
    i: int,
    step: int,
    history: FloatArray,
    kinds: IndexArray,
    rows: FloatArray,
    discs: FloatArray,
    candidates: IndexArray,
    count: int,
    parameters: FloatArray,
    limits: FloatArray,
    azimuth_rays: FloatArray,
    elevation_rays: FloatArray,
    column_edges: FloatArray,
    row_edges: FloatArray,
    tracks: FloatArray,
    roles: np.ndarray[tuple[int], np.dtype[np.uint8]],
    up_heading: FloatArray,
    ranges: FloatArray,
) -> None:
    """Draw the obstacle grid (columns, rows) that reaches follower i now; the rest as for `look_around`.

    `limits` and the four tables are those of `grid_kernels.draw_grid`; `roles` (n,) and `up_heading` (3,)
    are scratch.
    """
    states = history[past(history, step, int(parameters[place.GRID_DELAY]))]
    for j in range(states.shape[0]):
        roles[j] = KNOWN if tracks[j, IS_KNOWN] > 0.0 else AN_OBSTACLE
    roles[i] = LEFT_OUT
    yaw = yaw_of(states[i, 6:10])
    ux, uy, uz = up_of(states[i, 6:10])
    up_heading[0] = math.cos(yaw) * ux + math.sin(yaw) * uy
    up_heading[1] = math.cos(yaw) * uy - math.sin(yaw) * ux
    up_heading[2] = uz
    draw_grid(
        kinds, rows, discs, candidates, count, states, roles, parameters[place.BODY_RADIUS],
        states[i, 0], states[i, 1], states[i, 2], yaw, up_heading, limits, azimuth_rays, elevation_rays,
        column_edges, row_edges, ranges,
    )  # fmt: skip


@portable_inlined
def _put(row: FloatArray, at: int, x: float, y: float, z: float, cosine: float, sine: float) -> None:
    row[at] = cosine * x + sine * y
    row[at + 1] = cosine * y - sine * x
    row[at + 2] = z


@portable_inlined
def _sort_in(rows: FloatArray, filled: int, most: int, square: float, j: int) -> int:
    """Keep the nearest, each with its squared distance and number; return how many are kept.

    Of equally near ones those that come first stay in front.
    """
    at = filled
    while at > 0 and rows[at - 1, 0] > square:
        if at < most:
            rows[at, 0], rows[at, 7] = rows[at - 1, 0], rows[at - 1, 7]
        at -= 1
    if at < most:
        rows[at, 0], rows[at, 7] = square, j
    return min(filled + 1, most)


@portable(
    "void(uint64, int64, int64, float64[:,:,::1], float64[::1], float64[:,::1], float64[::1], float64[:,::1])"
)
def observe(
    seed: np.uint64,
    i: int,
    step: int,
    history: FloatArray,
    parameters: FloatArray,
    tracks: FloatArray,
    ego: FloatArray,
    neighbours: FloatArray,
) -> None:
    """Fill what a follower's law is given: its own motion and its nearest neighbours.

    Args:
        seed: of the trial.
        i: whose view.
        step: number of the control step.
        history: (h, n, 10) recent states.
        parameters: see `sitl.abstract.layout_kernels`.
        tracks: (n, 22) what i knows of each.
        ego: (10,) out: position, velocity in the heading frame, heading, height, step s, seconds since
            anybody was perceived; the last is kept here from step to step.
        neighbours: (k, 8) out: relative position and velocity in the heading frame, 1, number; nearest
            first, zeros where nobody is.
    """
    dt = parameters[place.CONTROL_STEP]
    compensate = parameters[place.COMPENSATE] > 0.5
    own_delay = 0 if compensate else int(parameters[place.EGO_DELAY])
    own = history[past(history, step, own_delay), i]
    chance = stream(seed, step, i, _OWN_STREAM)
    a, b = normal_pair(chance, 0)
    c, _ = normal_pair(chance, 1)
    sigma = parameters[place.EGO_VELOCITY_SIGMA]
    vx, vy, vz = own[3] + sigma * a, own[4] + sigma * b, own[5] + sigma * c
    yaw = yaw_of(own[6:10])
    cosine, sine = math.cos(yaw), math.sin(yaw)
    for axis in range(3):
        ego[axis] = own[axis]
    _put(ego, 3, vx, vy, vz, cosine, sine)
    ego[6] = yaw
    ego[7] = own[2] - parameters[place.GROUND]
    ego[8] = dt
    anybody = False
    for j in range(tracks.shape[0]):
        anybody = anybody or tracks[j, IS_KNOWN] > 0.0
    ego[9] = 0.0 if anybody else ego[9] + dt
    now = step * dt
    most = min(int(parameters[place.NEIGHBOUR_COUNT]), neighbours.shape[0])
    filled = 0
    for j in range(tracks.shape[0]):
        track = tracks[j]
        if track[IS_KNOWN] == 0.0:
            continue
        age = now - track[T_VALID] if compensate else 0.0
        square = 0.0
        for axis in range(3):
            origin = own[axis] if compensate else track[OWN_P + axis]
            square += (track[axis] + age * track[3 + axis] - origin) ** 2
        if square < math.inf:
            filled = _sort_in(neighbours, filled, most, square, j)
    for row in range(filled, neighbours.shape[0]):
        for column in range(neighbours.shape[1]):
            neighbours[row, column] = 0.0
    for row in range(filled):
        best_j = int(neighbours[row, 7])
        track, row_of = tracks[best_j], neighbours[row]
        if compensate:
            age = now - track[T_VALID]
            _put(
                row_of, 0, track[0] + age * track[3] - own[0], track[1] + age * track[4] - own[1],
                track[2] + age * track[5] - own[2], cosine, sine,
            )  # fmt: skip
            _put(row_of, 3, track[3] - vx, track[4] - vy, track[5] - vz, cosine, sine)
        else:
            _put(row_of, 0, track[0] - track[6], track[1] - track[7], track[2] - track[8], cosine, sine)
            _put(row_of, 3, track[3] - track[9], track[4] - track[10], track[5] - track[11], cosine, sine)
        row_of[6] = 1.0
        row_of[7] = best_j
