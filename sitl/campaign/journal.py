"""Results on disk as they come: one line per trial, safe from a sudden end, and at last one sorted table."""

import json
import math
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from companion.directories import only_instance
from companion.errors import LogError
from sitl.swarm.record import TrialRecord

Key = tuple[str, str, int, int]
"""World, method, followers, trial."""

JOURNAL_NAME = "trials.jsonl"
LOCK_NAME = "campaign.lock"

_LINE_MAX = 4096
_FIELDS = tuple(field.name for field in fields(TrialRecord))
_MEANS = (
    "t_end_s",
    "mission_progress_percent",
    "flock_radius_m",
    "minimum_separation_m",
    "alignment",
    "obstacle_distance_m",
)


def key_of(record: TrialRecord) -> Key:
    """Return what tells a trial from every other of its campaign."""
    return record.world, record.method, record.followers, record.trial


class Journal:
    """The trials that a folder holds; made by `opened`."""

    def __init__(self, path: Path, descriptor: int, records: dict[Key, TrialRecord]) -> None:
        """Take over an open file and what was read from it."""
        self._path = path
        self._descriptor = descriptor
        self._records = records

    def __contains__(self, key: object) -> bool:
        return key in self._records

    def __getitem__(self, key: Key) -> TrialRecord:
        return self._records[key]

    def __len__(self) -> int:
        return len(self._records)

    def records(self) -> list[TrialRecord]:
        """Return every trial, sorted by world, method, followers and number."""
        return [self._records[key] for key in sorted(self._records)]

    def add(self, records: Iterable[TrialRecord]) -> None:
        """Append trials and wait until they are on the disk.

        Trials that are known already are left out: a task that a cluster ran twice gave the same twice.
        """
        new = [record for record in records if key_of(record) not in self._records]
        text = "".join(f"{_line(record)}\n" for record in new).encode()
        if not text:
            return
        written = 0
        while written < len(text):
            written += os.write(self._descriptor, text[written:])
        os.fsync(self._descriptor)
        self._records.update((key_of(record), record) for record in new)


@contextmanager
def opened(folder: Path) -> Iterator[Journal]:
    """Read the journal in a folder and hold it open for appending; nobody else can meanwhile.

    A last line that a sudden end cut short is dropped.

    Raises:
        BusyError: if another campaign works in the folder.
        LogError: if the journal holds anything but trials.
    """
    with only_instance(folder / LOCK_NAME):
        path = folder / JOURNAL_NAME
        records, size = _read(path)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            os.ftruncate(descriptor, size)
            os.lseek(descriptor, 0, os.SEEK_END)
            yield Journal(path, descriptor, records)
        finally:
            os.close(descriptor)


def read_journal(folder: Path) -> list[TrialRecord]:
    """Return the trials in a folder's journal, sorted, while somebody may still append to it.

    Raises:
        LogError: if it holds anything but trials.
    """
    records, _ = _read(folder / JOURNAL_NAME)
    return [records[key] for key in sorted(records)]


def _read(path: Path) -> tuple[dict[Key, TrialRecord], int]:
    """Return the trials and the number of bytes that they take."""
    records: dict[Key, TrialRecord] = {}
    size = 0
    if not path.exists():
        return records, size
    with path.open("rb") as file:
        number = 0
        while line := file.readline(_LINE_MAX + 1):
            number += 1
            if len(line) > _LINE_MAX:
                raise LogError(f"{path}:{number}: longer than {_LINE_MAX} bytes, which no trial is")
            if not line.endswith(b"\n"):
                break
            record = _record(line, path, number)
            records[key_of(record)] = record
            size += len(line)
    return records, size


def _line(record: TrialRecord) -> str:
    values: dict[str, Any] = asdict(record)
    for name in _MEANS:
        if not math.isfinite(values[name]):
            values[name] = None
    return json.dumps(values, separators=(",", ":"), allow_nan=False)


def _record(line: bytes, path: Path, number: int) -> TrialRecord:
    try:
        values = json.loads(line)
        if sorted(values) != sorted(_FIELDS):
            raise ValueError
        for name in _MEANS:
            values[name] = math.nan if values[name] is None else float(values[name])
        values["ended_by"] = tuple(int(index) for index in values["ended_by"])
        return TrialRecord(**values)
    except (ValueError, TypeError):
        raise LogError(f"{path}:{number}: not a trial of this version") from None
