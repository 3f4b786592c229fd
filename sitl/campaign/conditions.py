"""All that decides how a trial goes, kept beside its results: whoever has the folder can fly it again."""

import hashlib
import json
from collections.abc import Collection, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

import companion
import sitl
from companion.config import Profile, load_profile
from companion.control.followers.settings import METHODS, FollowerSettings
from companion.errors import LogError, ProfileError
from companion.settings import Settings
from sitl.abstract.settings import AbstractSettings
from sitl.campaign.definition import CampaignDefinition, MethodEntry, Seeds, WorldEntry
from sitl.swarm.record import Fidelity
from sitl.swarm.settings import SwarmSettings
from sitl.wind import GENTLE_GUSTS
from sitl.worlds.sites import SITE_NAMES

CONDITIONS_NAME = "campaign.json"
_MAX_BYTES = 16 * 1024**2


@lru_cache(maxsize=1)
def product_version() -> str:
    """Return the version and a digest of all sources: trials of two versions must not share a table."""
    digest = hashlib.sha256()
    for package in (companion, sitl):
        root = Path(package.__path__[0])
        for source in sorted(root.rglob("*.py")):
            digest.update(source.relative_to(root).as_posix().encode())
            digest.update(source.read_bytes())
    return f"{companion.__version__}+{digest.hexdigest()[:12]}"


class OtherCampaignError(LogError):
    """A folder holds the results of a campaign under other conditions; the text says which."""


class Rules(Settings):
    """What all trials of a campaign have in common."""

    version: str = Field(default_factory=product_version)
    """Of the product that flew them, with a digest of its sources."""
    seed: int
    """Of the campaign."""
    seeds: Seeds
    """Which kind of scenes."""
    fidelity: Fidelity
    """How much of a vehicle is there."""
    swarm: SwarmSettings
    """Start, leader and rules."""
    abstract: AbstractSettings
    """Perception and motion in the abstract fidelity."""
    obstacle_distance_cap_m: float
    """Cap of MDO."""
    leader_profile: Profile | None = None
    """What the leader flies with; in full fidelity only."""
    follower_profile: Profile | None = None
    """What every follower flies with, but for the law, its gains and the number of neighbours; likewise."""


class Variant(Settings):
    """What a method's name in the tables stands for."""

    method: str
    """Its law."""
    observable_neighbours: int
    """How many neighbours count."""
    follower: FollowerSettings
    """Its gains."""


class Conditions(Settings):
    """Rules, and what the names in the results mean."""

    rules: Rules
    worlds: dict[str, WorldEntry] = Field(max_length=1000)
    """By name."""
    variants: dict[str, Variant] = Field(max_length=10_000)
    """Methods by label."""

    def merged(self, other: "Conditions") -> "Conditions":
        """Return these conditions with the names that only `other` knows."""
        return Conditions(
            rules=self.rules,
            worlds={**other.worlds, **self.worlds},
            variants={**other.variants, **self.variants},
        )

    def difference(self, other: "Conditions") -> str | None:
        """Return in words the first thing on which both say something and disagree, if there is any."""
        ours, theirs = self.model_dump(mode="json"), other.model_dump(mode="json")
        for section in ("worlds", "variants"):
            shared = ours[section].keys() & theirs[section].keys()
            for side in (ours, theirs):
                side[section] = {name: side[section][name] for name in sorted(shared)}
        return _first_difference("", ours, theirs)


def conditions_of(definition: CampaignDefinition, path: Path) -> Conditions:
    """Work out what a campaign's file means.

    Args:
        definition: the file.
        path: of the file, to whose folder the names in it are relative.

    Raises:
        ProfileError: if a profile that it names is wrong, or a site or method is not known.
    """
    for index, world in enumerate(definition.world_entries):
        _known(world.site_name, SITE_NAMES, f"{path}: worlds[{index}]", "site")
    variants = {}
    for index, entry in enumerate(definition.method_entries):
        _known(entry.method_name, METHODS, f"{path}: methods[{index}]", "method")
        follower = _gains(entry, path.parent)
        for count in definition.observable_neighbours:
            label = variant_label(entry.name, count, definition.observable_neighbours)
            variants[label] = Variant(
                method=entry.method_name, observable_neighbours=count, follower=follower
            )
    full, folder = definition.fidelity == "full", path.parent
    abstract = AbstractSettings.of(definition.perception)
    wind = definition.wind or (GENTLE_GUSTS if full else abstract.wind)
    if definition.wind is not None and not full and abstract.dynamics == "lag":
        raise ProfileError(
            f"{path}: wind: vehicles of `perception: paper` do not feel any in abstract fidelity; "
            "take it away, or fly `perception: measured`"
        )
    return Conditions(
        rules=Rules(
            seed=definition.seed,
            seeds=definition.seeds,
            fidelity=definition.fidelity,
            swarm=definition.swarm,
            abstract=abstract.model_copy(update={"wind": wind}),
            obstacle_distance_cap_m=definition.obstacle_distance_cap_m,
            leader_profile=load_profile(folder / definition.leader_profile) if full else None,
            follower_profile=load_profile(folder / definition.swarm.follower_profile) if full else None,
        ),
        worlds={world.name: world for world in definition.world_entries},
        variants=variants,
    )


def variant_label(name: str, neighbours: int, all_neighbours: Sequence[int]) -> str:
    """Return how a method is called in tables: by its name, and by its neighbours if their number varies."""
    return name if len(all_neighbours) == 1 else f"{name}_k{neighbours}"


def kept_conditions(folder: Path) -> Conditions | None:
    """Read under which conditions the results in a folder were flown; None where there are none.

    Raises:
        LogError: if the file is damaged or from another version.
    """
    path = folder / CONDITIONS_NAME
    if not path.exists():
        return None
    if path.stat().st_size > _MAX_BYTES:
        raise LogError(f"{path}: larger than {_MAX_BYTES} bytes, which no campaign's conditions are")
    try:
        return Conditions.model_validate_json(path.read_bytes())
    except ValidationError:
        raise LogError(f"{path}: not the conditions of a campaign of this version") from None


def claim(folder: Path, conditions: Conditions) -> None:
    """Make a folder the place of a campaign, or of more of it.

    Worlds, methods, sizes and trials may be added to what is there; what has the same name must be the same.

    Raises:
        OtherCampaignError: if results of another campaign are in the folder.
        LogError: if what is there cannot be read.
    """
    kept = kept_conditions(folder)
    if kept is not None:
        difference = conditions.difference(kept)
        if difference is not None:
            raise OtherCampaignError(
                f"{folder}: holds another campaign: {difference}; choose another folder with --out"
            )
        conditions = kept.merged(conditions)
    text = json.dumps(conditions.model_dump(mode="json"), indent=1, sort_keys=True) + "\n"
    path = folder / CONDITIONS_NAME
    if path.exists() and path.read_text(encoding="utf-8") == text:
        return
    unfinished = path.with_name(f"{path.name}.new")
    unfinished.write_text(text, encoding="utf-8")
    unfinished.replace(path)


def _gains(entry: MethodEntry, folder: Path) -> FollowerSettings:
    follower = FollowerSettings()
    if entry.parameters is not None:
        follower = load_profile(folder / entry.parameters).follower or follower
    return follower.model_copy(update={"method": entry.method_name})


def _known(name: str, names: Collection[str], at: str, what: str) -> None:
    if name not in names:
        raise ProfileError(f"{at}: there is no {what} {name!r}; there are {', '.join(names)}")


def _first_difference(at: str, now: Any, before: Any) -> str | None:
    if isinstance(now, dict) and isinstance(before, dict):
        for name in {**before, **now}:
            inner = f"{at}.{name}" if at else str(name)
            found = _first_difference(inner, now.get(name), before.get(name))
            if found is not None:
                return found
        return None
    return None if now == before else f"{at} was {before}, now {now}"
