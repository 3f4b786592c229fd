"""The verbs of `sitl bench`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from companion.command_line import AsJson, Result, conclude
from companion.exit_codes import ExitCode

app = typer.Typer(help="Measure what this product promises.", no_args_is_help=True, rich_markup_mode=None)

_DEMO = Path("field_configs/sitl_leader_pillars.yaml")


@app.command(epilog="Example: sitl bench raycast --json")
def raycast(
    pillars: Annotated[int, typer.Option(min=1, help="Pillars in the world.")] = 60,
    json_output: AsJson = False,
) -> None:
    """Rays per second and core, and the time of a whole simulated scan."""

    def body() -> tuple[Result, ExitCode]:
        from sitl.bench.raycast import measure

        return _shown(measure(pillars), json_output), ExitCode.OK

    conclude(body, json_output)


@app.command(epilog="Example: sitl bench odometry --duration 60")
def odometry(
    duration: Annotated[float, typer.Option(min=5.0, help="Seconds per flight.")] = 60.0,
    seed: Annotated[int, typer.Option(min=0, help="Of world and noise.")] = 1,
    json_output: AsJson = False,
) -> None:
    """Accuracy and time per scan of our odometry on simulated flights."""

    def body() -> tuple[Result, ExitCode]:
        from companion.kernel_cache import load_kernels
        from sitl.bench.odometry import measure

        load_kernels()
        return _shown(measure(duration, seed), json_output), ExitCode.OK

    conclude(body, json_output)


@app.command(epilog="Example: sitl bench flights --seeds 20")
def flights(
    scenario: Annotated[Path, typer.Argument(help="YAML scenario.")] = _DEMO,
    seeds: Annotated[int, typer.Option(min=1, help="Number of flights, seeds 1, 2, ...")] = 20,
    wire: Annotated[bool, typer.Option("--wire", help="Real sockets, MAVSDK and real time.")] = False,
    out: Annotated[Path, typer.Option(help="Folder for the logs of failed flights.")] = Path("runs/bench"),
    json_output: AsJson = False,
) -> None:
    """Fly one scenario with many seeds; leaves with 0 only if every flight arrives."""

    def body() -> tuple[Result, ExitCode]:
        from sitl.bench.flights import measure

        out.mkdir(parents=True, exist_ok=True)
        shown = (lambda row: None) if json_output else _Table().show
        rows = measure(scenario, seeds, out, wire=wire, on_row=shown)
        return {"rows": rows}, ExitCode.OK if rows[-1]["success"] else ExitCode.NO_GO

    conclude(body, json_output)


class _Table:
    """Prints rows as they come, under one heading; columns are as wide as the first row needs."""

    def __init__(self) -> None:
        self._widths: list[int] = []

    def show(self, row: dict[str, object]) -> None:
        """Print one row."""
        if not self._widths:
            self._widths = [max(len(name), len(_cell(value))) for name, value in row.items()]
            print("  ".join(name.rjust(width) for name, width in zip(row, self._widths, strict=True)))
        cells = zip(row.values(), self._widths, strict=True)
        print("  ".join(_cell(value).rjust(width) for value, width in cells), flush=True)


def _shown(rows: Sequence[dict[str, object]], json_output: bool) -> Result:
    table = _Table()
    if not json_output:
        for row in rows:
            table.show(row)
    return {"rows": list(rows)}


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else "-" if value is None else str(value)
