"""Logs of single trials, flown once more with everything recorded."""

from collections.abc import Sequence
from pathlib import Path

from sitl.abstract.flight_log import write_log
from sitl.campaign.conditions import Conditions
from sitl.campaign.journal import Key, key_of
from sitl.campaign.scenes import prepare, scene_of
from sitl.campaign.trials import fly_one
from sitl.swarm.record import TrialRecord


def log_stem(key: Key) -> str:
    """Return how the log of a trial is called."""
    world, method, followers, trial = key
    return f"{world}-{method}-{followers}-{trial:06d}"


def write_failed_logs(
    folder: Path, conditions: Conditions, records: Sequence[TrialRecord], each: int
) -> list[Path]:
    """Leave logs of the first failed trials of every case in a folder; those that are there are kept.

    Args:
        folder: for the logs; made if it is needed.
        conditions: of the campaign, in abstract fidelity.
        records: all trials.
        each: how many logs a case gets at most.

    Returns:
        The logs.
    """
    left: dict[tuple[str, str, int], int] = {}
    paths = []
    for record in sorted(records, key=key_of):
        case = (record.world, record.method, record.followers)
        if record.end == "success" or left.setdefault(case, each) == 0:
            continue
        left[case] -= 1
        path = folder / f"{log_stem(key_of(record))}.mcap"
        if not path.exists():
            folder.mkdir(exist_ok=True)
            unfinished = path.with_name(f"{path.name}.new")
            write_trial_log(unfinished, conditions, key_of(record))
            unfinished.replace(path)
        paths.append(path)
    return paths


def write_trial_log(path: Path, conditions: Conditions, key: Key) -> TrialRecord:
    """Fly a trial of a campaign again, in abstract fidelity, and write how it went.

    Args:
        path: of the log; a file of that name is replaced.
        conditions: of the campaign.
        key: which trial.

    Returns:
        The same record as in the campaign, but with the name of the law for the method's label.

    Raises:
        LogError: if the log cannot be written.
    """
    world, label, followers, trial = key
    prepare()
    entry, variant = conditions.worlds[world], conditions.variants[label]
    scene = scene_of(conditions.rules, entry, followers, trial)
    flight = fly_one(conditions.rules, world, variant, scene, trial, record=True)
    write_log(scene, flight, path)
    return flight.record
