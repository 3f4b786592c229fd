"""The file of a campaign: which worlds, methods and swarms meet, how often, and under which rules."""

from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from companion.control.followers.settings import METHODS
from companion.settings import Settings
from companion.yaml_problems import misfit
from companion.yaml_source import read_tree, validated
from companion.yaml_tree import Node, quoted, refuse
from sitl.abstract.settings import AbstractSettings, PerceptionSettings, Preset
from sitl.swarm.record import Fidelity
from sitl.swarm.settings import Behaviour, SwarmSettings
from sitl.wind import WindSettings
from sitl.worlds.settings import Point, Way
from sitl.worlds.sites import FLOWN_SITES, SITE_NAMES

Name = Annotated[str, Field(min_length=1, max_length=48, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$")]
FileName = Annotated[str, Field(min_length=1, max_length=256)]
Seeds = Literal["held_out", "training"]
Table = Literal[
    "comparison",
    "scalability",
    "neighbours",
    "real_scenes",
    "waypoints",
    "leader_behaviour",
    "perceptions",
    "rewards",
]

LEARNED = "policy"
"""The method whose law was learned: its profile says where from."""

_SIGMAS = (
    "position_sigma_m",
    "position_sigma_per_m",
    "velocity_sigma_mps",
    "velocity_sigma_per_m",
    "ego_velocity_sigma_mps",
)


class WorldEntry(Settings):
    """One world of a campaign, and what is special about the flight in it."""

    name: Name
    """Name in tables."""
    site: str | None = Field(default=None, min_length=1, max_length=48)
    """Which of the known sites it is; without `file` and `mesh`, by default the one that it is called after.
    Entries of one site, file or mesh fly the same scenes."""
    file: FileName | None = None
    """A YAML file with a list of bodies instead, relative to this file."""
    mesh: FileName | None = None
    """A triangle mesh (PLY, STL, OBJ, OFF, glTF; metres, z up) instead, relative to this file."""
    mesh_voxel_m: float = Field(default=0.2, ge=0.02, le=5.0)
    """Resolution of the mesh: it becomes cubes of this side, merged into boxes."""
    mesh_ground_m: float | None = 0.0
    """Height of the ground plane that replaces what lies low in the mesh; null keeps the mesh's own floor."""
    spawn_world_m: Point | None = None
    """Middle of the swarm at the start, for worlds whose start is free to choose."""
    waypoints_world_m: Way | None = None
    """The leader's way, for worlds whose way is free to choose; by default that of the world's file, or one
    goal in a random direction. `swarm.waypoints_m` goes over it."""
    behaviour: Behaviour | None = None
    """How the leader flies, instead of what `swarm.leader.behaviour` says."""

    @model_validator(mode="after")
    def _is_one_world(self) -> "WorldEntry":
        given = [kind for kind in ("site", "file", "mesh") if getattr(self, kind) is not None]
        if len(given) > 1:
            raise misfit((given[1],), " and ".join(given), "one of site, file, mesh")
        for key in ("spawn_world_m", "waypoints_world_m"):
            if self.site_name in FLOWN_SITES and getattr(self, key) is not None:
                raise misfit((key,), f"a way in {self.site_name}", "none: the way of this site is part of it")
        return self

    @property
    def site_name(self) -> str | None:
        """Name of the site, None for a world of one's own."""
        return None if self.file or self.mesh else self.site or self.name

    @property
    def scenes_name(self) -> str:
        """What the seeds of its scenes are drawn for."""
        return self.site_name or self.file or self.mesh or self.name


class MethodEntry(Settings):
    """One way of following, and the gains with which it flies."""

    name: Name
    """Name in tables."""
    method: str | None = Field(default=None, min_length=1, max_length=48)
    """Which of the known methods it is; by default the one that it is called after."""
    parameters: FileName | None = None
    """Profile, relative to this file, whose section `follower` holds the gains, or names what was learned;
    without it the product's own gains, or the model that comes with it."""

    @property
    def method_name(self) -> str:
        """Name of the method."""
        return self.method or self.name


def _shape(value: object) -> str:
    return "name" if isinstance(value, str) else "entry"


WorldOrName = Annotated[
    Annotated[Name, Tag("name")] | Annotated[WorldEntry, Tag("entry")], Discriminator(_shape)
]
MethodOrName = Annotated[
    Annotated[Name, Tag("name")] | Annotated[MethodEntry, Tag("entry")], Discriminator(_shape)
]


class PerceptionEntry(Settings):
    """One way in which followers perceive, in abstract fidelity: a known one, and what is different in it."""

    name: Name
    """Name in tables."""
    preset: Preset = "paper"
    """Errors, delays and flight from which it starts: as published, or as measured in full fidelity."""
    settings: PerceptionSettings = PerceptionSettings()
    """What it changes; a key that is not there keeps the preset's value."""
    sigma_factor: float = Field(default=1.0, ge=0.0, le=20.0)
    """All standard deviations are multiplied with it."""
    compensate_latency: bool = True
    """Neighbours are predicted to now, as companions do unless told otherwise."""

    @model_validator(mode="after")
    def _is_possible(self) -> "PerceptionEntry":
        try:
            self.abstract()
        except ValidationError as error:
            detail = error.errors()[0]
            place = ("settings", *detail["loc"]) if detail["loc"] else ("settings",)
            found = f"{detail['input']!r}" if detail["loc"] else f"a contradiction with preset {self.preset}"
            raise misfit(place, found, str(detail["msg"]).removeprefix("Value error, ")) from None
        return self

    def abstract(self) -> AbstractSettings:
        """Return the settings of the abstract fidelity."""
        known = AbstractSettings.of(self.preset)
        values = known.perception.model_dump()
        values |= {name: getattr(self.settings, name) for name in self.settings.model_fields_set}
        values |= {name: self.sigma_factor * values[name] for name in _SIGMAS}
        neighbours = known.neighbours.model_copy(update={"compensate_latency": self.compensate_latency})
        perception = PerceptionSettings.model_validate(values)
        return known.model_copy(update={"perception": perception, "neighbours": neighbours})


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
    worlds: list[WorldOrName] = Field(min_length=1, max_length=100)
    """Names of sites, or entries."""
    methods: list[MethodOrName] = Field(min_length=1, max_length=100)
    """Names of methods, or entries."""
    followers: list[Annotated[int, Field(ge=1, le=20)]] = Field(default=[4], min_length=1, max_length=20)
    """Sizes of the swarm, without its leader."""
    observable_neighbours: list[Annotated[int, Field(ge=1, le=20)]] = Field(
        default=[12], min_length=1, max_length=20
    )
    """How many of its nearest neighbours a follower takes into account; each number is a row of its own."""
    perception: Preset = "paper"
    """Errors, delays and flight of the abstract fidelity: as published, or as measured in full fidelity."""
    perceptions: list[PerceptionEntry] = Field(default=[], max_length=50)
    """Several of them instead, each a row of its own in every table."""
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
    def _names_are_known_and_distinct(self) -> "CampaignDefinition":
        named: tuple[tuple[str, list[str]], ...] = (
            ("worlds", [entry.name for entry in self.world_entries]),
            ("methods", [entry.name for entry in self.method_entries]),
            ("followers", [str(count) for count in self.followers]),
            ("observable_neighbours", [str(count) for count in self.observable_neighbours]),
            ("perceptions", [entry.name for entry in self.perceptions]),
        )
        for section, names in named:
            for index, name in enumerate(names):
                if name in names[:index]:
                    raise misfit((section, index), f"{name!r} twice", "each once")
        for index, world in enumerate(self.world_entries):
            if world.site_name is not None:
                _known("worlds", index, "site", world.site_name, SITE_NAMES)
        for index, method in enumerate(self.method_entries):
            _known("methods", index, "method", method.method_name, (*METHODS, LEARNED))
        return self

    @model_validator(mode="after")
    def _perception_means_something(self) -> "CampaignDefinition":
        contradiction = self.contradiction()
        if contradiction is not None:
            raise misfit(*contradiction)
        return self

    def contradiction(self) -> tuple[tuple[str], str, str] | None:
        """Return what fidelity, perception and weather say against each other: key, found, allowed."""
        if self.fidelity == "full":
            if self.perceptions:
                return (("perceptions",), "perceptions in full fidelity", "them in abstract fidelity only")
            return None
        if self.perceptions and "perception" in self.model_fields_set:
            return (("perception",), "both perception and perceptions", "one of them")
        if self.wind is not None and any(s.dynamics == "lag" for s in self.perceived().values()):
            allowed = "it with measured perception: vehicles of `paper` do not feel any in abstract fidelity"
            return (("wind",), "weather", allowed)
        return None

    def perceived(self) -> dict[str, AbstractSettings]:
        """Return the settings of the abstract fidelity by name; a single one has no name."""
        if not self.perceptions:
            return {"": AbstractSettings.of(self.perception)}
        return {entry.name: entry.abstract() for entry in self.perceptions}

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
        ProfileError: if it is wrong, or names a file that is not there, naming file, line and column.
    """
    tree = read_tree(path)
    definition = validated(tree, CampaignDefinition)
    for section in ("worlds", "methods"):
        _files_are_there(tree, section, path.parent)
    return definition


def _known(section: str, index: int, what: str, name: str, names: Collection[str]) -> None:
    if name not in names:
        raise misfit((section, index), f"{what} {name!r}", f"one of {', '.join(names)}")


def _files_are_there(tree: Node, section: str, folder: Path) -> None:
    """Refuse entries of a campaign's lists that name a file which does not exist."""
    assert isinstance(tree.value, dict)
    entries = tree.value[section].node.value
    assert isinstance(entries, list)
    for index, entry in enumerate(entries):
        if not isinstance(entry.value, dict):
            continue
        for key in ("parameters", "file", "mesh"):
            named = entry.value[key].node if key in entry.value else None
            if named is not None and isinstance(named.value, str) and not (folder / named.value).is_file():
                found = f"found {quoted(named.value, 120)}, allowed is a file that exists beside this one"
                raise refuse(named.mark, (section, index, key), found)
