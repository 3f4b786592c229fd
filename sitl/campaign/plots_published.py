"""The paper's numbers in the plots of a campaign."""

from collections.abc import Sequence

from companion.logs.figure_page import Figure
from sitl.campaign import paper_numbers as paper
from sitl.campaign.tables_labels import Labels, method_title, world_title

_PAPER = "#94a3b8"


def published_marks(
    method: str, followers: int, worlds: Sequence[str], labels: Labels, group: str
) -> list[Figure]:
    """Return the paper's numbers for the same method, over the bars of ours."""
    known = labels.method(method)
    if followers != 4 or known not in paper.METHODS:
        return []
    found = [
        (world_title(world), value.mean)
        for world in worlds
        if (value := paper.COMPARISON.get(("SR", known, labels.site(world) or ""))) is not None
    ]
    marker = {"symbol": "diamond", "size": 10, "color": _PAPER, "line": {"color": "#334155", "width": 1}}
    return [
        {
            "type": "scatter",
            "mode": "markers",
            "name": "paper",
            "x": [world for world, _ in found],
            "y": [value for _, value in found],
            "marker": marker,
            "offsetgroup": group,
            "showlegend": False,
            "hovertemplate": "%{x}: %{y:.1f} %<extra>paper</extra>",
        }
    ]


def proposed_marks(methods: Sequence[str], worlds: Sequence[str], labels: Labels) -> list[Figure]:
    """Return the numbers of the paper's learned policy, unless one of the methods stands for it."""
    if paper.PROPOSED in map(labels.method, methods):
        return []
    found = [
        (world_title(world), value.mean)
        for world in worlds
        if (value := paper.COMPARISON.get(("SR", paper.PROPOSED, labels.site(world) or ""))) is not None
    ]
    if not found:
        return []
    return [
        {
            "type": "scatter",
            "mode": "markers",
            "name": f"paper, {method_title(paper.PROPOSED)}",
            "x": [world for world, _ in found],
            "y": [value for _, value in found],
            "marker": {
                "symbol": "diamond",
                "size": 9,
                "color": "white",
                "line": {"color": "#334155", "width": 1.5},
            },
        }
    ]


def published_line(name: str, points: Sequence[tuple[int, float]], dash: str) -> Figure:
    """Return a line through published numbers."""
    return {
        "type": "scatter",
        "mode": "lines+markers",
        "name": name,
        "x": [x for x, _ in points],
        "y": [y for _, y in points],
        "line": {"color": _PAPER, "width": 1.6, "dash": dash},
        "marker": {"symbol": "diamond", "size": 7},
    }
