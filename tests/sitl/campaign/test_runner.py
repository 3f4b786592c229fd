import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from companion.errors import LogError
from sitl.campaign.conditions import (
    CONDITIONS_NAME,
    Conditions,
    OtherCampaignError,
    conditions_of,
    kept_conditions,
)
from sitl.campaign.definition import CampaignDefinition
from sitl.campaign.journal import JOURNAL_NAME
from sitl.campaign.runner import Progress, run_campaign
from sitl.campaign.store import TABLE_NAME, read_trials
from sitl.campaign.tasks import SceneTask, Selection, pending_tasks, selection_of, trial_seed
from sitl.swarm.record import TrialRecord
from sitl.worlds.seeds import is_held_out
from tests.sitl.campaign.varied_trials import RECORD

DEFINITION = CampaignDefinition(
    title="Made up", worlds=["none", "pillars_5m"], methods=["flock", "vpf"], followers=[2, 4], trials=10
)
CONDITIONS = conditions_of(DEFINITION, Path("campaign.yaml"))
WANTED = selection_of(DEFINITION)


def pretend(task: SceneTask) -> list[TrialRecord]:
    """Return results that depend on what a real flight depends on."""
    return [
        replace(
            RECORD,
            world=task.world.name,
            method=label,
            followers=task.followers,
            trial=trial,
            seed=trial_seed(task.rules.seed, task.world.scenes_name, task.followers, trial, held_out=True),
            flock_radius_m=trial / 7.0 + len(label),
        )
        for trial in task.trials
        for label, _ in task.variants
    ]


def in_order(tasks: Sequence[SceneTask]) -> Iterator[list[TrialRecord]]:
    return map(pretend, tasks)


def backwards(tasks: Sequence[SceneTask]) -> Iterator[list[TrialRecord]]:
    return map(pretend, reversed(tasks))


def stopped_after(count: int, tasks: Sequence[SceneTask]) -> Iterator[list[TrialRecord]]:
    for number, task in enumerate(tasks):
        if number == count:
            raise KeyboardInterrupt
        yield pretend(task)


def run(
    folder: Path,
    execute: object = in_order,
    selection: Selection = WANTED,
    conditions: Conditions = CONDITIONS,
) -> list[TrialRecord]:
    assert callable(execute)
    return run_campaign(conditions, selection, folder, execute, lambda progress: None)


def test_the_wanted_trials_come_back_case_by_case(tmp_path: Path) -> None:
    records = run(tmp_path / "new" / "folder")
    assert [(r.world, r.method, r.followers, r.trial) for r in records] == list(WANTED)
    assert len(records) == len(WANTED) == 80


def test_the_table_does_not_depend_on_the_order_in_which_results_come(tmp_path: Path) -> None:
    run(tmp_path / "a", in_order)
    run(tmp_path / "b", backwards)
    assert (tmp_path / "a" / TABLE_NAME).read_bytes() == (tmp_path / "b" / TABLE_NAME).read_bytes()
    assert (tmp_path / "a" / CONDITIONS_NAME).read_bytes() == (tmp_path / "b" / CONDITIONS_NAME).read_bytes()


def test_a_stopped_campaign_leaves_a_table_and_goes_on_where_it_was(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "a", lambda tasks: stopped_after(3, tasks))
    before = read_trials(tmp_path / "a" / TABLE_NAME)
    assert 0 < len(before) < len(WANTED)
    flown: list[SceneTask] = []

    def noted(tasks: Sequence[SceneTask]) -> Iterator[list[TrialRecord]]:
        flown.extend(tasks)
        return in_order(tasks)

    run(tmp_path / "a", noted)
    assert sum(len(task.trials) * len(task.variants) for task in flown) == len(WANTED) - len(before)
    run(tmp_path / "b")
    assert (tmp_path / "a" / TABLE_NAME).read_bytes() == (tmp_path / "b" / TABLE_NAME).read_bytes()


def test_trials_on_the_disk_are_in_the_table_when_an_interrupt_comes_before_they_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []

    def interrupted(descriptor: int) -> None:
        synced.append(descriptor)
        if len(synced) == 3:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path)
    saved = (tmp_path / JOURNAL_NAME).read_bytes().splitlines()
    assert 0 < len(saved) < len(WANTED)
    assert len(read_trials(tmp_path / TABLE_NAME)) == len(saved)


def test_results_that_lost_their_last_line_are_completed(tmp_path: Path) -> None:
    run(tmp_path)
    table = (tmp_path / TABLE_NAME).read_bytes()
    journal = tmp_path / JOURNAL_NAME
    journal.write_bytes(journal.read_bytes()[:-25])
    run(tmp_path)
    assert (tmp_path / TABLE_NAME).read_bytes() == table


def test_a_finished_campaign_flies_nothing_again(tmp_path: Path) -> None:
    run(tmp_path)

    def nothing(tasks: Sequence[SceneTask]) -> Iterator[list[TrialRecord]]:
        raise AssertionError

    assert len(run(tmp_path, nothing)) == len(WANTED)


def test_progress_counts_what_was_there_before(tmp_path: Path) -> None:
    first = replace(WANTED, worlds=("none",))
    run(tmp_path, selection=first)
    seen: list[Progress] = []
    run_campaign(CONDITIONS, WANTED, tmp_path, in_order, seen.append)
    assert seen[0] == Progress(done=40, total=80, kept=40)
    assert seen[-1] == Progress(done=80, total=80, kept=40)


def test_more_trials_worlds_and_methods_can_be_added_to_a_folder(tmp_path: Path) -> None:
    run(tmp_path / "a", selection=Selection(("none",), ("flock",), (4,), 3))
    part = CampaignDefinition(title="Other", worlds=["pillars_5m"], methods=["vpf"], followers=[2, 4])
    conditions = conditions_of(part, Path("campaign.yaml"))
    run(tmp_path / "a", selection=Selection(("pillars_5m",), ("vpf",), (2,), 5), conditions=conditions)
    run(tmp_path / "a")
    run(tmp_path / "b")
    assert (tmp_path / "a" / TABLE_NAME).read_bytes() == (tmp_path / "b" / TABLE_NAME).read_bytes()
    assert kept_conditions(tmp_path / "a") == CONDITIONS


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"seed": 2}, "rules.seed was 1, now 2"),
        ({"perception": "measured"}, r"rules\.abstract\.perception\.\w+ was"),
        ({"obstacle_distance_cap_m": 3.0}, "rules.obstacle_distance_cap_m was 4.0, now 3.0"),
        ({"observable_neighbours": [5]}, "variants.flock.observable_neighbours was 12, now 5"),
        ({"worlds": [{"name": "none", "site": "forest"}]}, "worlds.none.site was None, now forest"),
    ],
)
def test_another_campaign_is_refused_in_a_folder_that_is_taken(
    tmp_path: Path, change: dict[str, object], told: str
) -> None:
    run(tmp_path)
    values = json.loads(DEFINITION.model_dump_json()) | change
    other = CampaignDefinition.model_validate_json(json.dumps(values))
    with pytest.raises(OtherCampaignError, match=f"holds another campaign: {told}.*; choose another folder"):
        run(tmp_path, selection=selection_of(other), conditions=conditions_of(other, Path("campaign.yaml")))


def test_conditions_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    (tmp_path / CONDITIONS_NAME).write_text("{}", encoding="utf-8")
    with pytest.raises(LogError, match="not the conditions of a campaign"):
        run(tmp_path)


def test_methods_share_scenes_and_nothing_else_does() -> None:
    seeds = {
        (task.world.scenes_name, task.followers, trial): trial_seed(
            1, task.world.scenes_name, task.followers, trial, held_out=True
        )
        for task in pending_tasks(CONDITIONS, WANTED, (), 4)
        for trial in task.trials
    }
    assert len(set(seeds.values())) == len(seeds) == 40
    assert all(map(is_held_out, seeds.values()))
    assert not is_held_out(trial_seed(1, "none", 4, 0, held_out=False))
    assert trial_seed(1, "none", 4, 0, held_out=True) != trial_seed(2, "none", 4, 0, held_out=True)


def test_missing_methods_of_a_scene_are_flown_together() -> None:
    done = {("none", "vpf", 2, 1), ("none", "flock", 2, 2), ("none", "vpf", 2, 2)}
    selection = Selection(("none",), ("flock", "vpf"), (2,), 4)
    tasks = pending_tasks(CONDITIONS, selection, done, 4)
    assert [(task.trials, [label for label, _ in task.variants]) for task in tasks] == [
        ((0, 3), ["flock", "vpf"]),
        ((1,), ["flock"]),
    ]


def test_low_trials_come_first_in_every_case() -> None:
    firsts = [task.trials[0] for task in pending_tasks(CONDITIONS, WANTED, (), 4)]
    assert firsts == sorted(firsts)
