"""One line that says how far a campaign is and how long it will still take."""

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bar

from sitl.campaign.runner import Progress

_STEPS = 20


class ProgressLine:
    """A bar on a terminal; elsewhere a line for every twentieth of the work."""

    def __init__(self, title: str, unit: str = "trials") -> None:
        """Prepare a line on the error output; `show` draws it."""
        self._title = title
        self._unit = unit
        self._console = Console(stderr=True)
        self._bar: Bar | None = None
        self._task = TaskID(0)
        self._told = -1

    def show(self, progress: Progress, remark: str = "") -> None:
        """Show how far the campaign is, and a remark."""
        if self._console.is_terminal:
            self._draw(progress, remark)
            return
        step = _STEPS * progress.done // max(progress.total, 1)
        if step > self._told:
            kept = f", {progress.kept} of them before" if self._told < 0 and progress.kept else ""
            self._told = step
            text = f"{self._title}: {progress.done} of {progress.total} {self._unit}{kept}"
            text += f", {remark}" if remark else ""
            self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def close(self) -> None:
        """Leave a clean line for what follows."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def _draw(self, progress: Progress, remark: str) -> None:
        if self._bar is None:
            self._bar = Bar(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("elapsed"),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                console=self._console,
                transient=True,
            )
            # Counting from what was there before keeps the estimate honest.
            self._task = self._bar.add_task(
                self._title, total=progress.total - progress.kept, completed=progress.done - progress.kept
            )
            self._bar.start()
        title = f"{self._title}, {remark}" if remark else self._title
        self._bar.update(self._task, completed=progress.done - progress.kept, description=title)
