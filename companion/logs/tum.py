"""Trajectories as plain text, one pose a line: seconds, position, attitude (the TUM format).

A line is ``t tx ty tz qx qy qz qw`` with spaces between; lines that begin with ``#`` and empty lines
say nothing. The format: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats.
"""

import math
from collections.abc import Iterator
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from companion.clock import NANOSECONDS_PER_SECOND
from companion.errors import LogError
from companion.geometry import rotation
from companion.geometry.trajectory import Trajectory

MAX_BYTES = 256 * 1024 * 1024
MAX_POSES = 2_000_000
_LINE_BYTES_MAX = 1024
_COLUMNS = "t tx ty tz qx qy qz qw"
_TIME_LIMIT_S = Decimal(2**63) / NANOSECONDS_PER_SECOND
_REACH_M = 1e9
_UNIT_TOLERANCE = 0.01


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory.

    Args:
        path: file of at most `MAX_BYTES` bytes and `MAX_POSES` poses.

    Returns:
        The poses, attitudes normalised; times in nanoseconds, exactly as written.

    Raises:
        LogError: if there is no such file or a line is no pose; the text names file and line.
    """
    t_ns: list[int] = []
    values: list[list[float]] = []
    for number, line in _lines(path):
        at = f"{path}:{number}"
        t, pose = _parse(line, at)
        if t_ns and t <= t_ns[-1]:
            raise LogError(
                f"{at}: found a time that does not come after the one before it; times must ascend"
            )
        if len(t_ns) >= MAX_POSES:
            raise LogError(f"{at}: found more than {MAX_POSES} poses, the most that are allowed")
        t_ns.append(t)
        values.append(pose)
    if not t_ns:
        raise LogError(f"{path}: no pose in it; a line with a pose is '{_COLUMNS}'")
    table = np.array(values, dtype=np.float64)
    q = rotation.normalize(np.roll(table[:, 3:], 1, axis=1))
    return Trajectory(np.array(t_ns, dtype=np.int64), table[:, :3].copy(), q)


def require_place(path: Path) -> None:
    """Refuse a name under which no trajectory can be written; to be asked before long work, not after it.

    Raises:
        LogError: if the name belongs to a file that is no trajectory, such as a flight log: it would be lost.
        FileNotFoundError: if there is no such folder.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: no such folder")
    if not path.is_file():
        return
    try:
        for number, line in _lines(path):
            _parse(line, f"{path}:{number}")
            return
    except LogError:
        raise LogError(f"{path}: exists and is no trajectory, so it is not replaced") from None


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory; one of that name is replaced.

    Times have nine decimals; the other numbers as many as it takes to read them back unchanged.

    Raises:
        LogError: if there is a file of that name that is no trajectory.
        OSError: if the file cannot be written.
    """
    require_place(path)
    with path.open("w", encoding="ascii") as file:
        file.write(f"# {_COLUMNS}\n")
        for t, p, q in zip(
            trajectory.t_ns.tolist(), trajectory.p.tolist(), trajectory.q.tolist(), strict=True
        ):
            w, x, y, z = q
            seconds, rest = divmod(abs(t), NANOSECONDS_PER_SECOND)
            sign = "-" if t < 0 else ""
            pose = " ".join(map(repr, (*p, x, y, z, w)))
            file.write(f"{sign}{seconds}.{rest:09d} {pose}\n")


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield number and text of every line that says something."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise LogError(f"{path}: found {path.stat().st_size} bytes, allowed are {MAX_BYTES}")
        with path.open("rb") as file:
            number = 0
            while raw := file.readline(_LINE_BYTES_MAX + 1):
                number += 1
                if len(raw) > _LINE_BYTES_MAX:
                    raise LogError(f"{path}:{number}: a line of more than {_LINE_BYTES_MAX} bytes is no pose")
                text = raw.decode("utf-8", errors="replace").strip()
                if text and not text.startswith("#"):
                    yield number, text
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error


def _parse(line: str, at: str) -> tuple[int, list[float]]:
    """Return time in nanoseconds and (tx, ty, tz, qx, qy, qz, qw) of one line."""
    words = line.split()
    if len(words) != 8:
        raise LogError(
            f"{at}: found {len(words)} columns, allowed are eight, separated by spaces: {_COLUMNS}"
        )
    try:
        t_s = Decimal(words[0])
        pose = [float(word) for word in words[1:]]
    except (InvalidOperation, ValueError):
        raise LogError(f"{at}: found something that is no number, allowed are eight numbers") from None
    if not (t_s.is_finite() and -_TIME_LIMIT_S < t_s < _TIME_LIMIT_S):
        raise LogError(f"{at}: found the time {words[0][:40]}, allowed are seconds within 292 years")
    if not all(math.isfinite(value) and abs(value) <= _REACH_M for value in pose):
        raise LogError(f"{at}: found a value beyond any flight, allowed are numbers up to {_REACH_M:g}")
    if abs(math.hypot(*pose[3:]) - 1.0) > _UNIT_TOLERANCE:
        raise LogError(f"{at}: found a quaternion of length {math.hypot(*pose[3:]):.3g}, allowed is length 1")
    return round(t_s * NANOSECONDS_PER_SECOND), pose
