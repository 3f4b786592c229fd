"""Everything that happened, as rows of a table."""

from dataclasses import dataclass

from companion.logs.report_data import Event, FlightData
from companion.messages import Authorisation, FlightState, ModeRequest, Severity, StateChange

_ROWS_MAX = 600


@dataclass(frozen=True, slots=True)
class EventRow:
    """One event; `level` is "info", "warning" or "error"."""

    t_s: float
    kind: str
    text: str
    level: str


def event_rows(data: FlightData) -> tuple[list[EventRow], int]:
    """Return the events in order of time, and how many were left out in the middle of a long list."""
    rows = [_row(t, event) for t, event in data.events]
    rows += [EventRow(t, "mode", f"autopilot mode {mode.value}", "info") for t, mode in data.modes]
    rows += [EventRow(t, "vehicle", landed.value.replace("_", " "), "info") for t, landed in data.landed]
    rows += _switches(data, "armed", ("armed", "disarmed"), ("info", "info"))
    rows += _switches(data, "connected", ("autopilot connected", "autopilot silent"), ("info", "error"))
    rows += _switches(data, "failsafe", ("autopilot failsafe", "autopilot failsafe over"), ("error", "info"))
    rows += [EventRow(t, "plan", status, _plan_level(status)) for t, status in data.plan_statuses]
    rows.sort(key=lambda row: row.t_s)
    left_out = max(0, len(rows) - _ROWS_MAX)
    if left_out:
        rows = rows[: _ROWS_MAX // 2] + rows[-_ROWS_MAX // 2 :]
    return rows, left_out


def _row(t: float, event: Event) -> EventRow:
    if isinstance(event, StateChange):
        level = "error" if event.current is FlightState.LOST else "info"
        level = "warning" if event.current in (FlightState.HOLDING, FlightState.PILOT) else level
        text = f"{event.previous.value} → {event.current.value}: {event.reason}"
        return EventRow(t, "state", text, level)
    if isinstance(event, ModeRequest):
        return EventRow(t, "request", f"asked for {event.mode.value}", "info")
    if isinstance(event, Authorisation):
        return EventRow(
            t, "operator", f"{'authorised' if event.granted else 'withdrew'} by {event.source}", "info"
        )
    level = "error" if event.severity <= Severity.ERROR else "info"
    return EventRow(t, "text", event.text, "warning" if event.severity is Severity.WARNING else level)


def _switches(
    data: FlightData, column: str, texts: tuple[str, str], levels: tuple[str, str]
) -> list[EventRow]:
    """Return a row for every change of a flag of the vehicle, not for its first value if that is off."""
    rows: list[EventRow] = []
    before = False
    for t, value in zip(data.vehicle["t"].tolist(), data.vehicle[column].tolist(), strict=True):
        on = value > 0.0
        if on != before:
            rows.append(EventRow(t, "vehicle", texts[0 if on else 1], levels[0 if on else 1]))
        before = on
    return rows


def _plan_level(status: str) -> str:
    return "warning" if status == "no path" else "info"
