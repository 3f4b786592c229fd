"""Puts the report together: one HTML file that opens without a network.

Everything that comes from the log is escaped; a content security policy forbids every load from outside.
"""

import html
import json
import math
from importlib import resources
from string import Template

from companion.errors import LogError
from companion.logs import report_numbers, report_style
from companion.logs.report_data import FlightData, Phase
from companion.logs.report_events import event_rows
from companion.logs.report_numbers import Numbers
from companion.logs.report_plots import Plot
from companion.logs.report_verdict import Lamp, Line, worst

_HEADLINES = {
    Lamp.UNKNOWN: "Nothing to judge",
    Lamp.GREEN: "A clean flight",
    Lamp.AMBER: "Worth a look",
    Lamp.RED: "Needs attention",
}
_CONFIGURATION_MAX = 200_000


def page(title: str, data: FlightData, numbers: Numbers, lines: list[Line], plots: list[Plot]) -> str:
    """Return the whole page.

    Raises:
        LogError: if the plotting library is not installed.
    """
    template = Template(resources.files("companion.logs").joinpath("report_page.html").read_text("utf-8"))
    lamp = worst(lines)
    return template.substitute(
        title=html.escape(title),
        headline=_HEADLINES[lamp],
        lamp=lamp.name.lower(),
        facts="".join(f"<span>{html.escape(fact)}</span>" for fact in _facts(data)),
        verdict="".join(_verdict_row(line) for line in lines),
        ribbon=_ribbon(data),
        plots="".join(_plot_box(plot) for plot in plots),
        events=_events(data),
        configuration=_configuration(data),
        log=_log_table(numbers),
        figures=_script_json({plot.name: {**plot.figure, "timed": plot.timed} for plot in plots}),
        numbers=_script_json(numbers),
        plotly=_plotly(),
    )


def _plotly() -> str:
    try:
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise LogError("reports need plotly: pip install 'companion[report]'") from error
    return str(get_plotlyjs()).replace("</script", "<\\/script")


def _script_json(value: object) -> str:
    """Return JSON that is safe inside a script element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _facts(data: FlightData) -> list[str]:
    order = ("vehicle", "role", "mode", "seed", "git_commit")
    known = [(name, data.flight[name]) for name in order if name in data.flight]
    return [text if name in ("vehicle", "role", "mode") else f"{name} {text[:12]}" for name, text in known]


def _verdict_row(line: Line) -> str:
    lamp = line.lamp.name.lower()
    return (
        f'<tr><td><i class="lamp {lamp}" title="{lamp}"></i></td>'
        f"<th>{html.escape(line.title)}</th><td>{html.escape(line.text)}</td></tr>"
    )


def _ribbon(data: FlightData) -> str:
    rows = (
        ("Companion", report_numbers.state_phases(data)),
        ("Autopilot", report_numbers.mode_phases(data)),
        ("Vehicle", report_numbers.airborne_phases(data)),
        ("Odometry", report_numbers.odometry_phases(data)),
    )
    body = "".join(_ribbon_row(name, found, data.duration_s) for name, found in rows if found)
    if not body:
        return '<p class="none">No states in this log.</p>'
    return f'{body}<div class="row"><b></b><div class="ticks">{_ribbon_ticks(data.duration_s)}</div></div>'


def _ribbon_ticks(duration_s: float) -> str:
    """Return four to eight round times below the ribbon."""
    step = 10.0 ** math.floor(math.log10(max(duration_s, 1e-3) / 4.0))
    step *= next(factor for factor in (5.0, 2.0, 1.0) if duration_s / (step * factor) >= 4.0 or factor == 1.0)
    times = [index * step for index in range(int(duration_s / step * 0.98) + 1)]
    return "".join(
        f'<span style="left:{100.0 * t / max(duration_s, 1e-9):.2f}%">{t:g}{"" if index else " s"}</span>'
        for index, t in enumerate(times)
    )


def _ribbon_row(name: str, found: list[Phase], duration_s: float) -> str:
    total = max(duration_s, 1e-9)
    parts = []
    for phase in found[:2000]:
        left = 100.0 * min(max(phase.start_s / total, 0.0), 1.0)
        width = max(0.15, 100.0 * min(phase.end_s / total, 1.0) - left)
        label = html.escape(phase.label)
        tip = f"{label}, {phase.start_s:.1f} to {phase.end_s:.1f} s"
        text = label if width > 0.9 * len(phase.label) + 1.0 else ""
        parts.append(
            f'<span style="left:{left:.3f}%;width:{width:.3f}%;background:'
            f'{report_style.phase_colour(phase.label)}" title="{tip}">{text}</span>'
        )
    return f'<div class="row"><b>{name}</b><div class="band">{"".join(parts)}</div></div>'


def _plot_box(plot: Plot) -> str:
    wide = " wide" if plot.wide else ""
    return (
        f'<figure class="card{wide}"><h2>{html.escape(plot.title)}</h2>'
        f'<div class="plot" id="plot-{plot.name}"></div>'
        f"<figcaption>{html.escape(plot.caption)}</figcaption></figure>"
    )


def _events(data: FlightData) -> str:
    rows, left_out = event_rows(data)
    if not rows:
        return '<p class="none">No events in this log.</p>'
    body = "".join(
        f'<tr class="{row.level}"><td>{row.t_s:.2f}</td><td>{html.escape(row.kind)}</td>'
        f"<td>{html.escape(row.text)}</td></tr>"
        for row in rows
    )
    note = f'<p class="none">{left_out} events in the middle are not shown.</p>' if left_out else ""
    return (
        f"<table><thead><tr><th>s</th><th>what</th><th></th></tr></thead><tbody>{body}</tbody></table>{note}"
    )


def _configuration(data: FlightData) -> str:
    text = data.configuration[:_CONFIGURATION_MAX]
    configuration = f"<pre>{html.escape(text)}</pre>" if text.strip() else '<p class="none">Not recorded.</p>'
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(version)}</td></tr>"
        for name, version in data.versions.items()
    )
    return f'{configuration}<table class="plain"><tbody>{rows}</tbody></table>'


def _log_table(numbers: Numbers) -> str:
    counts, missing = numbers["log"]["messages_by_topic"], numbers["log"]["missing_by_topic"]
    rows = "".join(
        f"<tr><td>{html.escape(topic)}</td><td>{count}</td><td>{missing.get(topic, 0)}</td></tr>"
        for topic, count in counts.items()
    )
    head = "<thead><tr><th>channel</th><th>messages</th><th>left out</th></tr></thead>"
    return f'<table class="counts">{head}<tbody>{rows}</tbody></table>'
