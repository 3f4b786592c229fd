"""The page of a swarm's flight: paths with the flock's extent, and the metrics over time."""

import html
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from companion.logs import report_style as style
from companion.logs.figure_page import Figure, FigureBox, page
from companion.logs.metrics import SwarmMetrics
from companion.logs.swarm_log import SwarmFlight
from companion.logs.swarm_starts import Vector
from companion.messages import FloatArray

_POINTS_MAX = 2000
_CIRCLES = 12
_COLOURS = (
    style.ESTIMATE,
    style.COMMAND,
    style.GREEN,
    style.AXES[2],
    style.RED,
    "#0891b2",
    "#a16207",
    "#be185d",
)
_UNITS = {"FR": "FR (m)", "MS": "MS (m)", "AL": "AL", "MDO": "MDO (m)"}


def swarm_page(
    flight: SwarmFlight,
    metrics: SwarmMetrics,
    waypoints: Sequence[Vector],
    row: Mapping[str, str],
    sentences: Sequence[str],
    limits_m: tuple[float, float],
) -> str:
    """Return the whole page.

    Args:
        flight: who flew where.
        metrics: of the flight.
        waypoints: of the leader.
        row: the flight's line in the paper's table, by metric.
        sentences: what else there is to say.
        limits_m: distances at which vehicles touch each other and obstacles.

    Raises:
        LogError: if plotly is not installed.
    """
    heads = "".join(f"<th>{html.escape(_UNITS[name])}</th>" for name in row)
    cells = "".join(f"<td>{html.escape(cell)}</td>" for cell in row.values())
    notes = "".join(f'<p class="note">{html.escape(sentence)}</p>' for sentence in sentences)
    table = (
        '<section class="card"><h2>Mean ± standard deviation over time</h2>'
        f"<table><thead><tr>{heads}</tr></thead><tbody><tr>{cells}</tr></tbody></table>{notes}</section>"
    )
    paths = FigureBox(
        "paths",
        "Paths and flock radius",
        "Seen from above. Circles: the flock radius around the swarm's centre, at equal times.",
        _paths(flight, metrics, waypoints),
        wide=True,
    )
    lead = f"{len(flight.vehicles)} UAVs: {', '.join(flight.names)}"
    return page("Flight of a swarm", lead, [paths, *series_boxes(metrics, limits_m)], before=table)


def series_boxes(metrics: SwarmMetrics, limits_m: tuple[float, float]) -> list[FigureBox]:
    """Return the metrics over time, that of obstacles only if any was near.

    Args:
        metrics: of a flight.
        limits_m: distances at which vehicles touch each other and obstacles.
    """
    touching, contact = limits_m
    boxes = [
        FigureBox(
            "fr",
            "Flock radius",
            "From the swarm's centre to the UAV farthest from it.",
            _series(metrics.t, metrics.flock_radius_m, "m", style.ESTIMATE),
        ),
        FigureBox(
            "ms",
            "Minimum separation",
            f"Distance of the closest pair. Dotted: two UAVs touch at {touching:g} m.",
            _series(metrics.t, metrics.minimum_separation_m, "m", style.COMMAND, touching),
        ),
        FigureBox(
            "al",
            "Alignment",
            "Mean cosine between the UAVs' velocities and the swarm's; gaps where nobody moves.",
            _series(metrics.t, metrics.alignment, "", style.GREEN),
        ),
    ]
    if np.any(np.isfinite(metrics.obstacle_distance_m)):
        figure = _series(metrics.t, metrics.obstacle_distance_m, "m", style.AXES[2], contact)
        caption = f"From any UAV to the nearest obstacle. Dotted: contact at {contact:g} m."
        boxes.append(FigureBox("mdo", "Minimum distance to obstacles", caption, figure))
    return boxes


def _paths(flight: SwarmFlight, metrics: SwarmMetrics, waypoints: Sequence[Vector]) -> Figure:
    stride = max(1, -(-len(flight.t_ns) // _POINTS_MAX))
    traces: list[Figure] = []
    moments = np.unique(np.linspace(0, len(flight.t_ns) - 1, _CIRCLES).astype(np.int64))
    centres = flight.p[moments].mean(axis=1)
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    x: list[float | None] = []
    y: list[float | None] = []
    for centre, radius in zip(centres, metrics.flock_radius_m[moments], strict=True):
        x += [*_numbers(centre[0] + radius * np.cos(angle)), None]
        y += [*_numbers(centre[1] + radius * np.sin(angle)), None]
    circles = {"color": style.OBSTACLE, "width": 1, "dash": "dot"}
    traces.append(_curve("flock radius", x, y, circles) | {"hoverinfo": "skip"})
    for index, name in enumerate(flight.names):
        leads = index == flight.leader
        line = {
            "color": style.TRUTH if leads else _COLOURS[index % len(_COLOURS)],
            "width": 2.6 if leads else 1.6,
        }
        path = flight.p[::stride, index]
        title = f"{name} (leader)" if leads else name
        traces.append(_curve(title, _numbers(path[:, 0]), _numbers(path[:, 1]), line))
    for name, places, symbol in (
        ("start", flight.p[0], "circle-open"),
        ("end", flight.p[-1], "x"),
        ("waypoints", np.array(waypoints, dtype=np.float64).reshape(-1, 3), "star"),
    ):
        if len(places):
            marker = {"symbol": symbol, "size": 10, "color": style.PLAN if symbol == "star" else style.TRUTH}
            marks = _curve(name, _numbers(places[:, 0]), _numbers(places[:, 1]), {})
            traces.append(marks | {"mode": "markers", "marker": marker})
    layout = style.layout(x_title="x, m", y_title="y, m", height=560)
    layout["yaxis"] |= {"scaleanchor": "x", "scaleratio": 1}
    return {"data": traces, "layout": layout}


def _series(t: FloatArray, values: FloatArray, unit: str, colour: str, limit: float | None = None) -> Figure:
    """Return a metric over time; of long flights, the smallest and largest value of every stretch."""
    kept = np.arange(len(t))
    if len(t) > _POINTS_MAX:
        edges = np.linspace(0, len(t), _POINTS_MAX // 2 + 1).astype(np.int64)
        filled = np.where(
            np.isfinite(values), values, np.nanmean(values) if np.isfinite(values).any() else 0.0
        )
        extremes = [
            (low + int(filled[low:high].argmin()), low + int(filled[low:high].argmax()))
            for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        ]
        kept = np.unique(np.array(extremes).ravel())
    trace = _curve("", _numbers(t[kept]), _numbers(values[kept]), {"color": colour, "width": 1.6})
    layout = style.layout(x_title="time, s", y_title=unit, showlegend=False)
    layout["yaxis"]["rangemode"] = "tozero"
    if limit is not None:
        dotted = {"color": style.RED, "width": 1.2, "dash": "dot"}
        layout["shapes"] = [
            {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": limit, "y1": limit, "line": dotted}
        ]
    return {"data": [trace], "layout": layout}


def _curve(name: str, x: Sequence[Any], y: Sequence[Any], line: Mapping[str, Any]) -> Figure:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": html.escape(name),
        "x": list(x),
        "y": list(y),
        "line": dict(line),
    }


def _numbers(values: FloatArray) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in np.round(values, 3).tolist()]
