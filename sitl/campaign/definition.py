"""The file of a campaign: which worlds, methods and swarms meet, how often, and under which rules."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from companion.settings import Settings
from companion.yaml_problems import misfit
from companion.yaml_source import load
from sitl.swarm.record import Fidelity
from sitl.swarm.settings import Behaviour, SwarmSettings
from sitl.wind import WindSettings

Name = Annotated[str, Field(min_length=1, max_length=48, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$")]
Seeds = Literal["held_out", "training"]
Perception = Literal["paper", "measured"]
Table = Literal["comparison", "scalability", "neighbours", "real_scenes", "waypoints", "leader_behaviour"]


class WorldEntry(Settings):
    """One world of a campaign, and what is special about the flight in it."""

    name: Name
    """Name in tables."""
    site: str | None = Field(default=None, min_length=1, max_length=48)
    """Which of the known sites it is; by default the one that it is called after. Entries of one site fly the
    same scenes."""
    behaviour: Behaviour | None = None
    """How the leader flies, instead of what `swarm.leader.behaviour` says."""

    @property
    def site_name(self) -> str:
        """Name of the site."""
        return self.site or self.name


class MethodEntry(Settings):
    """One way of following, and the gains with which it flies."""

    name: Name
    """Name in tables."""
    method: str | None = Field(default=None, min_length=1, max_length=48)
    """Which of the known methods it is; by default the one that it is called after."""
    parameters: str | None = Field(default=None, min_length=1, max_length=256)
    """Profile, relative to this file, whose section `follower` holds the gains; the product's own without."""

    @property
    def method_name(self) -> str:
        """Name of the method."""
        return self.method or self.name


class CampaignDefinition(Settings):
    """Every world with every method and every swarm, each trial with a seed of its own."""

    title: str = Field(min_length=1, max_length=120)
    """Heading of the tables."""
    table: Table | None = None
    """Which of the published tables is shown beside the results."""
    seed: int = Field(default=1, ge=0, le=2**31 - 1)
    """Everything random in every trial comes from it and from the names of world and swarm."""
    seeds: Seeds = "held_out"
    """Scenes that nothing was tuned or trained on, or those for tuning."""
    trials: int = Field(default=100, ge=1, le=1_000_000)
    """Scenes in each world for each size of swarm; every method flies the same ones."""
    fidelity: Fidelity = "abstract"
    """The model of perception, or packets, odometry, tracking and autopilot in each vehicle."""
    worlds: list[Name | WorldEntry] = Field(min_length=1, max_length=100)
    """Names of sites, or entries."""
    methods: list[Name | MethodEntry] = Field(min_length=1, max_length=100)
    """Names of methods, or entries."""
    followers: list[Annotated[int, Field(ge=1, le=20)]] = Field(default=[4], min_length=1, max_length=20)
    """Sizes of the swarm, without its leader."""
    observable_neighbours: list[Annotated[int, Field(ge=1, le=20)]] = Field(
        default=[6], min_length=1, max_length=20
    )
    """How many of its nearest neighbours a follower takes into account; each number is a row of its own."""
    perception: Perception = "paper"
    """Errors, delays and flight of the abstract fidelity: as published, or as measured in full fidelity."""
    obstacle_distance_cap_m: float = Field(default=4.0, gt=0.0, le=100.0)
    """MDO averages only over moments with a surface nearer than this."""
    failed_logs: int = Field(default=1, ge=0, le=1000)
    """Of each case, so many failed trials are flown again in abstract fidelity to leave a log each."""
    leader_profile: str = Field(default="sitl_swarm_leader.yaml", min_length=1, max_length=256)
    """Profile of the leader in full fidelity, relative to this file."""
    wind: WindSettings | None = None
    """Weather; by default none in abstract and gentle gusts in full fidelity, as in `sitl run`. With
    `perception: paper` vehicles in abstract fidelity do not feel any."""
    swarm: SwarmSettings = SwarmSettings()
    """Start, leader and rules; `followers` counts only where the campaign does not say."""

    @model_validator(mode="after")
    def _names_are_distinct(self) -> "CampaignDefinition":
        named: tuple[tuple[str, list[str]], ...] = (
            ("worlds", [entry.name for entry in self.world_entries]),
            ("methods", [entry.name for entry in self.method_entries]),
            ("followers", [str(count) for count in self.followers]),
            ("observable_neighbours", [str(count) for count in self.observable_neighbours]),
        )
        for section, names in named:
            for index, name in enumerate(names):
                if name in names[:index]:
                    raise misfit((section, index), f"{name!r} twice", "each once")
        return self

    @property
    def world_entries(self) -> list[WorldEntry]:
        """Every world as an entry."""
        return [entry if isinstance(entry, WorldEntry) else WorldEntry(name=entry) for entry in self.worlds]

    @property
    def method_entries(self) -> list[MethodEntry]:
        """Every method as an entry."""
        return [
            entry if isinstance(entry, MethodEntry) else MethodEntry(name=entry) for entry in self.methods
        ]


def load_definition(path: Path) -> CampaignDefinition:
    """Read the file of a campaign.

    Raises:
        ProfileError: if it is wrong, naming file, line and column.
    """
    return load(path, CampaignDefinition)
