"""One flight, one page: what happened, in numbers and plots, from a log that may be half a log."""

import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from companion.errors import LogError
from companion.logs.reader import FlightRecording
from companion.logs.report_data import collect
from companion.logs.report_numbers import compute
from companion.logs.report_page import page
from companion.logs.report_plots import plots
from companion.logs.report_verdict import verdict, worst


def write_report(log_path: Path, html_path: Path) -> dict[str, Any]:
    """Write the report of a recorded flight and return all its numbers, ready for JSON.

    Args:
        log_path: the log, finished or not.
        html_path: the page, one self-contained file; an old one is replaced.

    Raises:
        LogError: if the log cannot be read, the page cannot be written or plotly is missing.
    """
    data = collect(FlightRecording(log_path))
    # A log may hold nonsense; what comes of it is not finite and is shown as missing.
    with np.errstate(all="ignore"):
        raw, comparison = compute(data)
        shown = plots(data, comparison)
    lines = verdict(raw)
    numbers: dict[str, Any] = _finite(raw)
    numbers["verdict"] = {
        "lamp": worst(lines).name.lower(),
        "lines": [{"title": line.title, "text": line.text, "lamp": line.lamp.name.lower()} for line in lines],
    }
    text = page(log_path.name, data, numbers, lines, shown)
    partial = html_path.with_name(html_path.name + ".partial")
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, html_path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise LogError(f"{html_path}: cannot be written: {error.strerror}") from error
    return numbers


def _finite(value: Any) -> Any:
    """Return the same structure with None where a number is not finite: JSON knows no NaN."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return value
