import os
from pathlib import Path

import pytest

from sitl.campaign.workers import WorkersError, cores, on_processes
from tests.sitl.campaign.chores import die, die_once, double


@pytest.mark.parametrize("workers", [1, 2])
def test_every_task_is_done_once(workers: int) -> None:
    assert sorted(on_processes(double, range(50), workers)) == [2 * number for number in range(50)]


def test_one_worker_is_this_process(tmp_path: Path) -> None:
    (tmp_path / "mark").touch()
    [(_, worker)] = on_processes(die_once, [(5, str(tmp_path / "mark"))], 1)
    assert worker == os.getpid()


def test_tasks_of_a_worker_that_dies_are_done_by_another(tmp_path: Path) -> None:
    chores = [(number, str(tmp_path / "mark")) for number in range(20)]
    results = list(on_processes(die_once, chores, 2))
    assert (tmp_path / "mark").exists()
    assert sorted(number for number, _ in results) == list(range(20))
    assert os.getpid() not in {worker for _, worker in results}


def test_workers_that_die_again_and_again_are_given_up_in_one_sentence() -> None:
    with pytest.raises(WorkersError, match="ended 3 times in a row"):
        list(on_processes(die, range(4), 2))


def test_there_is_a_core() -> None:
    assert cores() >= 1
