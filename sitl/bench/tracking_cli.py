"""`sitl bench tracking`: how well neighbours are seen, what that costs, and a model of its errors."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.command_line import AsJson, Result, conclude
from companion.exit_codes import ExitCode
from sitl.bench.terminal import Progress, Table, names

if TYPE_CHECKING:
    from sitl.bench.tracking import Case, Flight
    from sitl.bench.tracking_rows import Row
    from sitl.bench.tracking_scaling import Cost
    from sitl.bench.tracking_score import FlightScore

_REPEATS = 3


def tracking(
    scenes: Annotated[
        str, typer.Option(help="Scenes, separated by commas: ring, hover, pass, crowd, weave, aggressive.")
    ] = "all",
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Flights of each case.")] = 1,
    first_seed: Annotated[int, typer.Option(min=0, help="Of world, flight and noise.")] = 1001,
    seconds: Annotated[float, typer.Option(min=8.0, max=3600.0, help="Duration of a flight.")] = 30.0,
    tape: Annotated[
        bool | None, typer.Option("--tape/--no-tape", help="Only cases with, or without.")
    ] = None,
    distractors: Annotated[
        bool | None, typer.Option("--distractors/--no-distractors", help="Only cases with, or without.")
    ] = None,
    literal: Annotated[bool, typer.Option("--literal", help="The published method as it stands.")] = False,
    processes: Annotated[int, typer.Option(min=1, max=64, help="Flights at once.")] = 2,
    fit: Annotated[
        Path | None,
        typer.Option(metavar="YAML", help="Write errors of perception by range, for the abstract swarm."),
    ] = None,
    scaling: Annotated[
        bool, typer.Option("--scaling", help="Instead, processor time by number of points and neighbours.")
    ] = False,
    out: Annotated[Path, typer.Option(help="Folder for tracking.json, .md and .html.")] = Path("runs/bench"),
    json_output: AsJson = False,
) -> None:
    """How well neighbours are seen, with our own odometry in the loop: by range, number, tape, distractors.

    Detection rate: of the scans in which a neighbour could be seen, those with a validated track within
    0.5 m. Precision: of the validated tracks, those within 0.5 m of a neighbour. Latency is processor time;
    on busy cores measure it with --processes 1, or with --scaling, which leaves with 0 only if ten
    neighbours take at most 8 ms, the obstacle grid 2 ms, and time grows no faster than n log n in points.
    """
    if scaling:
        conclude(lambda: _scaling(first_seed, json_output), json_output)
    from sitl.bench.swarm_scenes import SCENES
    from sitl.bench.tracking import CASES

    wanted = names(scenes, tuple(SCENES), "scene")
    cases = [
        case
        for case in CASES
        if case.scene in wanted and tape in (None, case.tape) and distractors in (None, case.distractors)
    ]
    if not cases:
        raise typer.BadParameter("no case is left")

    def body() -> tuple[Result, ExitCode]:
        from companion.clock import SystemClock
        from companion.kernel_cache import load_kernels
        from companion.perception.tracking.settings import TrackingSettings
        from sitl.bench.tracking import measure
        from sitl.bench.tracking_page import shown, write
        from sitl.bench.tracking_rows import rows, together

        out.mkdir(parents=True, exist_ok=True)
        load_kernels()
        table, progress, clock = Table(), Progress(every=5), SystemClock()
        begun_ns = clock.now_ns()
        done: list[Row] = []
        scores: list[tuple[FlightScore, bool, bool]] = []

        def show(found: "list[Row]") -> None:
            done.extend(found)
            if not json_output:
                for row in found:
                    table.show({name: cell.rjust(7) for name, cell in shown(row).items()})

        def on_case(case: "Case", score: "FlightScore") -> None:
            progress.clear()
            found = rows(
                score, case.name, case.neighbours,
                tape=case.tape, distractors=case.distractors, windy=case.windy,
            )  # fmt: skip
            scores.append((score, case.tape, case.distractors))
            show(found)

        def on_flight(number: int, of: int, flight: "Flight") -> None:
            left_s = (clock.now_ns() - begun_ns) * 1e-9 / number * (of - number)
            told = f"{number} of {of} flights, last {flight.case.name} with seed {flight.seed}"
            progress.show(f"{told}; about {left_s:.0f} s left")

        settings = TrackingSettings.literal() if literal else None
        numbers = range(first_seed, first_seed + seeds)
        try:
            measure(cases, numbers, seconds, on_case, on_flight, settings, processes)
        finally:
            progress.clear()
            show(together(scores))
            files = [str(file) for file in write(out, done)] if done else []
        result: Result = {"rows": [row.as_dict() for row in done], "files": files}
        if fit is not None:
            result["perception"] = _write_fit(fit, [score for score, taped, _ in scores if taped])
            files.append(str(fit))
        if not json_output:
            typer.echo("written: " + ", ".join(files))
        return result, ExitCode.OK

    conclude(body, json_output)


def _write_fit(path: Path, scores: "list[FlightScore]") -> dict[str, object]:
    """Write the errors of perception of all flights with tape as YAML; return them.

    Raises:
        StartError: if those flights saw too little.
    """
    import yaml

    from companion.errors import StartError
    from sitl.bench.tracking_fit import fit as fitted
    from sitl.bench.tracking_score import FlightScore

    model = fitted(FlightScore.joined(scores)) if scores else None
    if model is None:
        raise StartError("the flights with tape saw too little to fit anything; fly longer or more scenes")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(model.as_dict(), sort_keys=False), "utf-8")
    return model.as_dict()


def _scaling(seed: int, json_output: bool) -> tuple[Result, ExitCode]:
    from companion.kernel_cache import load_kernels
    from sitl.bench.tracking_scaling import measure

    load_kernels()
    table = Table()

    def on_cost(cost: "Cost") -> None:
        if not json_output:
            table.show({name: _cell(value).rjust(10) for name, value in cost.as_dict().items()})

    costs, growth = measure(seed, 12.0, _REPEATS, on_cost)
    if not json_output:
        typer.echo(
            f"ten neighbours: {growth.tracker_ms:.1f} ms, grid {growth.grid_ms:.2f} ms; grows as points to "
            f"the power of {growth.exponent:.2f} (n log n: {growth.n_log_n_exponent:.2f})"
        )
    result: Result = {"rows": [cost.as_dict() for cost in costs], "growth": growth.as_dict()}
    return result, ExitCode.OK if growth.holds else ExitCode.NO_GO


def _cell(value: object) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value)
