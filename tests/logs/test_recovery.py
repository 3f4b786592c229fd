from pathlib import Path

import pytest
from mcap.reader import make_reader

from companion.errors import LogError
from companion.logs.log_file import unfinished_path
from companion.logs.reader import FlightRecording
from companion.logs.recovery import recover
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import Tick
from tests.logs.samples import METADATA, entries


def abandoned(path: Path, count: int = 500) -> Path:
    """Write a log, flush it as a crash would leave it, and never close it."""
    log = FlightLog(path, LogSettings(chunk_kib=16), METADATA, threaded=False)
    for entry in entries(count):
        log.write(entry.channel, entry.message, entry.t_ns)
    left = unfinished_path(path)
    data = left.read_bytes()
    log.close()
    path.unlink()
    left.write_bytes(data)
    return left


def test_an_abandoned_log_becomes_a_complete_one_and_stays(tmp_path: Path) -> None:
    left = abandoned(tmp_path / "a.mcap")
    before = left.read_bytes()
    recovery = recover(left)
    assert recovery.path == tmp_path / "a.mcap"
    assert not recovery.was_complete
    assert recovery.bytes_lost == 0
    assert recovery.seconds_lost == 0.0
    # 500 messages of 20 ms; the last flush was at 9 s.
    assert 450 <= recovery.messages <= 500
    assert recovery.duration_s == pytest.approx(0.02 * (recovery.messages - 1))
    assert left.read_bytes() == before
    with recovery.path.open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) == recovery.messages
    old, new = FlightRecording(left), FlightRecording(recovery.path)
    assert new.integrity().complete
    assert new.flight == old.flight
    assert new.configuration == METADATA.configuration
    assert [entry.t_ns for entry in new.messages()] == [entry.t_ns for entry in old.messages()]


def test_a_log_cut_at_any_byte_is_recovered_up_to_the_cut(tmp_path: Path) -> None:
    whole = abandoned(tmp_path / "a.mcap", 300).read_bytes()
    cut_log = tmp_path / "cut.mcap.open"
    seen = -1
    for cut in [*range(40), *range(40, len(whole), len(whole) // 60), len(whole)]:
        cut_log.write_bytes(whole[:cut])
        recovery = recover(cut_log)
        assert recovery.messages >= seen
        assert recovery.bytes_lost <= cut
        assert FlightRecording(recovery.path).integrity().complete
        seen = recovery.messages
        recovery.path.unlink()
    assert seen >= 250


def test_lost_bytes_are_reported_with_the_time_they_held(tmp_path: Path) -> None:
    left = abandoned(tmp_path / "a.mcap", 1000)
    data = left.read_bytes()
    left.write_bytes(data[:-100])
    recovery = recover(left, tmp_path / "saved.mcap")
    assert recovery.bytes_lost > 0
    assert 0.0 < recovery.seconds_lost < 5.0


def test_recovering_a_complete_log_says_so(tmp_path: Path) -> None:
    log = FlightLog(tmp_path / "a.mcap", LogSettings(), METADATA, threaded=False)
    log.record(Tick(5), 5)
    log.close()
    recovery = recover(tmp_path / "a.mcap")
    assert recovery.was_complete
    assert recovery.path == tmp_path / "a.recovered.mcap"
    assert recovery.messages == 1


def test_nothing_is_overwritten_and_nothing_half_done_is_left(tmp_path: Path) -> None:
    left = abandoned(tmp_path / "a.mcap", 10)
    (tmp_path / "a.mcap").write_bytes(b"precious")
    with pytest.raises(LogError, match="exists already"):
        recover(left)
    other = tmp_path / "b.mcap.open"
    other.write_bytes(b"no log at all")
    with pytest.raises(LogError, match="no MCAP file"):
        recover(other)
    with pytest.raises(LogError, match="cannot be written"):
        recover(left, tmp_path / "missing" / "c.mcap")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap", "a.mcap.open", "b.mcap.open"]
