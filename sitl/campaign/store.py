"""Trials as a Parquet table: sorted and free of dates, so that equal trials are equal bytes."""

import os
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from companion.errors import LogError
from sitl.swarm.record import TrialRecord

TABLE_NAME = "trials.parquet"

_MAX_BYTES = 4 * 1024**3
_SCHEMA = pa.schema(
    [
        ("world", pa.string()),
        ("method", pa.string()),
        ("followers", pa.int16()),
        ("fidelity", pa.string()),
        ("trial", pa.int32()),
        ("seed", pa.int64()),
        ("scene_hash", pa.string()),
        ("end", pa.string()),
        ("ended_by", pa.list_(pa.int16())),
        ("t_end_s", pa.float64()),
        ("mission_progress_percent", pa.float64()),
        ("flock_radius_m", pa.float64()),
        ("minimum_separation_m", pa.float64()),
        ("alignment", pa.float64()),
        ("obstacle_distance_m", pa.float64()),
        ("steps", pa.int32()),
    ]
)


def write_trials(folder: Path, records: Sequence[TrialRecord]) -> Path:
    """Write trials in the order given as ``trials.parquet``, which appears whole or not at all."""
    path = folder / TABLE_NAME
    columns = {
        name: [list(r.ended_by) if name == "ended_by" else getattr(r, name) for r in records]
        for name in _SCHEMA.names
    }
    unfinished = path.with_name(f"{path.name}.new")
    pq.write_table(pa.table(columns, schema=_SCHEMA), unfinished, compression="zstd", compression_level=3)
    with unfinished.open("rb") as file:
        os.fsync(file.fileno())
    unfinished.replace(path)
    return path


def read_trials(path: Path) -> list[TrialRecord]:
    """Read what `write_trials` wrote.

    Raises:
        FileNotFoundError: if there is no such file.
        LogError: if it is something else.
    """
    if path.stat().st_size > _MAX_BYTES:
        raise LogError(f"{path}: larger than {_MAX_BYTES} bytes, which no campaign is")
    try:
        table = pq.read_table(path)
        if not table.schema.equals(_SCHEMA):
            raise LogError(f"{path}: not a table of trials of this version")
        return [TrialRecord(**row | {"ended_by": tuple(row["ended_by"])}) for row in table.to_pylist()]
    except pa.ArrowException:
        raise LogError(f"{path}: not a Parquet file that can be read") from None
