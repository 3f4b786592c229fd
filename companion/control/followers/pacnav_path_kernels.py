"""Paths of the neighbours, sampled together on a common beat, and what `pacnav` reads from them."""

import math

from companion.compiled import portable_inlined
from companion.control.followers.layout_kernels import (
    EGO_DT,
    EGO_P,
    EGO_YAW,
    PACNAV_AGE,
    PACNAV_BEAT,
    PACNAV_BEAT_LENGTH,
    PACNAV_HISTORY,
    PACNAV_HOLD,
    PACNAV_LAST_P,
    PACNAV_PATH_COUNT,
    PACNAV_PATH_SIZE,
    PACNAV_PATHS,
    PACNAV_POSITIONS,
    PACNAV_SAMPLES,
    PACNAV_SINCE_BEAT,
    PACNAV_STILL,
    ROW_ID,
    ROW_P,
    ROW_PRESENT,
)
from companion.messages import FloatArray

_FIRST = 1
_LAST = 2


@portable_inlined
def path_at(path: int) -> int:
    """Return where a path begins in the memory."""
    return PACNAV_PATHS + path * PACNAV_PATH_SIZE


@portable_inlined
def sample(memory: FloatArray, path: int, beat: int) -> tuple[float, float]:
    """Return where a neighbour was in the map at a beat of its path."""
    at = path_at(path) + PACNAV_POSITIONS + 2 * (beat % PACNAV_SAMPLES)
    return memory[at], memory[at + 1]


@portable_inlined
def first_beat(memory: FloatArray, path: int) -> int:
    """Return the beat of a path's oldest sample."""
    return int(memory[path_at(path) + _FIRST])


@portable_inlined
def last_beat(memory: FloatArray, path: int) -> int:
    """Return the beat of a path's newest sample."""
    return int(memory[path_at(path) + _LAST])


@portable_inlined
def is_known(memory: FloatArray, path: int) -> bool:
    """Return whether there is any path here."""
    known: bool = memory[path_at(path)] > 0.0
    return known


@portable_inlined
def is_near(memory: FloatArray, path: int, parameters: FloatArray) -> bool:
    """Return whether the neighbour of this path is seen, or was until just now."""
    near: bool = is_known(memory, path) and memory[path_at(path) + PACNAV_AGE] <= parameters[PACNAV_HOLD]
    return near


@portable_inlined
def remember_paths(
    ego: FloatArray, neighbours: FloatArray, memory: FloatArray, parameters: FloatArray
) -> None:
    """Note where everybody is; on a beat append it to the paths, and drop what is too old.

    An unseen neighbour is held at its last position for a while; then its path only grows older.
    """
    cos_yaw, sin_yaw = math.cos(ego[EGO_YAW]), math.sin(ego[EGO_YAW])
    beat = int(memory[PACNAV_BEAT])
    for path in range(PACNAV_PATH_COUNT):
        memory[path_at(path) + PACNAV_AGE] += ego[EGO_DT]
    for row in range(neighbours.shape[0]):
        if neighbours[row, ROW_PRESENT] < 0.5:
            continue
        x, y = neighbours[row, ROW_P], neighbours[row, ROW_P + 1]
        at = path_at(_path_for(memory, neighbours[row, ROW_ID] + 1.0))
        px = ego[EGO_P] + cos_yaw * x - sin_yaw * y
        py = ego[EGO_P + 1] + sin_yaw * x + cos_yaw * y
        if memory[at] != neighbours[row, ROW_ID] + 1.0:
            memory[at] = neighbours[row, ROW_ID] + 1.0
            _begin(memory, at, beat, px, py)
        memory[at + PACNAV_LAST_P] = px
        memory[at + PACNAV_LAST_P + 1] = py
        memory[at + PACNAV_AGE] = 0.0
    memory[PACNAV_SINCE_BEAT] += ego[EGO_DT]
    # Time in steps of the control rate does not add up to the last bit.
    if memory[PACNAV_SINCE_BEAT] < parameters[PACNAV_BEAT_LENGTH] - 1e-6:
        return
    memory[PACNAV_SINCE_BEAT] = max(memory[PACNAV_SINCE_BEAT] - parameters[PACNAV_BEAT_LENGTH], 0.0)
    memory[PACNAV_BEAT] = beat + 1.0
    _append(beat + 1, memory, parameters)


@portable_inlined
def _append(beat: int, memory: FloatArray, parameters: FloatArray) -> None:
    kept = int(parameters[PACNAV_HISTORY] / parameters[PACNAV_BEAT_LENGTH] + 0.5)
    oldest = beat - min(kept, PACNAV_SAMPLES - 1)
    for path in range(PACNAV_PATH_COUNT):
        at = path_at(path)
        if memory[at] == 0.0:
            continue
        if is_near(memory, path, parameters):
            if memory[at + _LAST] < beat - 1.0:
                _begin(memory, at, beat, memory[at + PACNAV_LAST_P], memory[at + PACNAV_LAST_P + 1])
            place = at + PACNAV_POSITIONS + 2 * (beat % PACNAV_SAMPLES)
            memory[place] = memory[at + PACNAV_LAST_P]
            memory[place + 1] = memory[at + PACNAV_LAST_P + 1]
            memory[at + _LAST] = beat
        memory[at + _FIRST] = max(memory[at + _FIRST], oldest)
        if memory[at + _FIRST] > memory[at + _LAST]:
            memory[at] = 0.0


@portable_inlined
def _begin(memory: FloatArray, at: int, beat: int, px: float, py: float) -> None:
    place = at + PACNAV_POSITIONS + 2 * (beat % PACNAV_SAMPLES)
    memory[place] = px
    memory[place + 1] = py
    memory[at + _FIRST] = beat
    memory[at + _LAST] = beat


@portable_inlined
def _path_for(memory: FloatArray, number: float) -> int:
    """Return the path of this number, or a free one, or that of whoever has been away longest."""
    free, oldest = -1, 0
    for path in range(PACNAV_PATH_COUNT):
        at = path_at(path)
        if memory[at] == number:
            return path
        if memory[at] == 0.0 and free < 0:
            free = path
        if memory[at + PACNAV_AGE] > memory[path_at(oldest) + PACNAV_AGE]:
            oldest = path
    return free if free >= 0 else oldest


@portable_inlined
def _heading_of_step(memory: FloatArray, path: int, beat: int, still: float) -> tuple[float, float]:
    """Return the unit vector from one sample to the next, or zero if it is not longer than noise."""
    x0, y0 = sample(memory, path, beat)
    x1, y1 = sample(memory, path, beat + 1)
    dx, dy = x1 - x0, y1 - y0
    size = math.sqrt(dx * dx + dy * dy)
    if size <= still:
        return 0.0, 0.0
    return dx / size, dy / size


@portable_inlined
def persistence(memory: FloatArray, path: int, still: float) -> float:
    """Return how straight a path is: the mean cosine between successive steps, -1 with two samples."""
    first, last = first_beat(memory, path), last_beat(memory, path)
    if last - first < 2:
        return -1.0
    total = 0.0
    ux, uy = _heading_of_step(memory, path, first, still)
    for beat in range(first + 1, last):
        wx, wy = _heading_of_step(memory, path, beat, still)
        total += ux * wx + uy * wy
        ux, uy = wx, wy
    return total / (last - first - 1)


@portable_inlined
def similarity(memory: FloatArray, path: int, other: int, still: float) -> float:
    """Return how alike two neighbours moved at the same times: the mean cosine; -1 without common steps."""
    first = max(first_beat(memory, path), first_beat(memory, other))
    last = min(last_beat(memory, path), last_beat(memory, other))
    if last - first < 1:
        return -1.0
    total = 0.0
    for beat in range(first, last):
        ux, uy = _heading_of_step(memory, path, beat, still)
        wx, wy = _heading_of_step(memory, other, beat, still)
        total += ux * wx + uy * wy
    return total / (last - first)


@portable_inlined
def score(memory: FloatArray, path: int, parameters: FloatArray) -> float:
    """Return a neighbour's persistence plus its similarity to every other near neighbour."""
    still = parameters[PACNAV_STILL]
    total = persistence(memory, path, still)
    for other in range(PACNAV_PATH_COUNT):
        if other != path and is_near(memory, other, parameters):
            total += similarity(memory, path, other, still)
    return total
