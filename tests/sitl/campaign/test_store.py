from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from companion.errors import LogError
from sitl.campaign.store import TABLE_NAME, read_trials, write_trials
from tests.sitl.campaign.varied_trials import made_up


def test_trials_come_back_from_the_table(tmp_path: Path) -> None:
    trials = [made_up(number) for number in range(20)]
    path = write_trials(tmp_path, trials)
    assert path == tmp_path / TABLE_NAME
    assert [repr(trial) for trial in read_trials(path)] == [repr(trial) for trial in trials]


def test_equal_trials_are_equal_bytes(tmp_path: Path) -> None:
    trials = [made_up(number) for number in range(50)]
    first = write_trials(tmp_path, trials).read_bytes()
    assert write_trials(tmp_path, trials).read_bytes() == first
    assert write_trials(tmp_path, trials[:49]).read_bytes() != first


def test_a_campaign_without_trials_has_an_empty_table(tmp_path: Path) -> None:
    assert read_trials(write_trials(tmp_path, [])) == []


def test_a_file_that_is_no_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / TABLE_NAME
    path.write_bytes(b"PAR1 but not really")
    with pytest.raises(LogError, match="not a Parquet file"):
        read_trials(path)


def test_a_table_of_something_else_is_refused(tmp_path: Path) -> None:
    path = tmp_path / TABLE_NAME
    pq.write_table(pa.table({"world": ["none"]}), path)
    with pytest.raises(LogError, match="not a table of trials"):
        read_trials(path)
