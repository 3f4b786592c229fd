"""The learning curve: one row an update in a CSV file, and the same for TensorBoard."""

import csv
from collections.abc import Mapping
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from companion.errors import LogError

MAX_BYTES = 1 << 28
_AXIS = ("update", "samples", "wall_s")


class Curve:
    """Writes rows as they come; a resumed training goes on after the last row that it knows of."""

    def __init__(self, folder: Path, update: int = 0) -> None:
        """Open the files in a folder.

        Args:
            folder: of the training.
            update: from which training goes on; rows after it are dropped.

        Raises:
            LogError: if there is a curve that cannot be continued.
        """
        self.path = folder / "curve.csv"
        self._rows = _rows_until(self.path, update) if self.path.exists() else []
        self._columns = list(self._rows[0]) if self._rows else []
        if self._rows:
            self._rewrite()
        elif self.path.exists():
            self.path.unlink()
        self._board = SummaryWriter(str(folder / "tensorboard"), purge_step=update + 1, flush_secs=20)

    def add(self, row: Mapping[str, float]) -> None:
        """Write one row; it begins with update, samples and wall_s. What it lacks stays empty."""
        new = [name for name in row if name not in self._columns]
        cells = {name: _cell(value) for name, value in row.items()}
        self._rows.append(cells)
        if new:
            self._columns += new
            self._rewrite()
        else:
            with self.path.open("a", newline="", encoding="utf-8") as file:
                csv.DictWriter(file, self._columns, restval="").writerow(cells)
        step = int(row["update"])
        for name, value in row.items():
            if name not in _AXIS:
                self._board.add_scalar(_tag(name), value, step)

    def close(self) -> None:
        """Flush what TensorBoard is still to get."""
        self._board.close()

    def _rewrite(self) -> None:
        unfinished = self.path.with_name(".curve.csv.new")
        with unfinished.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self._columns, restval="")
            writer.writeheader()
            writer.writerows(self._rows)
        unfinished.replace(self.path)


def _rows_until(path: Path, update: int) -> list[dict[str, str]]:
    if path.stat().st_size > MAX_BYTES:
        raise LogError(f"{path}: larger than any learning curve ({MAX_BYTES} bytes)")
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    try:
        return [row for row in rows if int(row["update"]) <= update]
    except (KeyError, TypeError, ValueError) as error:
        raise LogError(f"{path}: not a learning curve: a row without the number of its update") from error


def _cell(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def _tag(name: str) -> str:
    """Group curves: `term_cohesion` is shown as `term/cohesion`."""
    group, _, rest = name.partition("_")
    return f"{group}/{rest}" if group in ("term", "evaluation", "episode") and rest else f"training/{name}"
