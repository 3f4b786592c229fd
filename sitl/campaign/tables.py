"""The paper's tables with our numbers beside its own, and the tables that it does not have."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from sitl.campaign import paper_numbers as paper
from sitl.campaign.cases import FAILURES, CaseSummary, PairedComparison
from sitl.campaign.paper_numbers import METRICS, Published
from sitl.campaign.statistics import Mean
from sitl.campaign.tables_labels import (
    METRIC_TITLES,
    PERCEIVING,
    Labels,
    distinct,
    method_title,
    source,
    split_neighbours,
    split_perception,
    world_title,
)
from sitl.campaign.tables_rendering import Row, Table
from sitl.swarm.record import Fidelity

NONE = "–"
PAPER = "paper"
_DIGITS = {"MP": 1, "FR": 2, "MS": 2, "AL": 2, "MDO": 2}
_FAILURE_TITLES = {
    "uav_uav": "two followers",
    "leader_follower": "leader and follower",
    "obstacle": "obstacle",
    "altitude": "altitude",
    "leader_lost": "leader lost",
    "scattered": "scattered",
    "timeout": "time-out",
    "failsafe": "failsafe",
}


def notes(cap_m: float, trials: Sequence[int]) -> tuple[str, ...]:
    """Return what holds for every table of a campaign.

    Args:
        cap_m: farther obstacles do not count for MDO.
        trials: numbers of trials of the cases.
    """
    each = f"{min(trials)} to {max(trials)}" if len(set(trials)) > 1 else f"{trials[0] if trials else 0}"
    return (
        f"Ours: {each} trials a case; SR with its 95 % Wilson interval, other metrics as mean ± standard "
        f"deviation over trials, failed ones included, the leader counted as a UAV. The paper: "
        f"{paper.TRIALS} trials a case.",
        f"MDO is capped at {cap_m:g} m: it averages over the moments with a surface nearer than that to any "
        "UAV, measured from the UAV's centre. The paper does not state its cap.",
    )


def success_cell(case: CaseSummary) -> str:
    """Return a success rate with its interval."""
    low, high = case.SR_ci95
    return f"{case.SR:.1f} [{low:.1f}, {high:.1f}]"


def mean_cell(value: Mean, digits: int) -> str:
    """Return a mean with its standard deviation, or a dash."""
    if not math.isfinite(value.mean):
        return NONE
    if not math.isfinite(value.sd):
        return f"{value.mean:.{digits}f}"
    return f"{value.mean:.{digits}f} ± {value.sd:.{digits}f}"


def cell(case: CaseSummary | None, metric: str) -> str:
    """Return what a table shows of one case."""
    if case is None:
        return NONE
    return success_cell(case) if metric == "SR" else mean_cell(case.metric(metric), _DIGITS[metric])


def _published(value: Published | None) -> str:
    return NONE if value is None else value.text


def comparison_table(cases: Sequence[CaseSummary], labels: Labels, cap_m: float) -> Table | None:
    """Return methods by worlds for swarms of four followers, None if the paper has none of these worlds."""
    chosen = [case for case in cases if case.followers == 4]
    if not chosen:
        return None
    worlds = distinct([case.world for case in chosen])
    at = {(case.world, case.method, case.fidelity): case for case in chosen}
    ours = list(dict.fromkeys((case.method, case.fidelity) for case in chosen))
    known = {name: labels.method(name) for name, _ in ours}
    sites = {world: labels.site(world) for world in worlds}
    if not set(sites.values()) & set(paper.WORLDS):
        return None
    theirs = [method for method in paper.METHODS if method in known.values()]
    rows: list[Row] = []
    for metric in METRICS:

        def published(method: str, metric: str = metric) -> Row:
            cells = (paper.COMPARISON.get((metric, method, sites[world] or "")) for world in worlds)
            return Row((METRIC_TITLES[metric], method_title(method), PAPER, *map(_published, cells)), True)

        def flown(name: str, fidelity: Fidelity, metric: str = metric) -> Row:
            found = [at.get((world, name, fidelity)) for world in worlds]
            some = next(case for case in found if case is not None)
            return Row(
                (
                    METRIC_TITLES[metric],
                    method_title(name),
                    source(some),
                    *(cell(case, metric) for case in found),
                )
            )

        for method in theirs:
            rows.append(published(method))
            rows.extend(flown(name, fidelity) for name, fidelity in ours if known[name] == method)
        if paper.PROPOSED not in theirs:
            rows.append(published(paper.PROPOSED))
        rows.extend(flown(name, fidelity) for name, fidelity in ours if known[name] not in theirs)
    return Table(
        name="comparison",
        title="Performance comparison, one leader and four followers",
        names=("Metric", "Method", "Source"),
        values=tuple(map(world_title, worlds)),
        rows=tuple(rows),
        notes=notes(cap_m, [case.trials for case in chosen]),
    )


def scalability_table(cases: Sequence[CaseSummary], labels: Labels, cap_m: float) -> Table | None:
    """Return worlds by sizes of the swarm, of the methods that flew with several; None if none did."""
    known: dict[tuple[str, str, Fidelity], set[int]] = {}
    for case in cases:
        known.setdefault((case.world, case.method, case.fidelity), set()).add(case.followers)
    chosen = [case for case in cases if len(known[case.world, case.method, case.fidelity]) > 1]
    if not chosen:
        return None
    sizes = sorted({case.followers for case in chosen})
    worlds = distinct([case.world for case in chosen])
    at = {(case.world, case.method, case.fidelity, case.followers): case for case in chosen}
    ours = list(dict.fromkeys((case.method, case.fidelity) for case in chosen))
    rows: list[Row] = []
    for metric in METRICS:
        for world in worlds:
            site = labels.site(world) or ""
            theirs = [paper.SCALABILITY.get((metric, site, size)) for size in sizes]
            if any(theirs):
                head = (METRIC_TITLES[metric], world_title(world), method_title(paper.PROPOSED), PAPER)
                rows.append(Row((*head, *map(_published, theirs)), True))
            for name, fidelity in ours:
                found = [at.get((world, name, fidelity, size)) for size in sizes]
                some = next((case for case in found if case is not None), None)
                if some is not None:
                    head = (METRIC_TITLES[metric], world_title(world), method_title(name), source(some))
                    rows.append(Row((*head, *(cell(case, metric) for case in found))))
    return Table(
        name="scalability",
        title="Scalability with the number of followers",
        names=("Metric", "World", "Method", "Source"),
        values=tuple(map(str, sizes)),
        rows=tuple(rows),
        notes=notes(cap_m, [case.trials for case in chosen]),
    )


def neighbours_table(cases: Sequence[CaseSummary], labels: Labels, cap_m: float) -> Table | None:
    """Return success by number of observable neighbours, None if that number does not vary."""
    parts = {case.key: split_neighbours(case.method) for case in cases}
    chosen = [case for case in cases if parts[case.key][1] is not None]
    counts = sorted({count for case in chosen if (count := parts[case.key][1]) is not None})
    if len(counts) < 2:
        return None
    groups = dict.fromkeys((case.world, case.followers, parts[case.key][0], case.fidelity) for case in chosen)
    at = {(case.world, case.followers, *parts[case.key], case.fidelity): case for case in chosen}
    rows: list[Row] = []
    shown: set[tuple[str, int]] = set()
    for world, followers, name, fidelity in groups:
        head = (f"{world_title(world)}, {followers} followers",)
        theirs = [paper.NEIGHBOURS.get((labels.site(world) or "", count)) for count in counts]
        if any(theirs) and followers == 10 and (world, followers) not in shown:
            shown.add((world, followers))
            rows.append(Row((*head, method_title(paper.PROPOSED), PAPER, *map(_published, theirs)), True))
        found = [at.get((world, followers, name, count, fidelity)) for count in counts]
        some = next(case for case in found if case is not None)
        rows.append(Row((*head, method_title(name), source(some), *(cell(case, "SR") for case in found))))
    return Table(
        name="neighbours",
        title="Success rate (%) by number of observable neighbours",
        names=("World", "Method", "Source"),
        values=tuple(map(str, counts)),
        rows=tuple(rows),
        notes=(
            "The paper shows a figure; its numbers here are those that its text gives.",
            *notes(cap_m, [case.trials for case in chosen]),
        ),
    )


def real_scenes_table(cases: Sequence[CaseSummary], labels: Labels, cap_m: float) -> Table | None:
    """Return the rebuilt scenes of the real flights, None if none was flown."""
    sites = [site for site in paper.SITES if any(labels.site(case.world) == site for case in cases)]
    chosen = [case for case in cases if labels.site(case.world) in sites]
    if not chosen:
        return None
    at = {(labels.site(c.world), c.method, c.fidelity, c.followers): c for c in chosen}
    ours = list(dict.fromkeys((case.method, case.fidelity, case.followers) for case in chosen))
    rows: list[Row] = []
    for metric in METRICS:
        theirs = [paper.REAL_FLIGHTS.get((metric, site)) for site in sites]
        if any(theirs):
            head = (METRIC_TITLES[metric], method_title(paper.PROPOSED), "paper, real flight", "4")
            rows.append(Row((*head, *map(_published, theirs)), True))
        for name, fidelity, followers in ours:
            found = [at.get((site, name, fidelity, followers)) for site in sites]
            some = next(case for case in found if case is not None)
            head = (METRIC_TITLES[metric], method_title(name), source(some), str(followers))
            rows.append(Row((*head, *(cell(case, metric) for case in found))))
    return Table(
        name="real_scenes",
        title="The scenes of the real flights, rebuilt",
        names=("Metric", "Method", "Source", "Followers"),
        values=tuple(map(world_title, sites)),
        rows=tuple(rows),
        notes=(
            "The paper's are of one real flight a scene, with the standard deviation over its time; nothing "
            "says that its MDO is capped. Ours are of rebuilt scenes, with the standard deviation over "
            "trials.",
            *notes(cap_m, [case.trials for case in chosen]),
        ),
    )


def perceptions_table(cases: Sequence[CaseSummary], labels: Labels, cap_m: float) -> Table | None:
    """Return methods by how they perceive, None if that does not vary."""
    parts = {case.key: split_perception(case.method) for case in cases}
    flown = {parts[case.key][1] for case in cases}
    names = [name for name in labels.perceptions if name in flown]
    if len(names) < 2:
        return None
    chosen = [case for case in cases if parts[case.key][1] in names]
    at = {(case.world, case.followers, *parts[case.key], case.fidelity): case for case in chosen}
    groups = dict.fromkeys((case.world, case.followers, parts[case.key][0], case.fidelity) for case in chosen)
    rows: list[Row] = []
    for metric in METRICS:
        for world, followers, label, fidelity in groups:
            found = [at.get((world, followers, label, name, fidelity)) for name in names]
            some = next(case for case in found if case is not None)
            head = (METRIC_TITLES[metric], world_title(world), method_title(label), str(followers))
            rows.append(Row((*head, source(some), *(cell(case, metric) for case in found))))
    return Table(
        name="perceptions",
        title="By how followers perceive",
        names=("Metric", "World", "Method", "Followers", "Source"),
        values=tuple(names),
        rows=tuple(rows),
        notes=notes(cap_m, [case.trials for case in chosen]),
    )


def with_perceptions(table: Table) -> Table:
    """Return a table in which methods and their perceptions are columns of their own, where any has one."""
    if "Method" not in table.names:
        return table
    place = table.names.index("Method")
    parts = [row.cells[place].partition(PERCEIVING) for row in table.rows]
    if not any(perception for _, _, perception in parts):
        return table
    rows = tuple(
        Row((*row.cells[:place], method, perception or NONE, *row.cells[place + 1 :]), row.published)
        for row, (method, _, perception) in zip(table.rows, parts, strict=True)
    )
    names = (*table.names[: place + 1], "Perception", *table.names[place + 1 :])
    return replace(table, names=names, rows=rows)


def cases_table(cases: Sequence[CaseSummary], cap_m: float) -> Table:
    """Return every case as a row."""
    rows = [
        Row(
            (
                world_title(case.world),
                method_title(case.method),
                str(case.followers),
                case.fidelity,
                str(case.trials),
                *(cell(case, metric) for metric in METRICS),
            )
        )
        for case in cases
    ]
    return Table(
        name="cases",
        title="All cases",
        names=("World", "Method"),
        values=("Followers", "Fidelity", "Trials", *(METRIC_TITLES[metric] for metric in METRICS)),
        rows=tuple(rows),
        notes=notes(cap_m, [case.trials for case in cases]),
    )


def failures_table(cases: Sequence[CaseSummary]) -> Table:
    """Return how trials ended that did not succeed."""
    shown = [end for end in FAILURES if any(case.failures[end] for case in cases)]
    rows = [
        Row(
            (
                world_title(case.world),
                method_title(case.method),
                str(case.followers),
                case.fidelity,
                str(case.trials),
                str(case.successes),
                *(str(case.failures[end]) for end in shown),
            )
        )
        for case in cases
    ]
    titles = (failure_title(end) for end in shown)
    return Table(
        name="failures",
        title="How trials ended",
        names=("World", "Method"),
        values=("Followers", "Fidelity", "Trials", "Success", *titles),
        rows=tuple(rows),
    )


def paired_table(pairs: Sequence[PairedComparison]) -> Table:
    """Return methods against each other on the same scenes."""
    rows = [
        Row(
            (
                world_title(pair.world),
                method_title(pair.first),
                method_title(pair.second),
                str(pair.followers),
                pair.fidelity,
                str(pair.pairs),
                str(pair.only_first),
                str(pair.only_second),
                f"{pair.difference_percent:+.1f}",
                _p_value(pair.p),
            )
        )
        for pair in pairs
    ]
    return Table(
        name="paired",
        title="Methods against each other on the same scenes",
        names=("World", "First", "Second"),
        values=(
            "Followers",
            "Fidelity",
            "Scenes",
            "First alone",
            "Second alone",
            "SR difference (%)",
            "p",
        ),
        rows=tuple(rows),
        notes=(
            "First alone, second alone: scenes in which only that method succeeded. p: two-sided, McNemar's "
            "exact test on them, not corrected for the number of rows.",
        ),
    )


def failure_title(end: str) -> str:
    """Return how an end is called in print."""
    return _FAILURE_TITLES.get(end, end)


def _p_value(p: float) -> str:
    return f"{p:.1e}" if p < 1e-3 else f"{p:.3f}"


Builder = Callable[[Sequence[CaseSummary], Labels, float], Table | None]
BUILDERS: dict[str, Builder] = {
    "comparison": comparison_table,
    "scalability": scalability_table,
    "neighbours": neighbours_table,
    "real_scenes": real_scenes_table,
    "perceptions": perceptions_table,
}
"""The paper's tables and one of its kind, by the names that campaigns use."""
