"""What a campaign came to, as files: tables for reading, for papers and for the web; a page with plots."""

import html
from collections.abc import Callable, Sequence
from pathlib import Path

from companion.errors import LogError
from companion.logs import figure_page
from sitl.campaign.cases import SUCCESS, CaseSummary, by_case, compare_all, summarise
from sitl.campaign.definition import CampaignDefinition
from sitl.campaign.plots import figure_boxes
from sitl.campaign.tables import (
    BUILDERS,
    cases_table,
    failure_title,
    failures_table,
    paired_table,
    with_perceptions,
)
from sitl.campaign.tables_labels import Labels, split_perception
from sitl.campaign.tables_rendering import Table, html_table, latex, markdown
from sitl.campaign.tables_rewards import rewards_table
from sitl.swarm.record import TrialRecord

MARKDOWN = "tables.md"
LATEX = "tables.tex"
HTML = "tables.html"
INDEX = "index.html"

LogOf = Callable[[TrialRecord], str | None]
"""Where the log of a trial lies, relative to the report's folder, or None if there is none."""

_AGAIN = (
    '<p class="note">Any trial can be flown again, with a log: <code>sitl trial DIR --world NAME --method '
    "NAME --followers N --trial K --out FILE.mcap</code></p>"
)
_BUILDERS = {**BUILDERS, "rewards": rewards_table}
_FAILED_SHOWN = 40
_SUCCEEDED_SHOWN = 5


def tables_of(records: Sequence[TrialRecord], definition: CampaignDefinition) -> list[Table]:
    """Return every table for which there are trials: the campaign's own first, then the general ones."""
    cases = summarise(records)
    labels, cap_m = Labels.of(definition), definition.obstacle_distance_cap_m
    wanted = [definition.table] if definition.table in _BUILDERS else []
    order = [*wanted, *(name for name in _BUILDERS if name not in wanted)]
    built = [_BUILDERS[name or ""](cases, labels, cap_m) for name in order]
    tables = [table for table in built if table is not None]
    tables += [cases_table(cases, cap_m), failures_table(cases)]
    pairs = compare_all(records)
    if pairs:
        tables.append(paired_table(pairs))
    return [with_perceptions(table) for table in tables]


def write_report(
    folder: Path,
    records: Sequence[TrialRecord],
    definition: CampaignDefinition,
    log_of: LogOf | None = None,
) -> list[Path]:
    """Write the tables as Markdown, LaTeX and HTML and a page with plots; equal trials give equal files.

    Args:
        folder: to write to; it must exist.
        records: all trials, in any order.
        definition: the campaign's file.
        log_of: says where the log of a trial lies.

    Returns:
        The files.

    Raises:
        LogError: if one cannot be written, there is no trial, or plotly is not installed.
    """
    if not records:
        raise LogError(f"{folder}: no trial has been flown, so there is nothing to report")
    ordered = _in_order(records, definition)
    cases, tables = summarise(ordered), tables_of(ordered, definition)
    sections = "".join(html_table(table) for table in tables)
    texts = {
        MARKDOWN: f"# {definition.title}\n\n" + "\n".join(markdown(table) for table in tables),
        LATEX: "\n".join(latex(table) for table in tables),
        HTML: figure_page.page(definition.title, _lead(cases), before=sections),
        INDEX: figure_page.page(
            definition.title,
            _lead(cases),
            figure_boxes(cases, Labels.of(definition)),
            before=_links() + html_table(tables[0]),
            after="".join(map(html_table, tables[1:])) + _trials(ordered, log_of),
        ),
    }
    for name, text in texts.items():
        figure_page.write_whole(folder / name, text)
    return [folder / name for name in texts]


def _in_order(records: Sequence[TrialRecord], definition: CampaignDefinition) -> list[TrialRecord]:
    """Sort trials as the campaign's file names worlds and methods; what it does not name comes last."""
    worlds = [entry.name for entry in definition.world_entries]
    methods = [entry.name for entry in definition.method_entries]
    known = Labels.of(definition)

    def place(record: TrialRecord) -> tuple[int, str, int, int, str, int, str, int]:
        label, perception = split_perception(record.method)
        plain = next((name for name in methods if label == name), None)
        plain = plain or next((name for name in methods if label.startswith(f"{name}_k")), None)
        return (
            worlds.index(record.world) if record.world in worlds else len(worlds),
            record.world,
            record.followers,
            methods.index(plain) if plain else len(methods),
            f"{known.method(record.method)} {len(label):3d} {label}",
            known.perceptions.index(perception) if perception in known.perceptions else -1,
            record.fidelity,
            record.trial,
        )

    return sorted(records, key=place)


def _lead(cases: Sequence[CaseSummary]) -> str:
    total = sum(case.trials for case in cases)
    kinds = " and ".join(sorted({case.fidelity for case in cases}))
    return f"{total:,} trials in {len(cases)} cases, fidelity {kinds}."


def _links() -> str:
    names = " · ".join(f'<a href="{name}">{name}</a>' for name in (MARKDOWN, LATEX, HTML))
    return f'<p class="lead">Tables alone: {names}</p>'


def _trials(records: Sequence[TrialRecord], log_of: LogOf | None) -> str:
    """Return lists of trials, failed ones first, with links to their logs."""
    parts = []
    for (world, method, followers, fidelity), trials in by_case(records).items():
        failed = [trial for trial in trials if trial.end != SUCCESS]
        shown = failed[:_FAILED_SHOWN] + [t for t in trials if t.end == SUCCESS][:_SUCCEEDED_SHOWN]
        # As the command line calls them, for whoever wants to fly a trial again.
        title = f"{world}, {method}, {followers} followers, {fidelity}"
        rows = "".join(_trial_row(trial, log_of) for trial in shown)
        heads = "".join(
            f"<th>{word}</th>" for word in ("trial", "end", "by", "at, s", "MP, %", "seed", "scene", "log")
        )
        parts.append(
            f"<details><summary>{html.escape(title)}: {len(failed)} of {len(trials)} failed</summary>"
            f"<table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"
            f'<p class="note">{len(shown)} of {len(trials)} trials shown.</p></details>'
        )
    return f'<section class="card"><h2>Trials</h2>{_AGAIN}{"".join(parts)}</section>'


def _trial_row(trial: TrialRecord, log_of: LogOf | None) -> str:
    link = log_of(trial) if log_of is not None else None
    log = f'<a href="{html.escape(link, quote=True)}">log</a>' if link else "–"
    cells = (
        str(trial.trial),
        "success" if trial.end == SUCCESS else failure_title(trial.end),
        ", ".join("leader" if number == 0 else str(number) for number in trial.ended_by) or "–",
        f"{trial.t_end_s:.1f}",
        f"{trial.mission_progress_percent:.1f}",
        str(trial.seed),
        trial.scene_hash,
    )
    return "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + f"<td>{log}</td></tr>"
