"""The paper's table of reward configurations with ours beside it: one trained policy for each."""

from collections.abc import Sequence

from sitl.campaign import paper_numbers as paper
from sitl.campaign.cases import CaseSummary
from sitl.campaign.tables import NONE, cell, notes
from sitl.campaign.tables_labels import METRIC_TITLES, Labels, source, world_title
from sitl.campaign.tables_rendering import Row, Table

FOLLOWERS = 4
_TITLES = {
    "without_flocking": "Without flocking",
    "without_obstacle": "Without obstacles",
    "without_stable": "Without stability",
    "without_perception": "Without perception",
    "uniform": "Uniform",
    paper.PROPOSED: "All",
}


def rewards_table(cases: Sequence[CaseSummary], labels: Labels, cap_m: float) -> Table | None:
    """Return the ablation of rewards, None unless policies called like its configurations have flown.

    Args:
        cases: of a campaign whose methods are called like `paper_numbers.CONFIGURATIONS`.
        labels: its names.
        cap_m: see `tables.notes`.
    """
    chosen = [
        case
        for case in cases
        if case.method in paper.CONFIGURATIONS and case.followers == FOLLOWERS and labels.site(case.world)
    ]
    names = [name for name in paper.CONFIGURATIONS if any(case.method == name for case in chosen)]
    if len(names) < 2:
        return None
    at = {(labels.site(case.world), case.method): case for case in chosen}
    worlds = [world for world in paper.GAPS if any(key[0] == world for key in at)]
    rows: list[Row] = []
    for metric in paper.METRICS:
        for world in worlds:
            theirs = [paper.REWARD_ABLATION.get((metric, world, name)) for name in names]
            if any(theirs):
                head = (METRIC_TITLES[metric], world_title(world), "paper")
                rows.append(Row((*head, *(NONE if each is None else each.text for each in theirs)), True))
            ours = [at.get((world, name)) for name in names]
            some = next(case for case in ours if case is not None)
            head = (METRIC_TITLES[metric], world_title(world), source(some))
            rows.append(Row((*head, *(cell(case, metric) for case in ours))))
    return Table(
        name="rewards",
        title="Configurations of the reward",
        names=("Metric", "World", "Source"),
        values=tuple(_TITLES[name] for name in names),
        rows=tuple(rows),
        notes=notes(cap_m, [case.trials for case in chosen]),
    )
