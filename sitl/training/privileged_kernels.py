"""The truth about a follower's situation, which critics may see and policies never.

Scalar arithmetic only, in the common subset of compilers for processors and graphics cards.
"""

import math

from companion.compiled import portable, portable_inlined
from companion.messages import Float32Array, FloatArray
from sitl.abstract.grid_kernels import IndexArray
from sitl.abstract.sight_kernels import yaw_of
from sitl.worlds.clearance_kernels import distance_to_primitive

# Places: leader (relative position, relative velocity), four nearest others (relative position, speed of
# approach), middle of the flock, direction of and distance to the nearest surface, own height, time left,
# size of the flock.
LEADER_P, LEADER_V, OTHERS, MIDDLE, SURFACE, ROOM, HEIGHT, TIME_LEFT, SIZE = 0, 3, 6, 22, 25, 28, 29, 30, 31
PRIVILEGED_SIZE = 32
OTHERS_SHOWN = 4

_DISTANCE_M = 5.0
_SPEED_MPS = 2.0
_HEIGHT_M = 2.0
_TIME_S = 30.0
_MOST_FOLLOWERS = 10.0
_ROOM_M = 3.0
_TINY_M = 1e-3


@portable_inlined
def _turned(
    x: float, y: float, z: float, cosine: float, sine: float, scale: float, out: Float32Array, at: int
) -> None:
    """Write a vector of the world in the heading frame."""
    out[at] = (cosine * x + sine * y) / scale
    out[at + 1] = (cosine * y - sine * x) / scale
    out[at + 2] = z / scale


@portable(
    "void(int64, float64[:,::1], float64, float64, float64, int32[::1], float64[:,::1], float64[:,::1],"
    " int32[::1], int64, float32[::1])"
)
def disclose(
    i: int,
    states: FloatArray,
    room: float,
    ground: float,
    time_left: float,
    kinds: IndexArray,
    rows: FloatArray,
    discs: FloatArray,
    candidates: IndexArray,
    count: int,
    out: Float32Array,
) -> None:
    """Write what is true about one follower, in its heading frame, scaled to about one.

    Args:
        i: whose situation.
        states: (n, 10) position, velocity, attitude of all, world; 0 is the leader.
        room: distance of i to the nearest surface, m.
        ground: height of the ground, m.
        time_left: until the trial is over, s.
        kinds: (m,) kind of each primitive.
        rows: (m, 8) its shape.
        discs: (m, 3) its enclosing vertical cylinder.
        candidates: primitives that may be near i, the first `count` of them.
        count: how many.
        out: (32,) overwritten.
    """
    n = states.shape[0]
    yaw = yaw_of(states[i, 6:10])
    cosine, sine = math.cos(yaw), math.sin(yaw)
    for index in range(out.shape[0]):
        out[index] = 0.0
    px, py, pz = states[i, 0], states[i, 1], states[i, 2]
    _turned(states[0, 0] - px, states[0, 1] - py, states[0, 2] - pz, cosine, sine, _DISTANCE_M, out, LEADER_P)
    _turned(
        states[0, 3] - states[i, 3], states[0, 4] - states[i, 4], states[0, 5] - states[i, 5],
        cosine, sine, _SPEED_MPS, out, LEADER_V,
    )  # fmt: skip
    mx, my, mz = 0.0, 0.0, 0.0
    for j in range(n):
        mx, my, mz = mx + states[j, 0], my + states[j, 1], mz + states[j, 2]
    _turned(mx / n - px, my / n - py, mz / n - pz, cosine, sine, _DISTANCE_M, out, MIDDLE)
    least, least_j = -1.0, -1
    for shown in range(min(OTHERS_SHOWN, n - 1)):
        # The next nearest after the one before, so that no order needs to be kept.
        best, best_j = math.inf, -1
        for j in range(n):
            x, y, z = states[j, 0] - px, states[j, 1] - py, states[j, 2] - pz
            square = x * x + y * y + z * z
            if j != i and (square > least or (square == least and j > least_j)) and square < best:
                best, best_j = square, j
        if best_j < 0:
            break
        least, least_j = best, best_j
        x, y, z = states[best_j, 0] - px, states[best_j, 1] - py, states[best_j, 2] - pz
        at = OTHERS + 4 * shown
        _turned(x, y, z, cosine, sine, _DISTANCE_M, out, at)
        closing = 0.0
        for axis in range(3):
            apart = states[best_j, axis] - states[i, axis]
            closing -= apart * (states[best_j, 3 + axis] - states[i, 3 + axis])
        out[at + 3] = closing / max(math.sqrt(best), _TINY_M) / _SPEED_MPS
    if room < _ROOM_M:
        nearest, least_room = -1, math.inf
        for slot in range(count):
            k = candidates[slot]
            dx, dy, bound = discs[k, 0] - px, discs[k, 1] - py, discs[k, 2] + max(room, 0.0) + _TINY_M
            if dx * dx + dy * dy <= bound * bound:
                distance = distance_to_primitive(kinds[k], rows[k], px, py, pz)
                if distance < least_room:
                    nearest, least_room = k, distance
        if nearest >= 0:
            kind, row = kinds[nearest], rows[nearest]
            gx = (distance_to_primitive(kind, row, px + _TINY_M, py, pz) - least_room) / _TINY_M
            gy = (distance_to_primitive(kind, row, px, py + _TINY_M, pz) - least_room) / _TINY_M
            gz = (distance_to_primitive(kind, row, px, py, pz + _TINY_M) - least_room) / _TINY_M
            _turned(-gx, -gy, -gz, cosine, sine, 1.0, out, SURFACE)
        out[ROOM] = 1.0 - max(room, 0.0) / _ROOM_M
    out[HEIGHT] = (pz - ground) / _HEIGHT_M - 1.0
    out[TIME_LEFT] = min(max(time_left, 0.0) / _TIME_S, 1.0)
    out[SIZE] = (n - 1) / _MOST_FOLLOWERS
