"""Runs a campaign into a folder: what is there already is kept, what comes is safe, the table is last."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sitl.campaign.conditions import Conditions, claim
from sitl.campaign.definition import CampaignDefinition
from sitl.campaign.journal import opened, read_journal
from sitl.campaign.store import TABLE_NAME, read_trials, write_trials
from sitl.campaign.tasks import SceneTask, Selection, pending_tasks, selection_of
from sitl.swarm.record import Fidelity, TrialRecord

Execute = Callable[[Sequence[SceneTask]], Iterator[list[TrialRecord]]]
"""Does tasks wherever it likes and gives their results in any order."""

SCENES_PER_TASK: dict[Fidelity, int] = {"abstract": 4, "full": 1}
"""What a sudden end costs, against what handing out a task costs (about 1 ms)."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a campaign is.

    Attributes:
        done: trials flown, in this run and before.
        total: all that are wanted.
        kept: of those done, how many were there before this run.
    """

    done: int
    total: int
    kept: int


def run_campaign(
    conditions: Conditions,
    selection: Selection,
    folder: Path,
    execute: Execute,
    on_progress: Callable[[Progress], None],
) -> list[TrialRecord]:
    """Fly what is still missing of a campaign and write its table.

    However it ends, the results so far are in the folder and the next run goes on from them.

    Args:
        conditions: under which all trials fly.
        selection: the wanted ones.
        folder: of the results; made if it does not exist.
        execute: does the tasks.
        on_progress: called at the start and whenever results have come.

    Returns:
        The wanted trials, case by case in the order of the selection.

    Raises:
        BusyError: if another run works in the folder.
        OtherCampaignError: if the folder holds another campaign.
        LogError: if what it holds cannot be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with opened(folder) as journal:
        claim(folder, conditions)
        tasks = pending_tasks(conditions, selection, journal, SCENES_PER_TASK[conditions.rules.fidelity])
        kept = sum(key in journal for key in selection)
        done, total = kept, len(selection)
        on_progress(Progress(done, total, kept))
        try:
            if tasks:
                for records in execute(tasks):
                    journal.add(records)
                    done += len(records)
                    on_progress(Progress(done, total, kept))
        finally:
            # An interrupt may come when a trial is on the disk but not yet counted: the disk decides.
            write_trials(folder, read_journal(folder))
        return [journal[key] for key in selection]


def stored_trials(folder: Path, definition: CampaignDefinition) -> list[TrialRecord]:
    """Return every trial in a folder's table that belongs to a campaign, whichever runs it came from.

    Trials of worlds, methods and sizes that the campaign's file does not name are left out.

    Raises:
        FileNotFoundError: if nothing has been flown into the folder.
        LogError: if the table cannot be read.
    """
    named = selection_of(definition)
    return [
        record
        for record in read_trials(folder / TABLE_NAME)
        if record.world in named.worlds
        and record.method in named.methods
        and record.followers in named.followers
    ]
