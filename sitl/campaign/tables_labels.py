"""What the names in results stand for, and how they are called in print."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from sitl.campaign.cases import CaseSummary
from sitl.campaign.definition import CampaignDefinition
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
_NEIGHBOURS = re.compile(r"^(?P<name>.+)_k(?P<count>\d{1,2})$")


@dataclass(frozen=True, slots=True)
class Labels:
    """The names of one campaign.

    Attributes:
        methods: the known method behind a name in the tables.
        worlds: the known site behind a name in the tables, for worlds in which the leader does nothing
            unusual.
    """

    methods: dict[str, str] = field(default_factory=dict)
    worlds: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, definition: CampaignDefinition) -> "Labels":
        """Return the names that a campaign's file gives."""
        swarm = definition.swarm
        unusual = swarm.leader.behaviour != "straight"
        return cls(
            methods={entry.name: entry.method_name for entry in definition.method_entries},
            worlds={
                entry.name: entry.site_name
                for entry in definition.world_entries
                if not swarm.waypoints_m
                and (entry.behaviour == "straight" or (entry.behaviour is None and not unusual))
            },
        )

    def method(self, name: str) -> str:
        """Return the known method behind a name."""
        plain, _ = split_neighbours(name)
        return self.methods.get(name, self.methods.get(plain, plain))

    def site(self, name: str) -> str | None:
        """Return the site whose published numbers a world may stand beside, None if there is none."""
        return self.worlds.get(name)


def split_neighbours(name: str) -> tuple[str, int | None]:
    """Return a method's name and how many neighbours it takes into account, where its label says so."""
    found = _NEIGHBOURS.match(name)
    return (name, None) if found is None else (found["name"], int(found["count"]))


def world_title(name: str) -> str:
    """Return how a world is called in print."""
    return WORLD_TITLES.get(name, name)


def method_title(name: str) -> str:
    """Return how a method is called in print."""
    plain, count = split_neighbours(name)
    title = METHOD_TITLES.get(plain, plain)
    return title if count is None else f"{title}, {count} neighbours"


def source(case: CaseSummary) -> str:
    """Return where a row of ours comes from."""
    return f"ours, {case.fidelity}"


def distinct(values: Sequence[str]) -> list[str]:
    """Return values once each, in order of appearance."""
    return list(dict.fromkeys(values))
