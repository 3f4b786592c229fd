"""Tables and plots as one HTML file that opens without a network.

A content security policy forbids every load from outside; whatever comes from data must be escaped by the
caller where it is given as HTML, and is escaped here where it is given as text.
"""

import html
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

from companion.errors import LogError

Figure = dict[str, Any]


class NoPlotsError(LogError):
    """The library that draws is not installed; what needs no plots can still be written."""


@dataclass(frozen=True, slots=True)
class FigureBox:
    """One plot on a page.

    Attributes:
        name: identifier in the page, letters, digits and dashes.
        title: its heading.
        caption: how to read it, one or two sentences; or empty.
        figure: Plotly's data and layout as plain values, without any that is not finite.
        wide: it takes the page's whole width.
    """

    name: str
    title: str
    caption: str
    figure: Figure
    wide: bool = False


_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:">
<title>$title</title>
<style>
* { box-sizing: border-box; }
body { margin: 0; background: #f5f7fa; color: #1e293b;
  font: 15px/1.45 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1240px; margin: 0 auto; padding: 22px 16px 60px; }
h1 { font-size: 22px; margin: 0 0 4px; } h2 { font-size: 14px; margin: 0 0 6px; }
.lead { color: #64748b; margin: 0 0 14px; }
.card { background: #fff; border: 1px solid #e5e9f0; border-radius: 10px; padding: 14px 16px;
  margin: 0 0 14px; overflow-x: auto; }
.grid { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 14px; margin: 0 0 14px; }
.grid .card { margin: 0; } .wide { grid-column: 1 / -1; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 14px; }
th, td { padding: 3px 14px 3px 0; text-align: right; white-space: nowrap; }
th.name, td.name { text-align: left; }
thead th { color: #64748b; border-bottom: 1px solid #e5e9f0; font-weight: 600; }
tr.first td { border-top: 1px solid #e5e9f0; }
tr.paper td { color: #64748b; font-style: italic; }
tr.paper td:first-child { color: inherit; font-style: normal; }
figcaption, p.note, li.note { color: #64748b; font-size: 13px; margin: 6px 0 0; }
details { margin: 6px 0; } summary { cursor: pointer; }
a { color: #2563eb; } code { font-size: 13px; }
@media (max-width: 760px) { .grid { grid-template-columns: minmax(0, 1fr); } }
$style</style>
</head>
<body>
<main>
<h1>$title</h1>
<p class="lead">$lead</p>
$before
<section class="grid">$plots</section>
$after
</main>
$scripts
</body>
</html>
""")

_SCRIPTS = Template("""<script>$plotly</script>
<script>
"use strict";
for (const [name, figure] of Object.entries($figures)) {
  Plotly.newPlot(document.getElementById("plot-" + name), figure.data, figure.layout,
    { responsive: true, displaylogo: false, displayModeBar: false });
}
</script>""")


def page(
    title: str,
    lead: str,
    boxes: Sequence[FigureBox] = (),
    *,
    before: str = "",
    after: str = "",
    style: str = "",
    rows: Sequence[object] | None = None,
) -> str:
    """Return the whole page.

    Args:
        title: heading, plain text.
        lead: one sentence under it, plain text.
        boxes: the plots, in their order.
        before: HTML above the plots.
        after: HTML below them.
        style: rules for this page alone, CSS.
        rows: what the tables show, for programs that read the page: JSON in the element `rows`.

    Raises:
        NoPlotsError: if there are plots and the plotting library is not installed.
    """
    scripts = ""
    if rows is not None:
        scripts = f'<script type="application/json" id="rows">{script_json(rows)}</script>\n'
    if boxes:
        figures = script_json({box.name: box.figure for box in boxes})
        scripts += _SCRIPTS.substitute(plotly=plotly_script(), figures=figures)
    return _PAGE.substitute(
        title=html.escape(title),
        lead=html.escape(lead),
        before=before,
        plots="".join(_box(box) for box in boxes),
        after=after,
        style=style,
        scripts=scripts,
    )


def script_json(value: object) -> str:
    """Return JSON that is safe inside a script element.

    Raises:
        ValueError: if a number in it is not finite.
    """
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def plotly_script() -> str:
    """Return the plotting library's script, safe inside a script element.

    Raises:
        NoPlotsError: if it is not installed.
    """
    try:
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise NoPlotsError("plots need plotly: pip install 'companion[report]'") from error
    return str(get_plotlyjs()).replace("</script", "<\\/script")


def write_whole(path: Path, text: str) -> None:
    """Write a text file that appears whole or not at all; an old one is replaced.

    Raises:
        LogError: if it cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error


def _box(box: FigureBox) -> str:
    wide = " wide" if box.wide else ""
    caption = f"<figcaption>{html.escape(box.caption)}</figcaption>" if box.caption else ""
    return (
        f'<figure class="card{wide}" style="margin:0"><h2>{html.escape(box.title)}</h2>'
        f'<div id="plot-{box.name}"></div>{caption}</figure>'
    )
