"""A site from above, as one HTML file that opens without a network."""

import math
from typing import Any

import numpy as np

from companion.logs import figure_page
from companion.logs import report_style as style
from companion.logs.figure_page import FigureBox
from companion.messages import FloatArray
from sitl.worlds.course import GOAL_CLEAR_M, SPAWN_CLEAR_M
from sitl.worlds.primitives import World
from sitl.worlds.raycast_kernels import BOX, CAPSULE, CYLINDER, PLANE, SPHERE
from sitl.worlds.sites import Site

NAMES = {PLANE: "ground", SPHERE: "sphere", CYLINDER: "cylinder", CAPSULE: "capsule", BOX: "box"}
CUT_HEIGHT_M = 1.75
_COLOURS = {SPHERE: style.GREEN, CYLINDER: "#8a5a2b", CAPSULE: "#b08050", BOX: "#5b6b80"}
_CUT_CELL_M = 0.2
_CUT_CELLS_MAX = 500
_ARC = 24
_MARGIN_M = 3.0

_HEIGHT_PX = 820


def page(site: Site, title: str, facts: str) -> str:
    """Return the whole page.

    Args:
        site: what to draw.
        title: of the page.
        facts: one line under it.

    Raises:
        NoPlotsError: if plotly is not installed.
    """
    caption = (
        f"Outlines from above in full; dark: what stands in the way at a height of {CUT_HEIGHT_M:g} m. "
        "Dotted: kept free."
    )
    box = FigureBox("plan", "From above", caption, figure(site), wide=True)
    return figure_page.page(title, facts, [box])


def figure(site: Site) -> dict[str, Any]:
    """Return the drawing as a plotly figure."""
    way = np.vstack([site.spawn_world, site.waypoints_world])
    low, high = _frame(site)
    traces: list[dict[str, Any]] = []
    for kind, colour in _COLOURS.items():
        outlines = [outline(kind, row) for row in site.world.rows[site.world.kinds == kind]]
        if outlines:
            traces.append(_filled(outlines, NAMES[kind], colour))
    traces.append(_cut(site.world, low, high))
    rooms = [SPAWN_CLEAR_M, *[GOAL_CLEAR_M] * (len(way) - 1)]
    discs = [_circle(x, y, room) for (x, y), room in zip(way.tolist(), rooms, strict=True)]
    x, y = _joined(discs)
    dotted = {"color": style.PLAN, "width": 1.5, "dash": "dot"}
    traces.append({"type": "scatter", "mode": "lines", "x": x, "y": y, "name": "kept free", "line": dotted})
    traces.append(
        {
            "type": "scatter",
            "mode": "lines+markers+text",
            "x": np.round(way[:, 0], 3).tolist(),
            "y": np.round(way[:, 1], 3).tolist(),
            "text": ["start", *[""] * (len(way) - 2), "goal"],
            "textposition": "top center",
            "name": "way",
            "line": {"color": style.COMMAND, "width": 2},
            "marker": {"size": 8},
        }
    )
    return {
        "data": traces,
        "layout": {
            "height": _HEIGHT_PX,
            "margin": {"l": 45, "r": 10, "t": 10, "b": 40},
            "dragmode": "pan",
            "xaxis": {"title": {"text": "x, m"}, "range": [float(low[0]), float(high[0])], "zeroline": False},
            "yaxis": {
                "title": {"text": "y, m"},
                "range": [float(low[1]), float(high[1])],
                "scaleanchor": "x",
                "zeroline": False,
            },
            "legend": {"orientation": "h", "y": 1.05},
        },
    }


def outline(kind: int, row: FloatArray) -> FloatArray:
    """Return the outline (n, 2) of one primitive seen from above, closed."""
    if kind == BOX:
        corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]]) * row[3:5]
        turn = np.array([[row[6], -row[7]], [row[7], row[6]]])
        return np.asarray(corners @ turn.T + row[:2])
    if kind == SPHERE:
        return _circle(row[0], row[1], row[7])
    end = row[:2] + row[6] * row[3:5]
    if math.hypot(row[3], row[4]) < 1e-9:
        return _circle(row[0], row[1], row[7])
    heading = math.atan2(row[4], row[3])
    front = heading + np.linspace(-0.5 * math.pi, 0.5 * math.pi, _ARC // 2)
    arc = row[7] * np.column_stack([np.cos(front), np.sin(front)])
    return np.vstack([end + arc, row[:2] - arc, end + arc[:1]])


def _frame(site: Site) -> tuple[FloatArray, FloatArray]:
    """Return the corners (2,) of what is shown."""
    points = np.vstack([site.spawn_world, site.waypoints_world])
    low, high = points.min(axis=0) - SPAWN_CLEAR_M, points.max(axis=0) + SPAWN_CLEAR_M
    if np.any(np.isfinite(site.world.discs[:, 2])):
        outlines = [
            outline(kind, row)
            for kind, row in zip(site.world.kinds.tolist(), site.world.rows, strict=True)
            if kind != PLANE
        ]
        corners = np.vstack(outlines)
        low, high = np.minimum(low, corners.min(axis=0)), np.maximum(high, corners.max(axis=0))
    return low - _MARGIN_M, high + _MARGIN_M


def _cut(world: World, low: FloatArray, high: FloatArray) -> dict[str, Any]:
    """Return what is solid at one height, as an image."""
    cell = max(_CUT_CELL_M, float((high - low).max()) / _CUT_CELLS_MAX)
    x, y = (np.arange(low[axis], high[axis], cell) + 0.5 * cell for axis in range(2))
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    points = np.concatenate([grid, np.full((*grid.shape[:2], 1), CUT_HEIGHT_M)], axis=-1)
    solid = world.obstacles().clearance(points) <= 0.5 * cell
    return {
        "type": "heatmap",
        "x0": float(x[0]),
        "dx": cell,
        "y0": float(y[0]),
        "dy": cell,
        "z": [[1 if hit else None for hit in line] for line in solid.tolist()],
        "colorscale": [[0, style.TRUTH], [1, style.TRUTH]],
        "showscale": False,
        "hoverinfo": "skip",
    }


def _filled(outlines: list[FloatArray], name: str, colour: str) -> dict[str, Any]:
    x, y = _joined(outlines)
    return {
        "type": "scatter",
        "mode": "lines",
        "x": x,
        "y": y,
        "name": f"{name} ({len(outlines)})",
        "fill": "toself",
        "opacity": 0.45,
        "line": {"color": colour, "width": 1},
        "hoverinfo": "skip",
    }


def _joined(outlines: list[FloatArray]) -> tuple[list[float | None], list[float | None]]:
    x: list[float | None] = []
    y: list[float | None] = []
    for line in outlines:
        x += [*np.round(line[:, 0], 3).tolist(), None]
        y += [*np.round(line[:, 1], 3).tolist(), None]
    return x, y


def _circle(x: float, y: float, radius: float) -> FloatArray:
    angles = np.linspace(0.0, 2.0 * math.pi, _ARC + 1)
    return np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)])
