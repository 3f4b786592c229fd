"""A campaign in plots: success by world and by size of swarm, the other metrics, how trials failed."""

import math
from collections.abc import Sequence
from typing import Any

from companion.logs import report_style as style
from companion.logs.figure_page import Figure, FigureBox
from sitl.campaign import paper_numbers as paper
from sitl.campaign.cases import FAILURES, MEANS, SUCCESS, CaseSummary
from sitl.campaign.plots_published import proposed_marks, published_line, published_marks
from sitl.campaign.tables import failure_title
from sitl.campaign.tables_labels import (
    METRIC_TITLES,
    Labels,
    distinct,
    method_title,
    split_neighbours,
    split_perception,
    world_title,
)

COLOURS = (
    style.ESTIMATE,
    style.COMMAND,
    style.GREEN,
    style.AXES[2],
    style.RED,
    "#0891b2",
    "#a16207",
    "#be185d",
    "#4d7c0f",
    "#475569",
)
_FAILURES = {
    SUCCESS: "#bbf7d0",
    "uav_uav": style.RED,
    "leader_follower": "#f472b6",
    "obstacle": style.COMMAND,
    "altitude": style.AXES[2],
    "leader_lost": style.ESTIMATE,
    "scattered": "#0891b2",
    "timeout": "#a16207",
    "failsafe": "#475569",
}
_Group = tuple[str, int, str]


def figure_boxes(cases: Sequence[CaseSummary], labels: Labels) -> list[FigureBox]:
    """Return the plots for which a campaign has data, in the order of the page."""
    if not cases:
        return []
    boxes = [
        FigureBox(
            "success",
            "Success rate by world",
            "Bars with 95 % Wilson intervals. Grey diamonds: the paper's number for the same method; hollow: "
            "that of its learned policy.",
            success_by_world(cases, labels),
            wide=True,
        )
    ]
    if any(len(sizes) > 1 for sizes in _sizes(cases).values()):
        caption = "With 95 % Wilson intervals. Dashed: the paper's learned policy."
        boxes.append(
            FigureBox("sizes", "Success rate by size of the swarm", caption, success_by_size(cases, labels))
        )
    if len({split_neighbours(case.method)[1] for case in cases}) > 1:
        caption = "With 95 % Wilson intervals. Crosses: what the paper's text says."
        boxes.append(
            FigureBox(
                "neighbours",
                "Success rate by observable neighbours",
                caption,
                success_by_neighbours(cases, labels),
            )
        )
    if any(split_perception(case.method)[1] for case in cases):
        caption = "With 95 % Wilson intervals."
        boxes.append(
            FigureBox(
                "perceptions",
                "Success rate by perception",
                caption,
                success_by_perception(cases, labels),
            )
        )
    boxes += [
        FigureBox(
            f"metric-{name.lower()}",
            f"{METRIC_TITLES[name]} by world",
            "Mean over trials with one standard deviation; colours as above.",
            metric_by_world(cases, name),
        )
        for name in MEANS
        if any(math.isfinite(case.metric(name).mean) for case in cases)
    ]
    boxes.append(
        FigureBox("ends", "How trials ended", "Share of the trials of every case.", ends(cases), wide=True)
    )
    return boxes


def success_by_world(cases: Sequence[CaseSummary], labels: Labels) -> Figure:
    """Return bars of success rates, grouped by world."""
    worlds = distinct([case.world for case in cases])
    groups = _groups(cases)
    traces = []
    for index, (method, followers, fidelity) in enumerate(groups):
        chosen = {case.world: case for case in cases if _group(case) == (method, followers, fidelity)}
        here = [world for world in worlds if world in chosen]
        name = _name((method, followers, fidelity), groups)
        traces.append(
            {
                "type": "bar",
                "name": name,
                "x": [world_title(world) for world in here],
                "y": [round(chosen[world].SR, 3) for world in here],
                "error_y": _interval([chosen[world] for world in here]),
                "marker": {"color": COLOURS[index % len(COLOURS)]},
                "offsetgroup": str(index),
                "hovertemplate": "%{x}: %{y:.1f} %<extra>" + _safe(name) + "</extra>",
            }
        )
        traces += published_marks(method, followers, here, labels, str(index))
    if any(case.followers == 4 for case in cases):
        traces += proposed_marks([method for method, _, _ in groups], worlds, labels)
    layout = style.layout(x_title="", y_title="success rate, %", height=420, barmode="group")
    layout["scattermode"] = "group"
    layout["legend"] = {"x": 1.01, "y": 1, "font": {"size": 11}}
    layout["xaxis"] |= _in_order(worlds)
    layout["yaxis"]["range"] = [0, 105]
    return {"data": traces, "layout": layout}


def success_by_size(cases: Sequence[CaseSummary], labels: Labels) -> Figure:
    """Return success rates over the number of followers, a line for every world and method with several."""
    lines = [line for line, sizes in _sizes(cases).items() if len(sizes) > 1]
    traces = []
    for index, (world, method, fidelity) in enumerate(lines):
        chosen = sorted(
            (case for case in cases if (case.world, case.method, case.fidelity) == (world, method, fidelity)),
            key=lambda case: case.followers,
        )
        name = f"{method_title(method)}, {world_title(world)}" + ("" if fidelity == "abstract" else ", full")
        traces.append(_line(name, [case.followers for case in chosen], chosen, COLOURS[index % len(COLOURS)]))
    for index, world in enumerate(distinct([world for world, _, _ in lines])):
        site = labels.site(world)
        known = [
            (size, value.mean)
            for size in paper.FOLLOWERS
            if (value := paper.SCALABILITY.get(("SR", site or "", size))) is not None
        ]
        if known:
            dash = ("dash", "dot", "dashdot")[index % 3]
            traces.append(published_line(f"paper, {world_title(world)}", known, dash))
    layout = style.layout(x_title="followers", y_title="success rate, %", height=400)
    layout["yaxis"]["range"] = [0, 105]
    return {"data": traces, "layout": layout}


def success_by_neighbours(cases: Sequence[CaseSummary], labels: Labels) -> Figure:
    """Return success rates over the number of observable neighbours."""
    parts = [(case, *split_neighbours(case.method)) for case in cases]
    lines = dict.fromkeys(
        (case.world, name, case.followers) for case, name, count in parts if count is not None
    )
    traces = []
    for index, (world, name, followers) in enumerate(lines):
        chosen = sorted(
            (
                (count, case)
                for case, plain, count in parts
                if count is not None and (case.world, plain, case.followers) == (world, name, followers)
            ),
            key=lambda pair: pair[0],
        )
        colour = COLOURS[index % len(COLOURS)]
        title = f"{method_title(name)}, {world_title(world)}"
        traces.append(_line(title, [count for count, _ in chosen], [case for _, case in chosen], colour))
        known = [
            (count, value.mean)
            for (site, count), value in paper.NEIGHBOURS.items()
            if site == labels.site(world)
        ]
        if known and followers == 10:
            mark = published_line(f"paper, {world_title(world)}", known, "dot")
            traces.append(mark | {"mode": "markers", "marker": {"symbol": "x", "size": 9, "color": colour}})
    layout = style.layout(x_title="observable neighbours", y_title="success rate, %", height=400)
    layout["yaxis"]["range"] = [0, 105]
    return {"data": traces, "layout": layout}


def success_by_perception(cases: Sequence[CaseSummary], labels: Labels) -> Figure:
    """Return success rates over the ways of perceiving, a line for every world, method and size."""
    parts = {case.key: split_perception(case.method) for case in cases}
    groups = dict.fromkeys(
        (case.world, parts[case.key][0], case.followers) for case in cases if parts[case.key][1] is not None
    )
    sizes = {followers for _, _, followers in groups}
    traces = []
    for index, (world, label, followers) in enumerate(groups):
        at = {
            parts[case.key][1]: case
            for case in cases
            if (case.world, parts[case.key][0], case.followers) == (world, label, followers)
        }
        names = [name for name in labels.perceptions if name in at]
        title = f"{method_title(label)}, {world_title(world)}"
        if len(sizes) > 1:
            title += f", {followers} followers"
        traces.append(_line(title, names, [at[name] for name in names], COLOURS[index % len(COLOURS)]))
    layout = style.layout(x_title="perception", y_title="success rate, %", height=400)
    layout["xaxis"] |= {"type": "category", "categoryorder": "array", "categoryarray": [*labels.perceptions]}
    layout["yaxis"]["range"] = [0, 105]
    return {"data": traces, "layout": layout}


def metric_by_world(cases: Sequence[CaseSummary], metric: str) -> Figure:
    """Return bars of one averaged metric, grouped by world."""
    worlds = distinct([case.world for case in cases])
    groups = _groups(cases)
    traces = []
    for index, group in enumerate(groups):
        known = [
            case
            for world in worlds
            for case in cases
            if case.world == world and _group(case) == group and math.isfinite(case.metric(metric).mean)
        ]
        values = [case.metric(metric) for case in known]
        spread = [round(value.sd, 4) if math.isfinite(value.sd) else 0.0 for value in values]
        traces.append(
            {
                "type": "bar",
                "name": _name(group, groups),
                "x": [world_title(case.world) for case in known],
                "y": [round(value.mean, 4) for value in values],
                "error_y": {"type": "data", "array": spread, "color": "#475569", "thickness": 1, "width": 3},
                "marker": {"color": COLOURS[index % len(COLOURS)]},
            }
        )
    layout = style.layout(
        x_title="", y_title=METRIC_TITLES[metric], height=280, barmode="group", showlegend=False
    )
    layout["xaxis"] |= _in_order(worlds)
    return {"data": traces, "layout": layout}


def ends(cases: Sequence[CaseSummary]) -> Figure:
    """Return a stack of the ways in which the trials of every case ended."""
    groups = _groups(cases)
    names = [f"{world_title(case.world)} · {_name(_group(case), groups)}" for case in cases]
    traces = []
    for end in (SUCCESS, *FAILURES):
        counts = [case.successes if end == SUCCESS else case.failures[end] for case in cases]
        if not any(counts):
            continue
        title = "success" if end == SUCCESS else failure_title(end)
        traces.append(
            {
                "type": "bar",
                "orientation": "h",
                "name": title,
                "y": names,
                "x": [
                    round(100.0 * count / case.trials, 3) for count, case in zip(counts, cases, strict=True)
                ],
                "marker": {"color": _FAILURES[end]},
                "hovertemplate": "%{y}: %{x:.1f} %<extra>" + title + "</extra>",
            }
        )
    layout = style.layout(
        x_title="trials, %", y_title="", height=110 + 24 * max(4, len(cases)), barmode="stack"
    )
    layout["xaxis"]["range"] = [0, 100]
    layout["yaxis"]["autorange"] = "reversed"
    return {"data": traces, "layout": layout}


def _sizes(cases: Sequence[CaseSummary]) -> dict[tuple[str, str, str], set[int]]:
    """Return with how many followers every method flew in every world."""
    sizes: dict[tuple[str, str, str], set[int]] = {}
    for case in cases:
        sizes.setdefault((case.world, case.method, case.fidelity), set()).add(case.followers)
    return sizes


def _in_order(worlds: Sequence[str]) -> dict[str, Any]:
    titles = [world_title(world) for world in worlds]
    # Long titles in two lines side by side, rather than turned or over each other.
    broken = [title.replace(", ", ",<br>", 1) if ", " in title else _halved(title) for title in titles]
    order = {"categoryorder": "array", "categoryarray": titles, "tickangle": 0 if len(titles) <= 6 else 40}
    return order | {"tickmode": "array", "tickvals": titles, "ticktext": broken}


def _halved(title: str) -> str:
    first, space, rest = title.partition(" ")
    return f"{first}<br>{rest}" if space else title


def _group(case: CaseSummary) -> _Group:
    return (case.method, case.followers, case.fidelity)


def _groups(cases: Sequence[CaseSummary]) -> list[_Group]:
    return list(dict.fromkeys(_group(case) for case in cases))


def _name(group: _Group, groups: Sequence[_Group]) -> str:
    """Return a method's title with as much more as it takes to tell groups apart."""
    method, followers, fidelity = group
    parts = [method_title(method)]
    if len({size for _, size, _ in groups}) > 1:
        parts.append(f"{followers} followers")
    if len({kind for _, _, kind in groups}) > 1:
        parts.append(fidelity)
    return ", ".join(parts)


def _interval(cases: Sequence[CaseSummary]) -> dict[str, Any]:
    return {
        "type": "data",
        "symmetric": False,
        "array": [round(case.SR_ci95[1] - case.SR, 3) for case in cases],
        "arrayminus": [round(case.SR - case.SR_ci95[0], 3) for case in cases],
        "color": "#475569",
        "thickness": 1.2,
        "width": 3,
    }


def _line(name: str, x: Sequence[int] | Sequence[str], cases: Sequence[CaseSummary], colour: str) -> Figure:
    return {
        "type": "scatter",
        "mode": "lines+markers",
        "name": name,
        "x": list(x),
        "y": [round(case.SR, 3) for case in cases],
        "error_y": _interval(cases) | {"color": colour},
        "line": {"color": colour, "width": 2},
    }


def _safe(text: str) -> str:
    """Return text that the plotting library does not take for markup."""
    return text.replace("<", "‹").replace(">", "›")
