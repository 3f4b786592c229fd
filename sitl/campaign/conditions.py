"""All that decides how a trial goes, kept beside its results: whoever has the folder can fly it again."""

import hashlib
import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

import companion
import sitl
from companion.config import Profile, load_profile
from companion.control.followers.settings import FollowerSettings
from companion.control.model_file import pinned
from companion.errors import LogError, ProfileError
from companion.settings import Settings
from sitl.abstract.settings import AbstractSettings
from sitl.campaign.definition import LEARNED, CampaignDefinition, MethodEntry, Seeds
from sitl.campaign.own_worlds import FlownWorld, flown_world
from sitl.swarm.record import Fidelity
from sitl.swarm.settings import SwarmSettings
from sitl.wind import GENTLE_GUSTS, WindSettings

CONDITIONS_NAME = "campaign.json"
AT = "@"
"""Between a method and its perception, in no other name."""

_MAX_BYTES = 64 * 1024**2


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
    abstract: AbstractSettings | None = None
    """How its followers perceive in abstract fidelity, instead of what the rules say."""


class Conditions(Settings):
    """Rules, and what the names in the results mean."""

    rules: Rules
    worlds: dict[str, FlownWorld] = Field(max_length=1000)
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
        ProfileError: if a profile or a world that it names is wrong, or what it was told since it was read
            contradicts it.
    """
    contradiction = definition.contradiction()
    if contradiction is not None:
        (key,), found, allowed = contradiction
        raise ProfileError(f"{path}: {key}: found {found}, allowed {allowed}")
    full, folder = definition.fidelity == "full", path.parent
    wind = definition.wind or (GENTLE_GUSTS if full else WindSettings())
    perceived = {
        name: settings.model_copy(update={"wind": wind}) for name, settings in definition.perceived().items()
    }
    common = AbstractSettings.of(definition.perception).model_copy(update={"wind": wind})
    variants = {}
    for entry in definition.method_entries:
        follower = _gains(entry, folder)
        for label, count, perception in labels_of(definition, entry):
            variants[label] = Variant(
                method=entry.method_name,
                observable_neighbours=count,
                follower=follower,
                abstract=perceived[perception] if perception else None,
            )
    return Conditions(
        rules=Rules(
            seed=definition.seed,
            seeds=definition.seeds,
            fidelity=definition.fidelity,
            swarm=definition.swarm,
            abstract=common,
            obstacle_distance_cap_m=definition.obstacle_distance_cap_m,
            leader_profile=load_profile(folder / definition.leader_profile) if full else None,
            follower_profile=load_profile(folder / definition.swarm.follower_profile) if full else None,
        ),
        worlds={world.name: flown_world(world, folder) for world in definition.world_entries},
        variants=variants,
    )


def labels_of(definition: CampaignDefinition, entry: MethodEntry) -> list[tuple[str, int, str]]:
    """Return how a method is called in tables: label, number of neighbours, and perception of each variant.

    Number and perception are parts of the label where they vary.
    """
    counts, names = definition.observable_neighbours, [*definition.perceived()]
    return [
        (
            entry.name
            + (f"_k{count}" if len(counts) > 1 else "")
            + (f"{AT}{name}" if len(names) > 1 else ""),
            count,
            name,
        )
        for count in counts
        for name in names
    ]


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
    follower = FollowerSettings(controller="policy" if entry.method_name == LEARNED else "law")
    if entry.parameters is not None:
        follower = load_profile(folder / entry.parameters).follower or follower
    if entry.method_name != LEARNED:
        return follower.model_copy(update={"method": entry.method_name, "controller": "law"})
    if follower.controller != LEARNED:
        raise ProfileError(
            f"{folder / str(entry.parameters)}: follower.controller: found {follower.controller!r}, "
            f"allowed {LEARNED!r} for a method that was learned"
        )
    return pinned(follower)


def _first_difference(at: str, now: Any, before: Any) -> str | None:
    if isinstance(now, dict) and isinstance(before, dict):
        for name in {**before, **now}:
            inner = f"{at}.{name}" if at else str(name)
            found = _first_difference(inner, now.get(name), before.get(name))
            if found is not None:
                return found
        return None
    return None if now == before else f"{at} was {before}, now {now}"
