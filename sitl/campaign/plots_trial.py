"""One trial seen from above: who flew where, between what."""

import math
from collections.abc import Sequence

import numpy as np

from companion.logs import report_style as style
from companion.logs.figure_page import Figure
from companion.messages import FloatArray
from sitl.campaign.plots import COLOURS
from sitl.worlds.primitives import World
from sitl.worlds.raycast_kernels import BOX, PLANE

_POINTS_MAX = 600
_OUTLINES_MAX = 2000
_CORNERS = 20
_MARGIN_M = 6.0


def plan_view(
    p_world: FloatArray, world: World, waypoints_world: FloatArray, names: Sequence[str] = ()
) -> Figure:
    """Return the paths of a trial over its obstacles.

    Args:
        p_world: (T, N, 3) positions, m; vehicle 0 is the leader.
        world: where it flew.
        waypoints_world: (k, 3) the leader's way; the last is the goal.
        names: of the vehicles; leader and numbered followers by default.
    """
    shown = names or ["leader", *(f"follower {number}" for number in range(1, p_world.shape[1]))]
    traces = [_obstacles(world, *_area(p_world, waypoints_world))]
    stride = max(1, math.ceil(len(p_world) / _POINTS_MAX))
    for index, name in enumerate(shown):
        path = p_world[::stride, index, :2]
        colour = style.TRUTH if index == 0 else COLOURS[(index - 1) % len(COLOURS)]
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": name,
                "x": _rounded(path[:, 0]),
                "y": _rounded(path[:, 1]),
                "line": {"color": colour, "width": 2.6 if index == 0 else 1.6},
                "hoverinfo": "name",
            }
        )
    traces.append(_marks("start", p_world[0, :, :2], "circle-open", 9, style.GREEN))
    traces.append(_marks("end", p_world[-1, :, :2], "x", 8, style.RED))
    traces.append(_marks("waypoints", waypoints_world[:, :2], "star", 14, style.PLAN))
    layout = style.layout(x_title="x (world), m", y_title="y (world), m", height=620)
    layout["yaxis"] |= {"scaleanchor": "x", "scaleratio": 1}
    return {"data": traces, "layout": layout}


def outline(kind: int, row: FloatArray) -> FloatArray:
    """Return the corners (n, 2) of a primitive seen from above; what is round gets many of them."""
    if kind == BOX:
        half_x, half_y, cosine, sine = row[3], row[4], row[6], row[7]
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * [half_x, half_y]
        return np.asarray(corners @ np.array([[cosine, sine], [-sine, cosine]]) + row[:2])
    radius = row[7]
    angle = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
    along = row[3:5] * row[6]
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    # A rod is the hull of its two ends (a ball has one): each half of the ring goes with one of them.
    ahead = ring @ along > 0.0
    return np.asarray(row[:2] + ring + ahead[:, None] * along)


def _area(p_world: FloatArray, waypoints_world: FloatArray) -> tuple[FloatArray, FloatArray]:
    places = np.concatenate([p_world.reshape(-1, 3)[:, :2], waypoints_world[:, :2]])
    return places.min(axis=0) - _MARGIN_M, places.max(axis=0) + _MARGIN_M


def _obstacles(world: World, low: FloatArray, high: FloatArray) -> Figure:
    """Return the outlines of what stands near the flight, as one trace with gaps."""
    x: list[float | None] = []
    y: list[float | None] = []
    count = 0
    for kind, row in zip(world.kinds[: len(world.discs)], world.rows, strict=False):
        if kind == PLANE:
            continue
        corners = outline(int(kind), row)
        if np.any(corners.max(axis=0) < low) or np.any(corners.min(axis=0) > high):
            continue
        count += 1
        if count > _OUTLINES_MAX:
            break
        x += [*_rounded(corners[:, 0]), None]
        y += [*_rounded(corners[:, 1]), None]
    return {
        "type": "scatter",
        "mode": "lines",
        "name": "obstacles",
        "x": x,
        "y": y,
        "fill": "toself",
        "fillcolor": "rgba(120,130,145,0.45)",
        "line": {"color": style.OBSTACLE, "width": 1},
        "hoverinfo": "skip",
    }


def _marks(name: str, places: FloatArray, symbol: str, size: int, colour: str) -> Figure:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": _rounded(places[:, 0]),
        "y": _rounded(places[:, 1]),
        "marker": {"symbol": symbol, "size": size, "color": colour},
        "hoverinfo": "name",
    }


def _rounded(values: FloatArray) -> list[float]:
    numbers: list[float] = np.round(values, 3).tolist()
    return numbers
