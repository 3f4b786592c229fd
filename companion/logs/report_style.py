"""Colours and the common layout of the report's plots."""

from typing import Any

from companion.logs.report_data import Phase

ESTIMATE = "#2563eb"
COMMAND = "#ea7a0c"
PLAN = "#f0a020"
TRUTH = "#111827"
AUTOPILOT = "#7c8aa0"
OBSTACLE = "#aab3c0"
GREEN = "#16a34a"
AMBER = "#d98e04"
RED = "#dc2626"
AXES = ("#d1495b", "#3a9d5d", "#8a63d2")

_GRID = "#e9edf2"
_INK = "#334155"
_FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"

PHASE_COLOURS: dict[str, str] = {
    # Autopilot modes.
    "offboard": "#93c5fd",
    "position": "#bbf7d0",
    "altitude": "#bbf7d0",
    "manual": "#bbf7d0",
    "stabilized": "#bbf7d0",
    "acro": "#bbf7d0",
    "hold": "#fde68a",
    "takeoff": "#ddd6fe",
    "land": "#ddd6fe",
    "mission": "#fde68a",
    "return": "#fecaca",
    # Companion states.
    "starting": "#e2e8f0",
    "standby": "#cbd5e1",
    "ready": "#ddd6fe",
    "engaging": "#bfdbfe",
    "active": "#93c5fd",
    "holding": "#fde68a",
    "landing": "#ddd6fe",
    "pilot": "#bbf7d0",
    "listening": "#fde68a",
    "lost": "#fca5a5",
    "done": "#cbd5e1",
    # Odometry and landing gear.
    "initialising": "#e2e8f0",
    "tracking": "#bbf7d0",
    "degraded": "#fde68a",
    "in the air": "#bfdbfe",
    "on the ground": "#e2e8f0",
}
UNKNOWN_COLOUR = "#eef2f6"


def phase_colour(label: str) -> str:
    """Return the colour of a mode, a state or a status."""
    return PHASE_COLOURS.get(label, UNKNOWN_COLOUR)


def layout(*, x_title: str, y_title: str, height: int = 280, **more: Any) -> dict[str, Any]:
    """Return the layout that all plots share."""
    axis = {
        "gridcolor": _GRID,
        "zerolinecolor": "#d5dce5",
        "linecolor": "#cbd5e1",
        "ticks": "outside",
        "tickcolor": "#cbd5e1",
        "ticklen": 4,
        "automargin": True,
    }
    return {
        "height": height,
        "margin": {"l": 52, "r": 14, "t": 30, "b": 42},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"family": _FONT, "size": 12, "color": _INK},
        "xaxis": {**axis, "title": {"text": x_title, "standoff": 6}},
        "yaxis": {**axis, "title": {"text": y_title, "standoff": 6}},
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "font": {"size": 11}},
        "showlegend": True,
        "hovermode": "closest",
        "hoverlabel": {"font": {"family": _FONT, "size": 12}},
        **more,
    }


def second_axis(title: str) -> dict[str, Any]:
    """Return a y axis on the right."""
    return {
        "overlaying": "y",
        "side": "right",
        "title": {"text": title, "standoff": 6},
        "showgrid": False,
        "rangemode": "tozero",
        "tickmode": "auto",
        "nticks": 5,
        "automargin": True,
    }


def mode_bands(modes: list[Phase]) -> list[dict[str, Any]]:
    """Return the autopilot's modes as coloured background."""
    return [
        {
            "type": "rect",
            "xref": "x",
            "yref": "paper",
            "x0": round(mode.start_s, 3),
            "x1": round(mode.end_s, 3),
            "y0": 0,
            "y1": 1,
            "fillcolor": phase_colour(mode.label),
            "opacity": 0.22,
            "line": {"width": 0},
            "layer": "below",
        }
        for mode in modes
    ]


def vertical_mark(x: float) -> dict[str, Any]:
    """Return a vertical line."""
    line = {"color": _INK, "width": 1, "dash": "dot"}
    return {"type": "line", "xref": "x", "yref": "paper", "x0": x, "x1": x, "y0": 0, "y1": 1, "line": line}


def mark_label(x: float, text: str, y: float) -> dict[str, Any]:
    """Return a text beside a vertical line."""
    return {
        "x": x,
        "y": y,
        "xref": "x",
        "yref": "paper",
        "xanchor": "right",
        "yanchor": "top",
        "text": text,
        "showarrow": False,
        "font": {"size": 11, "color": _INK},
        "bgcolor": "rgba(255,255,255,0.75)",
    }
