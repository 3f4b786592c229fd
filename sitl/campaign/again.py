"""Any trial of a campaign, flown again from what its folder says."""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from companion.errors import LogError
from sitl.campaign.conditions import CONDITIONS_NAME, Conditions, kept_conditions, product_version
from sitl.campaign.journal import Key
from sitl.campaign.scenes import scene_of
from sitl.campaign.trial_log import write_trial_log
from sitl.swarm.record import TrialRecord


def fly_again(folder: Path, key: Key, out: Path) -> tuple[TrialRecord, list[Path]]:
    """Fly a trial of a campaign once more and keep its log.

    Args:
        folder: of the campaign's results.
        key: which trial; it need not have been flown before.
        out: log to write; a new folder of logs, one a vehicle, in full fidelity.

    Returns:
        The same record as in the campaign, and the logs.

    Raises:
        LogError: if there is no such campaign, world or method, if another version flew it, or if the log
            cannot be written.
    """
    conditions = kept_conditions(folder)
    if conditions is None:
        raise LogError(f"{folder}: no results of a campaign: there is no {CONDITIONS_NAME}")
    if conditions.rules.version != product_version():
        raise LogError(
            f"{folder}: flown by version {conditions.rules.version}; this is {product_version()}, "
            "which may fly differently"
        )
    world, label, _, _ = key
    _known(folder, "world", world, conditions.worlds)
    _known(folder, "method", label, conditions.variants)
    if out.exists():
        raise LogError(f"{out}: exists already")
    out.parent.mkdir(parents=True, exist_ok=True)
    if conditions.rules.fidelity == "abstract":
        if out.suffix != ".mcap":
            raise LogError(f"{out}: the name of a log ends in .mcap")
        return replace(write_trial_log(out, conditions, key), method=label), [out]
    return _fly_fully(conditions, key, out)


def _fly_fully(conditions: Conditions, key: Key, out: Path) -> tuple[TrialRecord, list[Path]]:
    # All of a companion is loaded for this; the abstract fidelity needs little of it.
    from sitl.campaign.full_trials import fly_one_fully
    from sitl.swarm.referee import TrialNames

    world, label, followers, number = key
    scene = scene_of(conditions.rules, conditions.worlds[world], followers, number)
    out.mkdir()
    names = TrialNames(world, label, number)
    flight = fly_one_fully(conditions.rules, conditions.variants[label], scene, names, out, packets=True)
    return flight.record, flight.logs


def _known(folder: Path, what: str, name: str, names: Collection[str]) -> None:
    if name not in names:
        raise LogError(f"{folder}: the campaign has no {what} {name!r}; it has {', '.join(names)}")
