"""The verbs of `sitl bench`."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.command_line import AsJson, Result, conclude
from companion.exit_codes import ExitCode
from sitl.bench.terminal import Progress, Table, names
from sitl.bench.tracking_cli import tracking

if TYPE_CHECKING:
    from sitl.bench.comparison import Result as ComparisonResult

app = typer.Typer(help="Measure what this product promises.", no_args_is_help=True, rich_markup_mode=None)

app.command(epilog="Example: sitl bench tracking --scenes weave,crowd --seeds 3 --seconds 60")(tracking)

_DEMO = Path("field_configs/sitl_leader_pillars.yaml")
_RECIPE = Path("field_configs/train_best.yaml")


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


@app.command(epilog="Example: sitl bench odometry --worlds pillars,forest --systems companion,rko_lio")
def odometry(
    worlds: Annotated[
        str, typer.Option(help="Worlds to fly in, separated by commas: indoor, pillars, forest, ...")
    ] = "all",
    systems: Annotated[
        str, typer.Option(help="Who takes part: companion, rko_lio, kiss_icp, small_gicp.")
    ] = "all",
    duration: Annotated[float, typer.Option(min=5.0, max=7200.0, help="Seconds per flight.")] = 60.0,
    seed: Annotated[int, typer.Option(min=0, help="Of world and noise.")] = 1,
    recording: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A recorded flight instead: PCAP, LVX2, ROS bag, flight log."),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(metavar="TUM", help="Its true path: the body's poses by the host's or sensor's clock."),
    ] = None,
    profile: Annotated[
        Path | None,
        typer.Option(metavar="YAML", help="Mount and settings; without it the body is the LiDAR."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for results.json, table.md and odometry.html.")] = Path(
        "runs/bench"
    ),
    json_output: AsJson = False,
) -> None:
    """Compare our odometry with its peers on the same flights: accuracy and time per scan.

    APE: distance of the body's path from the truth after the best rigid alignment, root mean square. Drift:
    mean error of the motion over stretches of 20, 40 and 80 m of path, seen from each stretch's start, in
    percent (as KITTI counts it). Times are of the call that registers a scan, on one thread; all systems
    take the same events in one process, in rotating order. The first two seconds do not count.
    """
    if recording is None and truth is not None:
        raise typer.BadParameter("--truth goes with --recording")
    if recording is not None and worlds != "all":
        raise typer.BadParameter("--worlds and --recording exclude each other")
    from sitl.bench.comparison import SYSTEMS
    from sitl.bench.courses import COURSES

    wanted_worlds = names(worlds, tuple(COURSES), "world")
    wanted_systems = names(systems, SYSTEMS, "system")

    def body() -> tuple[Result, ExitCode]:
        from companion.config import load_profile
        from companion.kernel_cache import load_kernels
        from sitl.bench.comparison_page import write
        from sitl.bench.odometry import Plan, measure
        from sitl.bench.recorded import measure_recording

        vehicle = load_profile(profile) if profile is not None else None
        out.mkdir(parents=True, exist_ok=True)
        _keep_output_for_us()
        load_kernels()
        table, progress = Table(), Progress()
        done: list[ComparisonResult] = []

        def show(result: "ComparisonResult") -> None:
            progress.clear()
            done.append(result)
            if not json_output:
                table.show(result.row.shown())

        try:
            if recording is not None:
                for result in measure_recording(recording, truth, wanted_systems, vehicle, progress.show):
                    show(result)
            else:
                settings = vehicle.odometry if vehicle is not None else None
                plan = Plan(wanted_worlds, wanted_systems, duration, seed, settings)
                measure(plan, show, progress.show)
        finally:
            progress.clear()
            files = [str(file) for file in write(out, done)] if done else []
        if not json_output:
            print("written: " + ", ".join(files))
        return {"rows": [result.row.as_dict() for result in done], "files": files}, ExitCode.OK

    conclude(body, json_output)


@app.command(epilog="Example: sitl bench consistency --worlds pillars,forest --runs 20")
def consistency(
    worlds: Annotated[
        str, typer.Option(help="Worlds to fly in, separated by commas: indoor, pillars, forest, ...")
    ] = "all",
    runs: Annotated[int, typer.Option(min=1, max=10_000, help="Flights in each world.")] = 20,
    seconds: Annotated[float, typer.Option(min=5.0, max=3600.0, help="Duration of a flight.")] = 25.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the first flight: world, biases and noise.")] = 1,
    json_output: AsJson = False,
) -> None:
    """Whether the covariance sent to the autopilot is true, over many flights.

    NEES: squared error in units of the published covariance, by degree of freedom, at a quarter, half, three
    quarters and the end of each flight; 1 if it is true. Leaves with 0 only if the means of position and
    attitude lie within the bounds that hold for 95 % of such means (all worlds together, if several).
    """
    from sitl.bench.courses import COURSES

    wanted = names(worlds, tuple(COURSES), "world")

    def body() -> tuple[Result, ExitCode]:
        from companion.kernel_cache import load_kernels
        from sitl.bench.consistency import Row, as_dict, measure

        load_kernels()
        table, progress = Table(), Progress()

        def on_run(world: str, count: int, row: Row) -> None:
            shown = f"position {row.position_nees:.2f}, attitude {row.attitude_nees:.2f}"
            progress.show(f"{world}: {count} of {runs} flights, NEES {shown}")

        rows: list[dict[str, object]] = []
        try:
            for row in measure(wanted, runs, seconds, seed, on_run):
                progress.clear()
                rows.append(as_dict(row))
                if not json_output:
                    table.show(rows[-1])
        finally:
            progress.clear()
        return {"rows": rows}, ExitCode.OK if rows[-1]["consistent"] else ExitCode.NO_GO

    conclude(body, json_output)


@app.command(epilog="Example: sitl bench failures --runs 200 --seed 1")
def failures(
    runs: Annotated[int, typer.Option(min=1, max=100_000, help="Failures in all, each kind in turn.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Of worlds, noise, moments and magnitudes.")] = 1,
    seconds: Annotated[float, typer.Option(min=8.0, max=600.0, help="Duration of a flight.")] = 20.0,
    json_output: AsJson = False,
) -> None:
    """Whether the odometry reports failures of its sensors within 0.3 s, and nothing in clean flight.

    Failures are injected into emulated flights; clean ones are flown in every world, whole and with a fifth
    of all packets lost. Leaves with 0 only if at least 99 % are reported in time and at most 1 % of the
    clean flights raise an alarm.
    """

    def body() -> tuple[Result, ExitCode]:
        from companion.kernel_cache import load_kernels
        from sitl.bench.failures import measure_clean, measure_failures, passes

        load_kernels()
        table, progress = Table(), Progress()
        try:
            rows = measure_failures(runs, seed, seconds, progress.show)
            if not json_output:
                progress.clear()
                for row in rows:
                    table.show(row)
            clean = measure_clean(seed, seconds, progress.show)
        finally:
            progress.clear()
        if not json_output:
            told = f"{clean['false_alarms']} false alarms in {clean['flights']} clean flights"
            print(f"{told}, {clean['seconds']:g} s in all")
        result: dict[str, object] = {"rows": rows, "clean": clean}
        return result, ExitCode.OK if passes(rows, clean) else ExitCode.NO_GO

    conclude(body, json_output)


@app.command(epilog="Example: sitl bench flights --seeds 20")
def flights(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO", help="YAML scenario.")] = _DEMO,
    seeds: Annotated[int, typer.Option(min=1, help="Number of flights, seeds 1, 2, ...")] = 20,
    wire: Annotated[bool, typer.Option("--wire", help="Real sockets, MAVSDK and real time.")] = False,
    out: Annotated[Path, typer.Option(help="Folder for the logs of failed flights.")] = Path("runs/bench"),
    json_output: AsJson = False,
) -> None:
    """Fly one scenario with many seeds; leaves with 0 only if every flight arrives."""

    def body() -> tuple[Result, ExitCode]:
        from sitl.bench.flights import measure

        out.mkdir(parents=True, exist_ok=True)
        shown = (lambda row: None) if json_output else Table().show
        rows = measure(scenario, seeds, out, wire=wire, on_row=shown)
        return {"rows": rows}, ExitCode.OK if rows[-1]["success"] else ExitCode.NO_GO

    conclude(body, json_output)


@app.command(epilog="Example: sitl bench swarm --sites pillars_5m,forest --followers 4")
def swarm(
    sites: Annotated[str, typer.Option(help="Worlds, separated by commas.")] = "pillars_5m",
    followers: Annotated[int, typer.Option(min=1, max=20, help="How many follow.")] = 4,
    trials: Annotated[int, typer.Option(min=1, help="Flights of each process.")] = 50,
    processes: Annotated[int, typer.Option(min=1, help="Measured with one process and with so many.")] = 2,
    json_output: AsJson = False,
) -> None:
    """Steps of UAVs a second in abstract swarms, scenes and the leader's routes included."""

    def body() -> tuple[Result, ExitCode]:
        from sitl.bench.swarm_speed import measure
        from sitl.worlds.sites import SITE_NAMES

        shown = (lambda row: None) if json_output else Table().show
        rows: list[dict[str, object]] = []
        for site in names(sites, SITE_NAMES, "site"):
            for number in dict.fromkeys((1, processes)):
                rows.append(measure(site, followers, trials, number))
                shown(rows[-1])
        return {"rows": rows}, ExitCode.OK

    conclude(body, json_output)


@app.command(
    epilog="Example: sitl bench environment field_configs/train_best.yaml --set environment.scenes=200"
)
def environment(
    recipe: Annotated[Path, typer.Argument(metavar="RECIPE", help="YAML recipe of a training.")] = _RECIPE,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change a setting of the recipe; may be repeated."),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Measured with one thread and with so many.")] = 2,
    steps: Annotated[int, typer.Option(min=1, help="Control steps of each.")] = 400,
    json_output: AsJson = False,
) -> None:
    """Steps of UAVs a second in the training environment alone, without networks; leaders count as UAVs."""

    def body() -> tuple[Result, ExitCode]:
        from sitl.bench.environment_speed import measure
        from sitl.training.settings import load_training

        table, progress = Table(), Progress()
        rows: list[dict[str, object]] = []

        def show_scenes(done: int, total: int) -> None:
            progress.show(f"scenes: {done} of {total} built")

        try:
            for row in measure(load_training(recipe, changes or ()), workers, steps, show_scenes):
                progress.clear()
                rows.append(row)
                if not json_output:
                    table.show(row)
        finally:
            progress.clear()
        return {"rows": rows}, ExitCode.OK

    conclude(body, json_output)


def _keep_output_for_us() -> None:
    """Send to the error output what libraries in C++ print, some of it as late as at exit."""
    try:
        ours = os.dup(sys.stdout.fileno())
    except (OSError, ValueError):  # not a real file: nothing to keep apart
        return
    sys.stdout.flush()
    os.dup2(sys.stderr.fileno(), 1)
    sys.stdout = os.fdopen(ours, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors, buffering=1)


def _shown(rows: Sequence[dict[str, object]], json_output: bool) -> Result:
    table = Table()
    if not json_output:
        for row in rows:
            table.show(row)
    return {"rows": list(rows)}
