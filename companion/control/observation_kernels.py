"""What a learned follower is shown: `describe`, the same in flight, in emulation and in training.

All numbers are scaled to about one. The frame is the heading frame of the law. Rows and cells without content
are zero.
"""

import math

from companion.compiled import portable, portable_inlined
from companion.control.followers.layout_kernels import (
    AZIMUTHS,
    EGO_ALONE,
    EGO_HEIGHT,
    EGO_P,
    EGO_V,
    EGO_YAW,
    ELEVATIONS,
    FLOCK_BAND_ABOVE,
    FLOCK_BAND_BELOW,
    FLOCK_COLUMNS,
    FLOCK_KNOWN,
    FLOCK_POINT_COUNT,
    FLOCK_POINT_SIZE,
    FLOCK_POINTS,
    FLOCK_SLOT_COUNT,
    FLOCK_VIEW,
    FLOCK_VIEW_SIZE,
    ROW_P,
    ROW_PRESENT,
    ROW_V,
)
from companion.messages import Float32Array, FloatArray

PAPER = 0
"""Number of the contract `paper-1`."""
BEST = 1
"""Number of the contract `best-2`."""

PAPER_EGO = 7
PAPER_ROWS = 6
PAPER_ROW = 7
BEST_EGO = 14
BEST_ROWS = FLOCK_SLOT_COUNT
BEST_ROW = 8
BEST_MEMORY = AZIMUTHS
GRID_CHANNELS = 2

_GRID_RANGE_M = 10.0
_NEIGHBOUR_RANGE_M = 10.0
_SPEED_MPS = 2.0
_HEIGHT_M = 2.0
_ALONE_S = 2.0
_MOST_KNOWN = 10.0
_VIEW_RANGE_M = 5.0
_MEMORY_RANGE_M = 5.0
_TWO_BODIES_M = 0.4


@portable_inlined
def keeping_of(contract: int) -> int:
    """Return 1 if what a policy of a contract says must keep to the limits of its law, 0 if not."""
    return 1 if contract == BEST else 0


@portable(
    "void(int64, float64[::1], float64[::1], float64[:,::1], float64[:,::1], float64[::1], float64[::1], "
    "float64[::1], float64[::1], float32[::1], float32[:,::1], float32[:,:,::1], float32[::1])"
)
def describe(
    contract: int,
    ego: FloatArray,
    up: FloatArray,
    neighbours: FloatArray,
    ranges: FloatArray,
    memory: FloatArray,
    parameters: FloatArray,
    reference: FloatArray,
    previous: FloatArray,
    ego_out: Float32Array,
    neighbours_out: Float32Array,
    grid_out: Float32Array,
    memory_out: Float32Array,
) -> None:
    """Write one observation.

    The last four arrays are overwritten completely; their sizes belong to the contract (see `observation`).

    Args:
        contract: its number, `PAPER` or `BEST`.
        ego: (10,) as given to `steer` in this tick.
        up: (3,) the body's upward axis in the heading frame.
        neighbours: (k, 8) as given to `steer`.
        ranges: (72, 12) as given to `steer`.
        memory: (MEMORY_SIZE,) of `flock` after `steer`; not read for `PAPER`.
        parameters: (PARAMETER_COUNT,) of `flock`; not read for `PAPER`.
        reference: (3,) what `steer` asked for, heading frame, m/s; not read for `PAPER`.
        previous: (3,) the command flown before this tick, heading frame of this tick, m/s; not read for
            `PAPER`.
        ego_out: (7,) or (14,).
        neighbours_out: (6, 7) or (12, 8).
        grid_out: (2, 72, 12): nearness 1 - d / 10 m, and 1 where anything was hit.
        memory_out: (0,) or (72,): nearness 1 - d / 5 m of the nearest obstacle in each direction at the own
            height, seen or remembered.
    """
    describe_grid(ranges, grid_out)
    describe_all_but_grid(
        contract, ego, up, neighbours, memory, parameters, reference, previous, ego_out, neighbours_out,
        memory_out,
    )  # fmt: skip


@portable_inlined
def describe_all_but_grid(
    contract: int, ego: FloatArray, up: FloatArray, neighbours: FloatArray, memory: FloatArray,
    parameters: FloatArray, reference: FloatArray, previous: FloatArray, ego_out: Float32Array,
    neighbours_out: Float32Array, memory_out: Float32Array,
) -> None:  # fmt: skip
    """Write what of an observation may change from tick to tick, as `describe` does."""
    if contract == PAPER:
        _describe_self_plainly(ego, up, ego_out)
        _describe_neighbours_plainly(neighbours, neighbours_out)
    else:
        _describe_self(ego, up, memory, reference, previous, ego_out)
        _describe_view(ego, memory, neighbours_out)
        _describe_surroundings(ego, memory, parameters, memory_out)


@portable_inlined
def describe_grid(ranges: FloatArray, out: Float32Array) -> None:
    """Write what of an observation only a new scan changes, as `describe` does."""
    for column in range(AZIMUTHS):
        for row in range(ELEVATIONS):
            nearness = 1.0 - ranges[column, row] / _GRID_RANGE_M
            out[0, column, row] = nearness if nearness > 0.0 else 0.0
            out[1, column, row] = 1.0 if nearness > 0.0 else 0.0


@portable_inlined
def _describe_self_plainly(ego: FloatArray, up: FloatArray, out: Float32Array) -> None:
    """Velocity, and the attitude without its heading: pitch about y, then roll about x, as a quaternion."""
    for axis in range(3):
        out[axis] = ego[EGO_V + axis] / _SPEED_MPS
    half_roll = -0.5 * math.asin(min(max(up[1], -1.0), 1.0))
    half_pitch = 0.5 * math.atan2(up[0], up[2])
    cos_roll, sin_roll = math.cos(half_roll), math.sin(half_roll)
    cos_pitch, sin_pitch = math.cos(half_pitch), math.sin(half_pitch)
    out[3] = cos_pitch * cos_roll
    out[4] = cos_pitch * sin_roll
    out[5] = sin_pitch * cos_roll
    out[6] = -sin_pitch * sin_roll


@portable_inlined
def _describe_neighbours_plainly(neighbours: FloatArray, out: Float32Array) -> None:
    for row in range(PAPER_ROWS):
        for index in range(PAPER_ROW):
            out[row, index] = 0.0
        if row < neighbours.shape[0] and neighbours[row, ROW_PRESENT] > 0.5:
            for axis in range(3):
                out[row, axis] = neighbours[row, ROW_P + axis] / _NEIGHBOUR_RANGE_M
                out[row, 3 + axis] = neighbours[row, ROW_V + axis] / _SPEED_MPS
            out[row, 6] = 1.0


@portable_inlined
def _describe_self(
    ego: FloatArray,
    up: FloatArray,
    memory: FloatArray,
    reference: FloatArray,
    previous: FloatArray,
    out: Float32Array,
) -> None:
    for axis in range(3):
        out[axis] = ego[EGO_V + axis] / _SPEED_MPS
        out[7 + axis] = previous[axis] / _SPEED_MPS
        out[10 + axis] = reference[axis] / _SPEED_MPS
    out[3] = up[0]
    out[4] = up[1]
    out[5] = min(max(ego[EGO_HEIGHT] / _HEIGHT_M - 1.0, -2.0), 2.0)
    out[6] = min(ego[EGO_ALONE] / _ALONE_S, 1.0)
    out[13] = memory[FLOCK_KNOWN] / _MOST_KNOWN


@portable_inlined
def _describe_view(ego: FloatArray, memory: FloatArray, out: Float32Array) -> None:
    """Everybody whom `flock` knows of, those just out of sight included, in no particular order."""
    known = int(memory[FLOCK_KNOWN])
    for row in range(BEST_ROWS):
        if row >= known:
            for index in range(BEST_ROW):
                out[row, index] = 0.0
            continue
        at = FLOCK_VIEW + row * FLOCK_VIEW_SIZE
        x, y, z = memory[at], memory[at + 1], memory[at + 2]
        distance = math.sqrt(x * x + y * y + z * z)
        out[row, 0] = x / _VIEW_RANGE_M
        out[row, 1] = y / _VIEW_RANGE_M
        out[row, 2] = z
        out[row, 3] = (memory[at + 3] - ego[EGO_V]) / _SPEED_MPS
        out[row, 4] = (memory[at + 4] - ego[EGO_V + 1]) / _SPEED_MPS
        out[row, 5] = memory[at + 5]
        out[row, 6] = 1.0
        out[row, 7] = _TWO_BODIES_M / max(distance, _TWO_BODIES_M)


@portable_inlined
def _describe_surroundings(
    ego: FloatArray, memory: FloatArray, parameters: FloatArray, out: Float32Array
) -> None:
    """The nearest obstacle in each direction, of those seen now and those that `flock` remembers."""
    for column in range(AZIMUTHS):
        out[column] = max(1.0 - memory[FLOCK_COLUMNS + column] / _MEMORY_RANGE_M, 0.0)
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    for point in range(FLOCK_POINT_COUNT):
        at = FLOCK_POINTS + point * FLOCK_POINT_SIZE
        rise = ego[EGO_P + 2] - memory[at + 3]
        if memory[at] <= 0.0 or rise > parameters[FLOCK_BAND_ABOVE] or rise < -parameters[FLOCK_BAND_BELOW]:
            continue
        dx, dy = memory[at + 1] - ego[EGO_P], memory[at + 2] - ego[EGO_P + 1]
        nearness = 1.0 - math.sqrt(dx * dx + dy * dy) / _MEMORY_RANGE_M
        angle = math.atan2(cos_yaw * dy - sin_yaw * dx, cos_yaw * dx + sin_yaw * dy)
        column = int((angle / (2.0 * math.pi) + 1.0) * AZIMUTHS) % AZIMUTHS
        if nearness > out[column]:
            out[column] = nearness
