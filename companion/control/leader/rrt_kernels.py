"""Kernels of the path planner: clearance look-ups, tree growth, shortcuts and walking along a polyline.

Positions are (x, y) in the map frame. A clearance field is `distance` (n, n) with the lowest corner of
cell (0, 0) at (x0, y0); positions outside it are unknown and count as free.
"""

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import FloatArray

FieldArray = NDArray[np.float32]
IndexArray = NDArray[np.int64]

_UNKNOWN_CLEARANCE_M = 100.0
_CHECK_EVERY_M = 0.1
_OPENING_SLOPE = 0.5
_SAME_POINT_M = 1e-9


@inlined
def _clearance(distance: FieldArray, x0: float, y0: float, cell: float, x: float, y: float) -> float:
    u = (x - x0) / cell - 0.5
    v = (y - y0) / cell - 0.5
    n = distance.shape[0]
    if not (0.0 <= u < n - 1 and 0.0 <= v < n - 1):
        return _UNKNOWN_CLEARANCE_M
    i = int(u)
    j = int(v)
    a = u - i
    b = v - j
    low = (1.0 - b) * float(distance[i, j]) + b * float(distance[i, j + 1])
    high = (1.0 - b) * float(distance[i + 1, j]) + b * float(distance[i + 1, j + 1])
    return (1.0 - a) * low + a * high


@compiled("float64(float32[:,::1], float64, float64, float64, float64, float64)")
def clearance_at(distance: FieldArray, x0: float, y0: float, cell: float, x: float, y: float) -> float:
    """Distance to the nearest obstacle at (x, y), bilinear between cells, m; 100 outside the field."""
    return _clearance(distance, x0, y0, cell, x, y)


@inlined
def _segment_free(
    distance: FieldArray,
    x0: float,
    y0: float,
    cell: float,
    ax: float,
    ay: float,
    bx: float,
    by: float,
    wanted: float,
    ends: FloatArray,
) -> bool:
    """Whether every 0.1 m between a and b is free.

    `ends` is (2, 3): start and goal with the clearance that is granted there. Where that is less than
    `wanted`, the demand grows with the distance from the end, so a vehicle that is already near an
    obstacle may leave it but not go along it.
    """
    length = math.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
    steps = math.ceil(length / _CHECK_EVERY_M)
    for index in range(steps + 1):
        share = index / steps if steps > 0 else 0.0
        x = ax + share * (bx - ax)
        y = ay + share * (by - ay)
        room = _clearance(distance, x0, y0, cell, x, y)
        if room >= wanted:
            continue
        free = False
        for end in range(2):
            away = math.sqrt((x - ends[end, 0]) ** 2 + (y - ends[end, 1]) ** 2)
            if room >= ends[end, 2] + _OPENING_SLOPE * away:
                free = True
        if not free:
            return False
    return True


@compiled(
    "boolean(float32[:,::1], float64, float64, float64, float64, float64, float64, float64, float64,"
    " float64[:,::1])"
)
def segment_free(
    distance: FieldArray,
    x0: float,
    y0: float,
    cell: float,
    ax: float,
    ay: float,
    bx: float,
    by: float,
    wanted: float,
    ends: FloatArray,
) -> bool:
    """Whether the segment from a to b keeps `wanted` clearance, less near the `ends` (2, 3)."""
    return _segment_free(distance, x0, y0, cell, ax, ay, bx, by, wanted, ends)


@compiled(
    "UniTuple(int64, 2)(float32[:,::1], float64, float64, float64, float64, float64[:,::1], float64[:,::1],"
    " float64, float64, float64, float64[:,::1], int64[::1])"
)
def grow_tree(
    distance: FieldArray,
    x0: float,
    y0: float,
    cell: float,
    wanted: float,
    ends: FloatArray,
    samples: FloatArray,
    radius: float,
    goal_bias: float,
    step: float,
    nodes: FloatArray,
    parents: IndexArray,
) -> tuple[int, int]:
    """Grow a rapidly-exploring random tree from `ends[0]` until it reaches `ends[1]`.

    Args:
        distance: the clearance field.
        x0: its corner.
        y0: its corner.
        cell: its cell size, m.
        wanted: clearance of every edge, m.
        ends: (2, 3) start and goal with the clearance granted there.
        samples: (m, 3) uniform numbers in [0, 1): goal bias, squared radius, angle.
        radius: samples fill the disc of this radius round the start, m.
        goal_bias: share of samples that are the goal.
        step: length of an edge, m.
        nodes: (k, 2) result; k bounds the tree.
        parents: (k,) result: index of each node's parent, -1 for the start.

    Returns:
        The number of nodes and the goal's index, -1 if it was not reached.

    Source: S. LaValle, "Rapidly-exploring random trees: a new tool for path planning", 1998.
    """
    nodes[0, 0] = ends[0, 0]
    nodes[0, 1] = ends[0, 1]
    parents[0] = -1
    count = 1
    goal_x = ends[1, 0]
    goal_y = ends[1, 1]
    for index in range(samples.shape[0]):
        # One place is kept for the goal itself.
        if count >= nodes.shape[0] - 1:
            break
        if samples[index, 0] < goal_bias:
            x = goal_x
            y = goal_y
        else:
            rho = radius * math.sqrt(samples[index, 1])
            angle = 2.0 * math.pi * samples[index, 2]
            x = ends[0, 0] + rho * math.cos(angle)
            y = ends[0, 1] + rho * math.sin(angle)
        nearest = 0
        best = math.inf
        for node in range(count):
            squared = (nodes[node, 0] - x) ** 2 + (nodes[node, 1] - y) ** 2
            if squared < best:
                best = squared
                nearest = node
        gap = math.sqrt(best)
        if gap < _SAME_POINT_M:
            continue
        share = min(1.0, step / gap)
        x = nodes[nearest, 0] + share * (x - nodes[nearest, 0])
        y = nodes[nearest, 1] + share * (y - nodes[nearest, 1])
        if not _segment_free(
            distance, x0, y0, cell, nodes[nearest, 0], nodes[nearest, 1], x, y, wanted, ends
        ):
            continue
        nodes[count, 0] = x
        nodes[count, 1] = y
        parents[count] = nearest
        count += 1
        left = math.sqrt((goal_x - x) ** 2 + (goal_y - y) ** 2)
        if left <= step and _segment_free(distance, x0, y0, cell, x, y, goal_x, goal_y, wanted, ends):
            nodes[count, 0] = goal_x
            nodes[count, 1] = goal_y
            parents[count] = count - 1
            return count + 1, count
    return count, -1


@inlined
def _point_at(path: FloatArray, count: int, s: float) -> tuple[float, float, int]:
    """Return the point at arc length s and the index of the vertex before it."""
    left = s
    for index in range(count - 1):
        dx = path[index + 1, 0] - path[index, 0]
        dy = path[index + 1, 1] - path[index, 1]
        length = math.sqrt(dx * dx + dy * dy)
        if left <= length and length > 0.0:
            return path[index, 0] + left / length * dx, path[index, 1] + left / length * dy, index
        left -= length
    return path[count - 1, 0], path[count - 1, 1], max(count - 2, 0)


@inlined
def _length(path: FloatArray, count: int) -> float:
    total = 0.0
    for index in range(count - 1):
        total += math.sqrt(
            (path[index + 1, 0] - path[index, 0]) ** 2 + (path[index + 1, 1] - path[index, 1]) ** 2
        )
    return total


@compiled(
    "int64(float32[:,::1], float64, float64, float64, float64, float64[:,::1], float64[:,::1],"
    " float64[:,::1], int64)"
)
def cut_corners(
    distance: FieldArray,
    x0: float,
    y0: float,
    cell: float,
    wanted: float,
    ends: FloatArray,
    picks: FloatArray,
    path: FloatArray,
    count: int,
) -> int:
    """Replace stretches between two random points of a path by straight lines where those are free.

    Args:
        distance: the clearance field.
        x0: its corner.
        y0: its corner.
        cell: its cell size, m.
        wanted: clearance of every segment, m.
        ends: (2, 3) start and goal with the clearance granted there.
        picks: (k, 2) uniform numbers in [0, 1): the two points of each attempt as shares of the length.
        path: (rows, 2) polyline in the first `count` rows, changed in place; needs 2 k spare rows.
        count: its number of points.

    Returns:
        The new number of points.
    """
    for index in range(picks.shape[0]):
        total = _length(path, count)
        low = min(picks[index, 0], picks[index, 1]) * total
        high = max(picks[index, 0], picks[index, 1]) * total
        ax, ay, before = _point_at(path, count, low)
        bx, by, last = _point_at(path, count, high)
        if before == last or not _segment_free(distance, x0, y0, cell, ax, ay, bx, by, wanted, ends):
            continue
        # Vertices before+1 .. last give way to the two points.
        shift = 2 - (last - before)
        if shift > 0:
            for row in range(count - 1, last, -1):
                path[row + shift] = path[row]
        elif shift < 0:
            for row in range(last + 1, count):
                path[row + shift] = path[row]
        path[before + 1, 0] = ax
        path[before + 1, 1] = ay
        path[before + 2, 0] = bx
        path[before + 2, 1] = by
        count += shift
    return count


@compiled("UniTuple(float64, 3)(float64[:,::1], float64, float64, float64, float64)")
def locate(path: FloatArray, x: float, y: float, s_low: float, s_high: float) -> tuple[float, float, float]:
    """Find the point of a path nearest to (x, y) between two arc lengths.

    Returns:
        Its arc length, its distance from (x, y), and the length of the whole path, m.
    """
    best = math.inf
    best_s = max(s_low, 0.0)
    start = 0.0
    for index in range(path.shape[0] - 1):
        dx = path[index + 1, 0] - path[index, 0]
        dy = path[index + 1, 1] - path[index, 1]
        length = math.sqrt(dx * dx + dy * dy)
        if length > 0.0 and start + length >= s_low and start <= s_high:
            along = ((x - path[index, 0]) * dx + (y - path[index, 1]) * dy) / length
            along = min(max(along, s_low - start, 0.0), s_high - start, length)
            px = path[index, 0] + along / length * dx
            py = path[index, 1] + along / length * dy
            gap = math.sqrt((x - px) ** 2 + (y - py) ** 2)
            if gap < best:
                best = gap
                best_s = start + along
        start += length
    if best == math.inf:
        last = path.shape[0] - 1
        best = math.sqrt((x - path[last, 0]) ** 2 + (y - path[last, 1]) ** 2)
        best_s = start
    return best_s, best, start


@compiled("UniTuple(float64, 2)(float64[:,::1], float64)")
def point_at(path: FloatArray, s: float) -> tuple[float, float]:
    """Return the point at arc length `s`; before the start and past the end, the start and the end."""
    x, y, _ = _point_at(path, path.shape[0], max(s, 0.0))
    return x, y


@compiled(
    "float64(float32[:,::1], float64, float64, float64, float64, float64[:,::1], float64[:,::1],"
    " float64, float64)"
)
def free_length(
    distance: FieldArray,
    x0: float,
    y0: float,
    cell: float,
    wanted: float,
    ends: FloatArray,
    path: FloatArray,
    s_from: float,
    s_to: float,
) -> float:
    """Walk a path from one arc length to another; return how far it is free, m after `s_from`."""
    s = s_from
    while s < s_to:
        stop = min(s + _CHECK_EVERY_M, s_to)
        ax, ay, _ = _point_at(path, path.shape[0], s)
        bx, by, _ = _point_at(path, path.shape[0], stop)
        if not _segment_free(distance, x0, y0, cell, ax, ay, bx, by, wanted, ends):
            return s - s_from
        s = stop
    return s_to - s_from
