"""The tracking figures as one HTML file that opens without a network, as JSON and as a Markdown table."""

import html
import json
from collections.abc import Sequence
from pathlib import Path

from companion.logs import figure_page
from companion.logs.figure_page import FigureBox, NoPlotsError
from sitl.bench.tracking_plots import case_name, figures
from sitl.bench.tracking_rows import ALL, TOGETHER, Row

RESULTS = "tracking.json"
TABLE = "tracking.md"
PAGE = "tracking.html"

_STYLE = """main { max-width: 1440px; }
table { font-size: 12px; } th, td { padding: 2px 9px 2px 0; }
th:first-child, td:first-child { text-align: left; position: sticky; left: 0; background: #fff; }
tr.first td { font-weight: 600; }
"""
_LEAD = (
    "Other UAVs by our own tracker and odometry. Thick: all cases that look alike, thin: each case; dashed: "
    "what is promised with tape."
)

DEFINITIONS = (
    "Our odometry is in the loop; truth only judges.",
    "Detection rate: of the scans in which a neighbour could be seen, the share with a validated track "
    "within 0.5 m. It could be seen if at the scan's start, middle and end its centre was in the field of "
    "view, which tilts with the body, two or more of five test rays to it were clear, it was nearer than "
    "12 m, the own vehicle was flying, and all that without a break for 0.5 s. At once: without that half "
    "second.",
    "Precision: of the validated tracks seen within the last 0.5 s, from power-on, the share within 0.5 m "
    "of a neighbour; a second track of the same neighbour is false.",
    "95 %: Wilson's interval, with as many independent samples as seconds of track, or fewer if failures "
    "last longer than a second.",
    "Errors are those of matched tracks of neighbours that count, relative to the own pose, as lengths "
    "over all three axes; by axis: along the line of sight, across it, up. Steady: where the neighbour "
    "changed its velocity by less than 0.7 m/s^2. Relative velocity: with the error of the own one.",
    "NEES: squared error by covariance and degree of freedom, 1 if the covariance is true; n: independent "
    "samples in it, as the errors' own correlation tells; with the 95 % bounds of a mean of so many.",
    "Switches: changes of the number of a neighbour's track, also after it was out of sight, by minute of "
    "flight of the whole swarm. Acquired: time from coming into sight until validated (median). ms: "
    "processor time of the tracker for one scan (median).",
)


def write(folder: Path, rows: Sequence[Row]) -> list[Path]:
    """Write rows as JSON, as a table and as a page with plots; returns the files.

    The page needs plotly; without it the other two are written.

    Raises:
        OSError: if the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / RESULTS, folder / TABLE]
    files[0].write_text(json.dumps({"rows": [row.as_dict() for row in rows]}, indent=1) + "\n", "utf-8")
    files[1].write_text(markdown(rows), "utf-8")
    try:
        text = page(rows)
    except NoPlotsError:
        return files
    files.append(folder / PAGE)
    files[2].write_text(text, "utf-8")
    return files


def shown(row: Row) -> dict[str, str]:
    """Return a row as short text for people."""
    whole = row.band_m == ALL
    return {
        "case": case_name(row),
        "range m": row.band_m,
        "steps": str(row.counted),
        "detected %": _cell(row.detection_rate, 2, 100.0),
        "detected >=": _cell(row.detection_ci95 and row.detection_ci95[0], 2, 100.0),
        "at once": _cell(row.detection_rate_at_once, 2, 100.0),
        "tracked": str(row.track_steps),
        "precise %": _cell(row.precision, 2, 100.0),
        "precise >=": _cell(row.precision_ci95 and row.precision_ci95[0], 2, 100.0),
        "p cm": _cell(row.position_rmse_m, 1, 100.0),
        "v m/s": _cell(row.velocity_rmse_mps, 2),
        "steady v": _cell(row.velocity_rmse_steady_mps, 2),
        "v axes": _axes(row.velocity_rmse_axes_mps),
        "NEES p": _cell(row.position_nees, 2),
        "p bounds (n)": _bounds(row.position_nees_bounds, row.position_nees_samples),
        "NEES v": _cell(row.velocity_nees, 2),
        "v bounds (n)": _bounds(row.velocity_nees_bounds, row.velocity_nees_samples),
        "switches/min": f"{row.id_switches_per_min:.2f}" if whole else "",
        "acquired s": _cell(row.acquired_s, 1) if whole else "",
        "ms": _cell(row.latency_ms, 1) if whole else "",
        "ms p99": _cell(row.latency_p99_ms, 1) if whole else "",
    }


def markdown(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table."""
    cells = [shown(row) for row in rows]
    columns = list(cells[0]) if cells else []
    lines = [columns, ["---" if column == "case" else "---:" for column in columns]]
    lines += [list(cell.values()) for cell in cells]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def page(rows: Sequence[Row]) -> str:
    """Return the whole page.

    Args:
        rows: of one run.

    Raises:
        NoPlotsError: if plotly is not installed.
    """
    boxes = [FigureBox(name, title, "", figure) for name, (title, figure) in figures(rows).items()]
    whole = sorted((row for row in rows if row.band_m == ALL), key=lambda row: row.scene != TOGETHER)
    meanings = "".join(f'<p class="note">{html.escape(line)}</p>' for line in DEFINITIONS)
    return figure_page.page(
        "Neighbours as seen",
        _LEAD,
        boxes,
        before=f'<section class="card">{_table(whole)}</section>',
        after=f'<section class="card"><h2>What the figures mean</h2>{meanings}</section>'
        '<section class="card"><details><summary>All figures by range</summary>'
        f"{_table(rows)}</details></section>",
        style=_STYLE,
        rows=[row.as_dict() for row in rows],
    )


def _cell(value: float | None, digits: int, scale: float = 1.0) -> str:
    return "-" if value is None else f"{scale * value:.{digits}f}"


def _axes(values: tuple[float, ...] | None) -> str:
    return "-" if values is None else " ".join(f"{value:.2f}" for value in values)


def _bounds(values: tuple[float, float] | None, samples: int) -> str:
    return "-" if values is None else f"{values[0]:.2f}-{values[1]:.2f} ({samples})"


def _table(rows: Sequence[Row]) -> str:
    if not rows:
        return "<p>No rows.</p>"
    head = "".join(f"<th>{html.escape(column)}</th>" for column in shown(rows[0]))
    body = []
    for row in rows:
        cells = "".join(f"<td>{html.escape(cell)}</td>" for cell in shown(row).values())
        body.append(f'<tr class="{"first" if row.band_m == ALL else ""}">{cells}</tr>')
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
