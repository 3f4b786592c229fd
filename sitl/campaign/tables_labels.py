"""What the names in results stand for, and how they are called in print."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from sitl.campaign.cases import CaseSummary
from sitl.campaign.conditions import AT
from sitl.campaign.definition import LEARNED, CampaignDefinition
from sitl.campaign.paper_numbers import PROPOSED

WORLD_TITLES = {
    "none": "No obstacles",
    "pillars_10m": "Pillars, 10 m gap",
    "pillars_5m": "Pillars, 5 m gap",
    "simplified_forest": "Simplified forest",
    "forest": "Forest",
    "indoor_blocks": "Indoor blocks",
    "indoor_wall": "Indoor wall",
    "outdoor_pillars": "Outdoor pillars",
    "display_tower": "Display tower",
    "short_forest": "Short forest",
}
METHOD_TITLES = {
    "pacnav": "PACNav",
    "vpf": "VPF",
    "vpf_polar": "VPF, polar",
    "reynolds_apf": "Reynolds + APF (DAgger)",
    "lloyd": "Lloyd",
    "policy": "Learned policy",
    PROPOSED: "Proposed",
}
METRIC_TITLES = {
    "SR": "SR (%)",
    "MP": "MP (%)",
    "FR": "FR (m)",
    "MS": "MS (m)",
    "AL": "AL",
    "MDO": "MDO (m)",
}
PERCEIVING = " @ "
"""In print between a method and how it perceives."""
_PUBLISHED_AS = {LEARNED: PROPOSED}
_NEIGHBOURS = re.compile(r"^(?P<name>.+)_k(?P<count>\d{1,2})$")


@dataclass(frozen=True, slots=True)
class Labels:
    """The names of one campaign.

    Attributes:
        methods: the known method behind a name in the tables.
        worlds: the known site behind a name in the tables, for worlds in which the leader does nothing
            unusual.
        perceptions: names, in the order of the campaign's file; empty unless there are several.
    """

    methods: dict[str, str] = field(default_factory=dict)
    worlds: dict[str, str] = field(default_factory=dict)
    perceptions: tuple[str, ...] = ()

    @classmethod
    def of(cls, definition: CampaignDefinition) -> "Labels":
        """Return the names that a campaign's file gives."""
        swarm = definition.swarm
        unusual = swarm.leader.behaviour != "straight"
        perceived = definition.perceived()
        return cls(
            methods={entry.name: entry.method_name for entry in definition.method_entries},
            worlds={
                entry.name: site
                for entry in definition.world_entries
                if (site := entry.site_name) is not None
                and not (swarm.waypoints_m or entry.waypoints_world_m)
                and (entry.behaviour == "straight" or (entry.behaviour is None and not unusual))
            },
            perceptions=tuple(perceived) if len(perceived) > 1 else (),
        )

    def method(self, name: str) -> str:
        """Return the known method behind a name, as the published tables call it."""
        label, _ = split_perception(name)
        plain, _ = split_neighbours(label)
        found = self.methods.get(label, self.methods.get(plain, plain))
        return _PUBLISHED_AS.get(found, found)

    def site(self, name: str) -> str | None:
        """Return the site whose published numbers a world may stand beside, None if there is none."""
        return self.worlds.get(name)


def split_neighbours(name: str) -> tuple[str, int | None]:
    """Return a label without its number of neighbours, and that number where the label says it."""
    label, at, perception = name.partition(AT)
    found = _NEIGHBOURS.match(label)
    return (name, None) if found is None else (found["name"] + at + perception, int(found["count"]))


def split_perception(name: str) -> tuple[str, str | None]:
    """Return a label without its perception, and the perception's name where the label says it."""
    label, at, perception = name.partition(AT)
    return label, perception if at else None


def world_title(name: str) -> str:
    """Return how a world is called in print."""
    return WORLD_TITLES.get(name, name)


def method_title(name: str) -> str:
    """Return how a method is called in print."""
    label, perception = split_perception(name)
    plain, count = split_neighbours(label)
    title = METHOD_TITLES.get(plain, plain)
    if count is not None:
        title = f"{title}, {count} neighbours"
    return title if perception is None else f"{title}{PERCEIVING}{perception}"


def source(case: CaseSummary) -> str:
    """Return where a row of ours comes from."""
    return f"ours, {case.fidelity}"


def distinct(values: Sequence[str]) -> list[str]:
    """Return values once each, in order of appearance."""
    return list(dict.fromkeys(values))
