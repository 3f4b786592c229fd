"""The report's plots as Plotly figures: plain dictionaries of rounded numbers."""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.geometry.trajectory_comparison import Comparison
from companion.logs import report_style as style
from companion.logs.report_data import FlightData
from companion.logs.report_numbers import STREAM_GAP_LIMIT_MS, gaps_ms, latencies_ms, mode_phases
from companion.messages import FloatArray

Figure = dict[str, Any]

_POINTS_MAX = 2400
_OBSTACLES_MAX = 6000
_PATHS_SHOWN = 60


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot on the page.

    Attributes:
        name: identifier in the page.
        caption: how to read it, one or two sentences.
        timed: its x axis is the flight's time, shared with the other timed plots.
        wide: it takes the page's whole width.
    """

    name: str
    title: str
    caption: str
    figure: Figure
    timed: bool = True
    wide: bool = False


def plots(data: FlightData, comparison: Comparison | None) -> list[Plot]:
    """Return the plots for which the log has data, in the order of the page."""
    candidates = [
        _top_view(data, comparison),
        _height(data, comparison),
        *(_velocity(data, axis) for axis in "xyz"),
        _surroundings(data),
        _error(comparison, data),
        _health(data),
        _latency(data),
        _gaps(data),
        _loss(data),
        _clock(data),
    ]
    return [plot for plot in candidates if plot is not None]


def _thinned(y: FloatArray, limit: int = _POINTS_MAX) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return indices that keep the smallest and the largest value of every stretch: spikes survive."""
    if len(y) <= limit:
        return np.arange(len(y))
    edges = np.linspace(0, len(y), limit // 2 + 1).astype(np.int64)
    kept: list[int] = []
    filled = np.where(np.isfinite(y), y, 0.0)
    for start, end in itertools.pairwise(edges.tolist()):
        stretch = filled[start:end]
        kept += sorted({int(start + stretch.argmin()), int(start + stretch.argmax())})
    return np.array(kept)


def _numbers(values: FloatArray, digits: int) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in np.round(values, digits).tolist()]


def _line(name: str, t: FloatArray, y: FloatArray, colour: str, **more: Any) -> Figure:
    kept = _thinned(y)
    line = {"color": colour, "width": more.pop("width", 1.6), "dash": more.pop("dash", "solid")}
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": _numbers(t[kept], 3),
        "y": _numbers(y[kept], 4),
        "line": line,
        **more,
    }


def _plan_view(name: str, p: FloatArray, colour: str, **more: Any) -> Figure:
    stride = max(1, len(p) // _POINTS_MAX)
    line = {"color": colour, "width": more.pop("width", 2.2), "dash": more.pop("dash", "solid")}
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": _numbers(p[::stride, 0], 3),
        "y": _numbers(p[::stride, 1], 3),
        "line": line,
        "hoverinfo": "name",
        **more,
    }


def _markers(name: str, p: FloatArray, **marker: Any) -> Figure:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": _numbers(p[:, 0], 3),
        "y": _numbers(p[:, 1], 3),
        "marker": marker,
    }


def _timed(data: FlightData, traces: list[Figure], unit: str, **layout: Any) -> Figure:
    layout = style.layout(x_title="time, s", y_title=unit, **layout)
    layout["xaxis"]["range"] = [0.0, round(max(data.duration_s, 0.1), 3)]
    layout["shapes"] = [*layout.get("shapes", []), *style.mode_bands(mode_phases(data))]
    return {"data": traces, "layout": layout}


def _top_view(data: FlightData, comparison: Comparison | None) -> Plot | None:
    p = data.odometry["x y"]
    p = p[np.all(np.isfinite(p), axis=1)]
    if not len(p):
        return None
    traces: list[Figure] = []
    cells = data.obstacles.centres_map()
    if len(cells):
        stride = -(-len(cells) // _OBSTACLES_MAX)
        traces.append(
            _markers("obstacles", cells[::stride], size=4, color=style.OBSTACLE, symbol="square")
            | {"hoverinfo": "skip"}
        )
    traces.extend(_planned_paths(data))
    if comparison is not None:
        traces.append(_plan_view("truth", comparison.p_truth, style.TRUTH, dash="dot", width=2.0))
    traces.append(_plan_view("odometry", p, style.ESTIMATE))
    traces.append(_markers("start", p[:1], size=11, color=style.GREEN, line={"color": "white", "width": 2}))
    if data.plans:
        goals = np.unique(np.array([plan.goal_map[:2] for plan in data.plans]), axis=0)
        traces.append(_markers("goals", goals, size=15, color=style.PLAN, symbol="star"))
    layout = style.layout(x_title="x (map), m", y_title="y (map), m", height=520)
    layout["yaxis"] |= {"scaleanchor": "x", "scaleratio": 1}
    caption = (
        "Seen from above, x forward where the odometry started. Grey: LiDAR returns within half a metre of "
        "the vehicle's height."
    )
    return Plot("top", "Flight path", caption, {"data": traces, "layout": layout}, timed=False, wide=True)


def _planned_paths(data: FlightData) -> list[Figure]:
    paths = [plan.path_map for plan in data.plans if len(plan.path_map) > 1]
    if not paths:
        return []
    gap = np.full((1, 3), np.nan)
    shown = paths[:: -(-len(paths) // _PATHS_SHOWN)]
    joined = np.concatenate([part for path in shown for part in (path, gap)])
    trace = _plan_view("plans", joined, style.PLAN, width=1.2) | {"opacity": 0.45}
    trace["x"], trace["y"] = _numbers(joined[:, 0], 3), _numbers(joined[:, 1], 3)
    return [trace]


def _height(data: FlightData, comparison: Comparison | None) -> Plot | None:
    traces = []
    if comparison is not None:
        traces.append(_line("truth", comparison.t, comparison.p_truth[:, 2], style.TRUTH, dash="dot"))
    if len(data.vehicle):
        traces.append(_line("autopilot", data.vehicle["t"], data.vehicle["z"], style.AUTOPILOT))
    if len(data.odometry):
        traces.append(_line("odometry", data.odometry["t"], data.odometry["z"], style.ESTIMATE))
    if not traces:
        return None
    caption = "Height over the start. The background shows the autopilot's mode in every plot over time."
    return Plot("height", "Height", caption, _timed(data, traces, "z (map), m"))


def _velocity(data: FlightData, axis: str) -> Plot | None:
    if not len(data.setpoints) and not len(data.odometry):
        return None
    name = f"v{axis}"
    traces = []
    if len(data.vehicle):
        traces.append(_line("autopilot", data.vehicle["t"], data.vehicle[name], style.AUTOPILOT, width=1.2))
    if len(data.odometry):
        traces.append(_line("odometry", data.odometry["t"], data.odometry[name], style.ESTIMATE))
    if len(data.setpoints):
        t, v = _broken(data.setpoints["t"], data.setpoints[name])
        traces.append(_line("commanded", t, v, style.COMMAND, line_shape="hv"))
        traces[-1]["line"]["shape"] = traces[-1].pop("line_shape")
    caption = {
        "x": "Is it the planner or the vehicle? Where blue follows orange late, the vehicle lags; where "
        "orange itself is odd, the companion asked for it.",
        "y": "Velocity to the left in the map frame.",
        "z": "Velocity upwards.",
    }[axis]
    return Plot(f"velocity_{axis}", f"Velocity {axis}", caption, _timed(data, traces, f"{name} (map), m/s"))


def _surroundings(data: FlightData) -> Plot | None:
    if not len(data.given) and not len(data.grids):
        return None
    traces = []
    if len(data.given):
        t = data.given["t"]
        traces.append(_line("neighbours", t, data.given["count"], style.TRUTH, width=1.2, yaxis="y2"))
        traces[-1]["line"]["shape"] = "hv"
        traces.append(_line("nearest neighbour", t, data.given["nearest"], style.ESTIMATE))
    if len(data.grids):
        traces.append(
            _line("nearest obstacle", data.grids["t"], data.grids["nearest"], style.OBSTACLE, width=1.2)
        )
    figure = _timed(data, traces, "range, m")
    figure["layout"]["yaxis"]["rangemode"] = "tozero"
    figure["layout"]["yaxis2"] = style.second_axis("neighbours")
    caption = "What the follower's law was given: how many neighbours, and how near the nearest things were."
    return Plot("surroundings", "Neighbours and obstacles", caption, figure)


def _broken(t: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Insert a gap where the stream paused, so that no line suggests a command that was not there."""
    pauses = np.flatnonzero(np.diff(t) > STREAM_GAP_LIMIT_MS * 1e-3) + 1
    return np.insert(t, pauses, t[pauses - 1] if len(pauses) else 0.0), np.insert(y, pauses, np.nan)


def _error(comparison: Comparison | None, data: FlightData) -> Plot | None:
    if comparison is None:
        return None
    difference = comparison.p_estimate - comparison.p_truth
    traces = [
        _line(axis, comparison.t, difference[:, index], colour, width=1.2)
        for index, (axis, colour) in enumerate(zip("xyz", style.AXES, strict=True))
    ]
    traces.append(_line("distance", comparison.t, comparison.error_m, style.TRUTH, width=2.0))
    drift = (
        "" if comparison.drift_percent is None else f", drift {comparison.drift_percent:.2f} % of the path"
    )
    caption = (
        f"Odometry minus truth, both laid together at the start. RMSE after alignment "
        f"{comparison.ape_rmse_m:.3f} m{drift}."
    )
    return Plot("error", "Odometry error", caption, _timed(data, traces, "m"))


def _health(data: FlightData) -> Plot | None:
    if not len(data.odometry):
        return None
    t = data.odometry["t"]
    # Before the start the estimate knows nothing, and says so with a sigma of a kilometre.
    known = np.where(data.odometry["quality"] > 0, data.odometry["sigma"], np.nan)
    sigma = _line("position sigma", t, known, style.AXES[2], yaxis="y2", width=1.2)
    figure = _timed(data, [_line("quality", t, data.odometry["quality"], style.ESTIMATE), sigma], "quality")
    figure["layout"]["yaxis"]["range"] = [0, 105]
    figure["layout"]["yaxis2"] = style.second_axis("sigma, m")
    caption = "Quality 0 (do not use) to 100, and the estimate's own standard deviation of position."
    return Plot("health", "Odometry health", caption, figure)


def _histogram(values: FloatArray, colour: str, unit: str, marks: list[tuple[float, str]]) -> Figure:
    upper = max(float(values.max()), *(x for x, _ in marks)) * 1.05 + 1e-6
    counts, edges = np.histogram(values, bins=60, range=(0.0, upper))
    bars = {
        "type": "bar",
        "x": _numbers((edges[:-1] + edges[1:]) / 2.0, 3),
        "y": counts.tolist(),
        "width": round(float(edges[1] - edges[0]), 4),
        "marker": {"color": colour},
        "hovertemplate": "%{x:.1f} ms: %{y}<extra></extra>",
    }
    layout = style.layout(x_title=unit, y_title="count", showlegend=False, bargap=0.06)
    layout["xaxis"]["range"] = [0.0, round(upper, 3)]
    layout["shapes"] = [style.vertical_mark(x) for x, _ in marks]
    layout["annotations"] = [
        style.mark_label(x, text, 1.0 - 0.13 * index) for index, (x, text) in enumerate(marks)
    ]
    return {"data": [bars], "layout": layout}


def _latency(data: FlightData) -> Plot | None:
    values = latencies_ms(data)
    if not len(values):
        return None
    p50, p99 = np.percentile(values, [50.0, 99.0]).tolist()
    figure = _histogram(
        values, style.ESTIMATE, "ms", [(p50, f"p50 {p50:.0f} ms"), (p99, f"p99 {p99:.0f} ms")]
    )
    caption = "From the last LiDAR packet of a scan to the first setpoint that rests on it."
    return Plot("latency", "Latency", caption, figure, timed=False)


def _gaps(data: FlightData) -> Plot | None:
    values = gaps_ms(data)
    if not len(values):
        return None
    longest = float(values.max())
    figure = _histogram(values, style.COMMAND, "ms", [(longest, f"longest {longest:.0f} ms")])
    figure["layout"]["yaxis"]["type"] = "log"
    caption = "Time between setpoints in OFFBOARD, counted on a logarithmic axis. PX4 takes over after a gap."
    return Plot("gaps", "Setpoint gaps", caption, figure, timed=False)


def _loss(data: FlightData) -> Plot | None:
    if len(data.lidar) > 1:
        packets, lost = np.diff(data.lidar["packets"]), np.diff(data.lidar["lost"])
        t = data.lidar["t"][1:]
    elif len(data.frames):
        packets = data.frames["packets"]
        lost = np.maximum(data.frames["expected"] - packets, 0.0)
        t = data.frames["t"]
    else:
        return None
    total = np.maximum(packets + lost, 1.0)
    traces = [_line("lost", t, 100.0 * np.maximum(lost, 0.0) / total, style.RED, fill="tozeroy")]
    figure = _timed(data, traces, "% of packets", showlegend=False)
    figure["layout"]["yaxis"]["rangemode"] = "tozero"
    return Plot("loss", "LiDAR packet loss", "Packets missing by the sensor's own counter.", figure)


def _clock(data: FlightData) -> Plot | None:
    table = data.frames if len(data.frames) else data.lidar
    offset = table["offset_ms"]
    finite = np.isfinite(offset)
    if not finite.any():
        return None
    first = float(offset[finite][0])
    trace = _line("offset", table["t"], offset - first, style.AUTOPILOT)
    caption = f"Host time minus LiDAR time, relative to its first value of {first:.3f} ms. A slope is drift."
    figure = _timed(data, [trace], "ms", showlegend=False)
    figure["layout"]["yaxis"]["exponentformat"] = "none"
    return Plot("clock", "Clock offset", caption, figure)
