"""Plots of the tracking figures: one colour for each look of the neighbours and their surroundings."""

from collections.abc import Callable, Sequence
from typing import Any

from companion.logs import report_style as style
from sitl.bench.tracking_rows import ALL, TOGETHER, Row

_Look = tuple[bool, bool]
_LOOKS: dict[_Look, tuple[str, str]] = {
    (True, False): ("tape", style.ESTIMATE),
    (True, True): ("tape, distractors", style.COMMAND),
    (False, False): ("no tape", style.AUTOPILOT),
    (False, True): ("no tape, distractors", style.RED),
}
_HEIGHT = 320
_FARTHEST_M = 12.5
_FAINT = 0.35


def case_name(row: Row) -> str:
    """Return what was flown, for people."""
    count = row.neighbours
    extras = [] if count is None else [f"{count} neighbour{'s' * (count != 1)}"]
    extras += ["distractors"] if row.distractors else []
    extras += ["wind"] if row.windy else []
    extras += [] if row.tape else ["no tape"]
    return ", ".join([row.scene, *extras])


def figures(rows: Sequence[Row]) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return title and figure of every plot by a short name."""
    return {
        "detection": (
            "Detected, % of the scans in which a neighbour could be seen",
            _by_range(rows, lambda row: _percent(row.detection_rate), [(0.0, 8.0, 99.9), (8.0, 10.0, 98.0)]),
        ),
        "precision": (
            "Precision, % of the tracks",
            _by_range(rows, lambda row: _percent(row.precision), [(0.0, 12.0, 99.9)]),
        ),
        "position": (
            "Position error, RMSE, cm",
            _by_range(rows, lambda row: _times(row.position_rmse_m, 100.0), [(0.0, 12.0, 5.0)], True),
        ),
        "velocity": (
            "Velocity error, RMSE, m/s",
            _by_range(rows, lambda row: row.velocity_rmse_mps, [(0.0, 12.0, 0.15)], True),
        ),
        "consistency": (
            "NEES of the position by degree of freedom (1: the covariance is true)",
            _by_range(rows, lambda row: row.position_nees, [(0.0, 12.0, 1.0)], True),
        ),
        "time": ("Processor time of the tracker for one scan, ms", _times_by_neighbours(rows)),
    }


def _by_range(
    rows: Sequence[Row],
    value: Callable[[Row], float | None],
    promises: Sequence[tuple[float, float, float]],
    from_zero: bool = False,
) -> dict[str, Any]:
    """Return one quantity over range: a faint line for each case, a thick one for all that look alike.

    Args:
        rows: of one run.
        value: of a row.
        promises: (from, to, value) of dashed lines to compare with.
        from_zero: whether the vertical axis begins at 0.
    """
    traces: list[dict[str, Any]] = []
    for look, (label, colour) in _LOOKS.items():
        alike = [row for row in rows if (row.tape, row.distractors) == look and row.band_m != ALL]
        cases = list(dict.fromkeys(case_name(row) for row in alike))
        for case in sorted(cases, key=lambda name: name.startswith(TOGETHER)):
            points = [(row.range_m, value(row)) for row in alike if case_name(row) == case]
            known = [(far, figure) for far, figure in points if far is not None and figure is not None]
            main = len(cases) == 1 or case.startswith(TOGETHER)
            traces.append(
                {
                    "type": "scatter",
                    "mode": "lines+markers",
                    "name": label if main else case,
                    "text": case,
                    "showlegend": main,
                    "hovertemplate": "%{text}<br>%{x:.1f} m: %{y:.4g}<extra></extra>",
                    "opacity": 1.0 if main else _FAINT,
                    "x": [round(far, 2) for far, _ in known],
                    "y": [round(figure, 5) for _, figure in known],
                    "line": {"color": colour, "width": 2.5 if main else 1.0},
                    "marker": {"size": 7 if main else 4},
                }
            )
    lines = [
        {
            "type": "line", "x0": start, "x1": end, "y0": level, "y1": level,
            "line": {"color": style.GREEN, "width": 1, "dash": "dash"},
        }
        for start, end, level in promises
    ]  # fmt: skip
    layout = _layout("range, m")
    layout["xaxis"]["range"] = [0, _FARTHEST_M]
    layout["yaxis"]["rangemode"] = "tozero" if from_zero else "normal"
    if not from_zero:
        least = min((y for trace in traces for y in trace["y"]), default=99.0)
        layout["yaxis"]["range"] = [min(least, 99.0) - 0.5, 100.0 + 0.05 * (100.5 - min(least, 99.0))]
    return {"data": traces, "layout": {**layout, "shapes": lines}}


def _times_by_neighbours(rows: Sequence[Row]) -> dict[str, Any]:
    """Return median and 99th percentile of each case over the number of neighbours."""
    traces: list[dict[str, Any]] = []
    for look, (label, colour) in _LOOKS.items():
        alike = [
            row
            for row in rows
            if (row.tape, row.distractors) == look
            and row.band_m == ALL
            and row.neighbours is not None
            and row.latency_ms is not None
            and row.latency_p99_ms is not None
        ]
        if not alike:
            continue
        medians = [row.latency_ms or 0.0 for row in alike]
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": label,
                "text": [case_name(row) for row in alike],
                "hovertemplate": "%{text}<br>median %{y:.1f} ms<extra></extra>",
                "x": [row.neighbours for row in alike],
                "y": [round(median, 3) for median in medians],
                "error_y": {
                    "type": "data",
                    "symmetric": False,
                    "array": [
                        round((row.latency_p99_ms or 0.0) - median, 3)
                        for row, median in zip(alike, medians, strict=True)
                    ],
                    "arrayminus": [0.0] * len(alike),
                    "thickness": 1,
                },
                "marker": {"color": colour, "size": 7},
            }
        )
    layout = _layout("neighbours (whiskers up to the 99th percentile)")
    layout["yaxis"]["rangemode"] = "tozero"
    return {"data": traces, "layout": layout}


def _layout(across: str) -> dict[str, Any]:
    return {
        "height": _HEIGHT,
        "margin": {"l": 52, "r": 12, "t": 8, "b": 40},
        "xaxis": {"title": {"text": across}, "gridcolor": "#e9edf2", "zeroline": False},
        "yaxis": {"gridcolor": "#e9edf2", "zeroline": False},
        "plot_bgcolor": "#ffffff",
        "showlegend": True,
        "legend": {"orientation": "h", "y": -0.22, "font": {"size": 11}},
        "hovermode": "closest",
    }


def _percent(share: float | None) -> float | None:
    return _times(share, 100.0)


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value
