import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from companion.directories import BusyError
from companion.errors import LogError
from sitl.campaign.journal import JOURNAL_NAME, key_of, opened, read_journal
from tests.sitl.campaign.varied_trials import RECORD, made_up


def test_trials_come_back_as_they_were_written(tmp_path: Path) -> None:
    trials = [made_up(number) for number in range(12)]
    with opened(tmp_path) as journal:
        journal.add(reversed(trials))
    with opened(tmp_path) as journal:
        assert [repr(trial) for trial in journal.records()] == [repr(trial) for trial in trials]
        assert len(journal) == 12
        assert key_of(trials[3]) in journal
        assert ("none", "flock", 4, 99) not in journal
    assert [repr(trial) for trial in read_journal(tmp_path)] == [repr(trial) for trial in trials]


def test_a_trial_that_comes_twice_is_written_once(tmp_path: Path) -> None:
    with opened(tmp_path) as journal:
        journal.add([RECORD])
        journal.add([RECORD, replace(RECORD, trial=1)])
    assert (tmp_path / JOURNAL_NAME).read_bytes().count(b"\n") == 2


@pytest.mark.parametrize("cut", [1, 40, 200])
def test_a_line_cut_short_is_dropped_and_flown_again(tmp_path: Path, cut: int) -> None:
    with opened(tmp_path) as journal:
        journal.add([made_up(number) for number in range(5)])
    path = tmp_path / JOURNAL_NAME
    path.write_bytes(path.read_bytes()[:-cut])
    with opened(tmp_path) as journal:
        assert [trial.trial for trial in journal.records()] == [0, 1, 2, 3]
        journal.add([made_up(4)])
    assert [repr(trial) for trial in read_journal(tmp_path)] == [repr(made_up(n)) for n in range(5)]


def test_a_process_killed_while_it_writes_loses_nothing_that_it_had_added(tmp_path: Path) -> None:
    program = (
        "from pathlib import Path\n"
        "from sitl.campaign.journal import opened\n"
        "from tests.sitl.campaign.varied_trials import made_up\n"
        f"with opened(Path({str(tmp_path)!r})) as journal:\n"
        "    for number in range(100_000):\n"
        "        journal.add([made_up(number)])\n"
        "        print(number, flush=True)\n"
    )
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    with child.stdout as lines:
        for line in lines:
            if int(line) == 40:
                os.kill(child.pid, signal.SIGKILL)
                break
        child.wait()
    with opened(tmp_path) as journal:
        numbers = [trial.trial for trial in journal.records()]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= 41


@pytest.mark.parametrize(
    "line", ["{}", "[]", "nonsense", '{"world": "none"}', '{"a":' + "9" * 5000 + "}", "\x00\xff"]
)
def test_a_line_that_is_no_trial_is_refused_with_its_place(tmp_path: Path, line: str) -> None:
    with opened(tmp_path) as journal:
        journal.add([RECORD])
    path = tmp_path / JOURNAL_NAME
    path.write_bytes(path.read_bytes() + line.encode("latin-1") + b"\n")
    with pytest.raises(LogError, match=f"{JOURNAL_NAME}:2: "), opened(tmp_path):
        pass


def test_two_campaigns_never_write_into_one_folder(tmp_path: Path) -> None:
    with opened(tmp_path), pytest.raises(BusyError, match="already running"), opened(tmp_path):
        pass
