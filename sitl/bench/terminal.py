"""What the long measurements show on a terminal: a table that grows, and a line of progress."""

import sys
from collections.abc import Mapping, Sequence

import typer


class Progress:
    """One line on a terminal; elsewhere a line now and then."""

    def __init__(self, every: int = 60) -> None:
        """Begin.

        Args:
            every: number of texts of which one is shown where there is no terminal.
        """
        self._every = every
        self._width = 0
        self._count = 0

    def show(self, text: str) -> None:
        """Show the newest text."""
        self._count += 1
        if sys.stderr.isatty():
            typer.echo(f"\r{text.ljust(self._width)}", nl=False, err=True)
            self._width = len(text)
        elif self._count % self._every == 0:
            typer.echo(text, err=True)

    def clear(self) -> None:
        """Leave a clean line for what follows."""
        if self._width:
            typer.echo(f"\r{' ' * self._width}\r", nl=False, err=True)
            self._width = 0


class Table:
    """Prints rows as they come, under one heading; columns are as wide as the first row needs."""

    def __init__(self) -> None:
        self._widths: list[int] = []

    def show(self, row: Mapping[str, object]) -> None:
        """Print one row."""
        if not self._widths:
            self._widths = [max(len(name), len(_cell(value))) for name, value in row.items()]
            typer.echo("  ".join(name.rjust(width) for name, width in zip(row, self._widths, strict=True)))
        cells = zip(row.values(), self._widths, strict=True)
        typer.echo("  ".join(_cell(value).rjust(width) for value, width in cells))


def names(text: str, known: Sequence[str], what: str) -> list[str]:
    """Return the names in a list separated by commas; "all" stands for every one."""
    if text == "all":
        return list(known)
    # The packages write some of their names with a hyphen.
    wanted = list(dict.fromkeys(name.strip().replace("-", "_") for name in text.split(",")))
    for name in wanted:
        if name not in known:
            raise typer.BadParameter(f"there is no {what} {name!r}; there are {', '.join(known)}")
    return wanted


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else "-" if value is None else str(value)
