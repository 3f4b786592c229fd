"""The comparison as one HTML file that opens without a network, and as a Markdown table."""

import html
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from companion.logs import figure_page
from companion.logs import report_style as style
from companion.logs.figure_page import FigureBox, NoPlotsError
from companion.messages import FloatArray
from sitl.bench.comparison import Result, Row

RESULTS = "results.json"
TABLE = "table.md"
PAGE = "odometry.html"

_COLOURS = {
    "companion": style.ESTIMATE,
    "rko_lio": style.COMMAND,
    "kiss_icp": style.AXES[2],
    "small_gicp": style.GREEN,
}
_SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "star")
_POINTS_MAX = 1500
_FAR = 3.0  # the path from above shows this much around the truth, by its size

_STYLE = "th:nth-child(-n+2), td:nth-child(-n+2), td:last-child { text-align: left; }\n"
_LEAD = "The same flights for all, one system beside the other."

_DEFINITIONS = (
    "APE: root mean square distance of the body's path from the truth after the best rigid alignment. Drift: "
    "mean error of the motion over stretches of 20, 40 and 80 m, in percent. ms and CPU ms: real and "
    "processor time of the call that registers a scan, median and 99th percentile; sample: processor time of "
    "the call that takes one inertial sample. All systems took the same events in one process, one after the "
    "other in rotating order, on one thread each."
)


def write(folder: Path, results: Sequence[Result]) -> list[Path]:
    """Write rows as JSON, as a table and as a page with plots; returns the files.

    The page needs plotly; without it the other two are written.

    Raises:
        OSError: if the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows = [result.row for result in results]
    files = [folder / RESULTS, folder / TABLE]
    files[0].write_text(json.dumps({"rows": [row.as_dict() for row in rows]}, indent=1) + "\n", "utf-8")
    files[1].write_text(markdown(rows), "utf-8")
    try:
        text = page(results)
    except NoPlotsError:
        return files
    files.append(folder / PAGE)
    files[2].write_text(text, "utf-8")
    return files


def markdown(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table."""
    shown = [row.shown() for row in rows]
    columns = list(shown[0]) if shown else []
    lines = [columns, ["---" if column in ("world", "system", "note") else "---:" for column in columns]]
    lines += [[cell.strip().replace("|", "/") for cell in cells.values()] for cells in shown]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def page(results: Sequence[Result]) -> str:
    """Return the whole page.

    Args:
        results: of one run.

    Raises:
        NoPlotsError: if plotly is not installed.
    """
    rows = [result.row for result in results]
    worlds = list(dict.fromkeys(row.world for row in rows))
    title, caption = "Accuracy against processor time", "Nearer to the lower left is better."
    boxes = [FigureBox("cost", title, caption, _cost(rows, worlds), wide=True)]
    for index, world in enumerate(worlds):
        of_world = [result for result in results if result.row.world == world and result.judgement]
        if of_world:
            above = "Aligned with the truth as a whole."
            boxes.append(FigureBox(f"above{index}", f"{world}: from above", above, _above(of_world)))
            later = "Distance from the truth after that alignment."
            boxes.append(FigureBox(f"error{index}", f"{world}: error over time", later, _error(of_world)))
    setups = dict.fromkeys(f"{row.system}: {row.setup}" for row in rows if row.setup)
    notes = "".join(f'<p class="note">{html.escape(note)}</p>' for note in (_DEFINITIONS, *setups))
    return figure_page.page(
        "Odometry beside its peers",
        _LEAD,
        boxes,
        before=f'<section class="card">{_table(rows)}{notes}</section>',
        style=_STYLE,
        rows=[row.as_dict() for row in rows],
    )


def _table(rows: Sequence[Row]) -> str:
    if not rows:
        return "<p>No rows.</p>"
    head = "".join(f"<th>{html.escape(column)}</th>" for column in rows[0].shown())
    body = []
    before = ""
    for row in rows:
        cells = "".join(f"<td>{html.escape(cell.strip())}</td>" for cell in row.shown().values())
        body.append(f'<tr class="{"first" if row.world != before else ""}">{cells}</tr>')
        before = row.world
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"


def _cost(rows: Sequence[Row], worlds: Sequence[str]) -> dict[str, Any]:
    traces = []
    for system in dict.fromkeys(row.system for row in rows):
        known = [
            (row.world, row.cpu_ms_median, 100.0 * row.ape_rmse_m)
            for row in rows
            if row.system == system and row.cpu_ms_median is not None and row.ape_rmse_m is not None
        ]
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": system,
                "x": [round(cpu_ms, 3) for _, cpu_ms, _ in known],
                "y": [round(ape_cm, 3) for _, _, ape_cm in known],
                "text": [world for world, _, _ in known],
                "marker": {
                    "size": 12,
                    "color": _COLOURS.get(system, style.AUTOPILOT),
                    "symbol": [_SYMBOLS[worlds.index(world) % len(_SYMBOLS)] for world, _, _ in known],
                },
                "hovertemplate": "%{text}: %{y:.2f} cm, %{x:.2f} ms<extra>" + system + "</extra>",
            }
        )
    layout = style.layout(x_title="processor time per scan, ms (median)", y_title="APE, cm", height=420)
    layout["xaxis"]["type"] = layout["yaxis"]["type"] = "log"
    return {"data": traces, "layout": layout}


def _kept(values: FloatArray) -> slice:
    return slice(None, None, max(1, -(-len(values) // _POINTS_MAX)))


def _numbers(values: FloatArray, digits: int) -> list[float]:
    return [float(value) for value in np.round(values, digits)]


def _line(name: str, x: FloatArray, y: FloatArray, colour: str, **line: Any) -> dict[str, Any]:
    kept = _kept(x)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": _numbers(x[kept], 3),
        "y": _numbers(y[kept], 5),
        "line": {"color": colour, "width": 1.6, **line},
    }


def _above(results: Sequence[Result]) -> dict[str, Any]:
    fullest = max((result.judgement for result in results if result.judgement), key=lambda j: len(j.t_ns))
    p_true = fullest.p_true
    traces = [_line("truth", p_true[:, 0], p_true[:, 1], style.TRUTH, dash="dot", width=2.2)]
    for result in results:
        if result.judgement:
            p = result.judgement.p_laid
            colour = _COLOURS.get(result.row.system, style.AUTOPILOT)
            traces.append(_line(result.row.system, p[:, 0], p[:, 1], colour))
    layout = style.layout(x_title="x, m", y_title="y, m", height=420)
    middle, reach = p_true.mean(axis=0), _FAR * float(np.abs(p_true - p_true.mean(axis=0)).max()) / 2.0
    layout["xaxis"]["range"] = _numbers(np.array([middle[0] - reach, middle[0] + reach]), 2)
    layout["yaxis"] |= {"scaleanchor": "x", "scaleratio": 1}
    return {"data": traces, "layout": layout}


def _error(results: Sequence[Result]) -> dict[str, Any]:
    traces = []
    for result in results:
        if result.judgement:
            t_s = np.asarray(1e-9 * (result.judgement.t_ns - result.start_ns), dtype=np.float64)
            error_cm = np.maximum(100.0 * result.judgement.error_m, 1e-3)
            traces.append(
                _line(result.row.system, t_s, error_cm, _COLOURS.get(result.row.system, style.AUTOPILOT))
            )
    layout = style.layout(x_title="time, s", y_title="error, cm", height=420)
    layout["yaxis"]["type"] = "log"
    return {"data": traces, "layout": layout}
