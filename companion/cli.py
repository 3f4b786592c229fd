"""The `companion` command: one thin function per verb."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from companion import __version__, metrics_cli
from companion.command_line import AsJson, Result, conclude, run
from companion.exit_codes import ExitCode

if TYPE_CHECKING:
    from companion.config import Profile

_PROGRESS_COLUMNS = 60

app = typer.Typer(
    name="companion",
    help="Flight-stack companion for PX4 vehicles: fly, check, look, report.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

ProfilePath = Annotated[Path, typer.Argument(metavar="PROFILE", help="YAML profile of the vehicle.")]
Vehicle = Annotated[
    str | None, typer.Option("--vehicle", help="Name of the vehicle, when several run on this computer.")
]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: the command line without the program's name; the process's own by default.

    Returns:
        The exit status.
    """
    return run(app, "companion", arguments)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"companion {__version__}")
        raise typer.Exit


@app.callback()
def _top(
    _: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and leave.")
    ] = False,
) -> None:
    """Flight-stack companion for PX4 vehicles: fly, check, look, report."""


def _load(path: Path) -> "Profile":
    from companion.config import load_profile

    return load_profile(path)


@app.command(epilog="Example: companion fly /etc/companion/uav1.yaml")
def fly(
    profile: ProfilePath,
    log_directory: Annotated[Path | None, typer.Option(help="Folder for the flight log.")] = None,
    json_output: AsJson = False,
) -> None:
    """Run on the vehicle until told to stop.

    Sensors in, setpoints out, everything logged. Arms nothing, and takes control only after an operator
    has authorised it.
    """

    def body() -> tuple[Result, ExitCode]:
        settings = _load(profile)

        from companion.flight import run_flight
        from companion.service import write_logs_to_stderr

        write_logs_to_stderr()
        outcome = run_flight(settings, os.environ, log_directory)
        if not json_output:
            print(f"{outcome.state.value}: {outcome.reason}; log {outcome.log}")
        result = {"state": outcome.state.value, "reason": outcome.reason, "log": str(outcome.log)}
        return result, ExitCode.INTERRUPTED if outcome.reason == "SIGINT" else ExitCode.OK

    conclude(body, json_output)


@app.command(epilog="Example: companion check field_configs/uav_leader.yaml --offline")
def check(
    profile: ProfilePath,
    offline: Annotated[bool, typer.Option("--offline", help="Leave out what needs the hardware.")] = False,
    json_output: AsJson = False,
) -> None:
    """Say go or no-go before a flight.

    One reason per check; nothing is changed on the autopilot.
    """

    def body() -> tuple[Result, ExitCode]:
        settings = _load(profile)

        from companion.clock import SystemClock
        from companion.directories import Directories
        from companion.preflight.check import is_go
        from companion.preflight.table import print_table, run_checks
        from companion.service import write_logs_to_stderr

        write_logs_to_stderr()
        directories = Directories.resolve(os.environ, settings.vehicle.name)
        checks = run_checks(settings, profile, directories, SystemClock(), offline=offline)
        go = is_go(checks)
        if not json_output:
            print_table(checks, settings.vehicle.name)
        result = {"go": go, "checks": [check.as_dict() for check in checks]}
        return result, ExitCode.OK if go else ExitCode.NO_GO

    conclude(body, json_output)


@app.command(epilog="Example: companion report flight.mcap --output flight.html")
def report(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Flight log (.mcap).")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Page to write.")] = None,
    json_output: AsJson = False,
) -> None:
    """Turn a flight log into one HTML page.

    The page opens without a network.
    """

    def body() -> tuple[Result, ExitCode]:
        if not log.is_file():
            raise FileNotFoundError(f"{log}: no such file")

        from companion.logs.report import write_report

        page = output or log.with_suffix(".html")
        write_report(log, page)
        if not json_output:
            print(page)
        return {"report": str(page)}, ExitCode.OK

    conclude(body, json_output)


@app.command(epilog="Example: companion recover flight.mcap.open")
def recover(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Unfinished or damaged log.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Log to write.")] = None,
    json_output: AsJson = False,
) -> None:
    """Save what can be read of a broken log.

    The old file stays as it is.
    """

    def body() -> tuple[Result, ExitCode]:
        if not log.is_file():
            raise FileNotFoundError(f"{log}: no such file")

        from companion.logs import recovery

        saved = recovery.recover(log, output)
        if not json_output:
            print(f"{saved.path}: {saved.messages} messages, {saved.duration_s:.1f} s")
            print(f"lost: {saved.bytes_lost} bytes, about {saved.seconds_lost:.1f} s")
        result = {name: getattr(saved, name) for name in saved.__slots__}
        return {**result, "path": str(saved.path)}, ExitCode.OK

    conclude(body, json_output)


@app.command(epilog="Example: companion replay flight.mcap --odometry-only --set odometry.fine_cell_m=0.2")
def replay(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="Flight log, or with --odometry-only a recording.")
    ],
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change a setting; may be repeated."),
    ] = None,
    odometry_only: Annotated[
        bool, typer.Option("--odometry-only", help="Leave out decisions; as fast as the machine can.")
    ] = False,
    profile: Annotated[
        Path | None,
        typer.Option("--profile", metavar="PROFILE", help="Instead of the recorded configuration."),
    ] = None,
    tum: Annotated[
        Path | None, typer.Option("--tum", metavar="FILE", help="Write the path, a pose per scan.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="LOG", help="Write a log of the replay.")
    ] = None,
    json_output: AsJson = False,
) -> None:
    """Run recorded packets through the code that flies and compare what comes out.

    Leaves with 0 if every message is as recorded, or if configuration or version differ, and with 4 if
    they do not and messages are different all the same. With --odometry-only it also takes packet
    captures, LVX2 files and ROS bags.
    """

    def body() -> tuple[Result, ExitCode]:
        if not log.exists():
            raise FileNotFoundError(f"{log}: no such file")

        from companion.clock import SystemClock
        from companion.kernel_cache import load_kernels
        from companion.replay.command import ReplayRequest
        from companion.replay.command import replay as run_replay
        from companion.replay.text import lines_of

        load_kernels()
        request = ReplayRequest(log, tuple(assignments or ()), profile, odometry_only, tum, out)
        tells = sys.stderr.isatty()
        try:
            result = run_replay(request, SystemClock(), _show_replay if tells else None)
        finally:
            if tells:
                print("\r" + " " * _PROGRESS_COLUMNS + "\r", end="", file=sys.stderr)
        if not json_output:
            for line in lines_of(result):
                print(line)
        return result.as_dict(), ExitCode.DIFFERENT if result.broken else ExitCode.OK

    conclude(body, json_output)


def _show_replay(fraction: float | None, seconds: float, factor: float) -> None:
    """Show how far a replay has come."""
    share = "" if fraction is None else f"{100.0 * fraction:3.0f} %, "
    line = f"{share}{seconds:.0f} s of flight, {factor:.1f} times real time"
    print(f"\r{line:<{_PROGRESS_COLUMNS}}", end="", file=sys.stderr, flush=True)


@app.command(epilog="Example: companion trajectory flight.mcap --tum flight.tum --source truth")
def trajectory(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Flight log (.mcap).")],
    tum: Annotated[Path, typer.Option("--tum", metavar="FILE", help="File to write.")],
    source: Annotated[
        Literal["odometry", "truth"], typer.Option(help="Whose path; only simulated flights hold the truth.")
    ] = "odometry",
    json_output: AsJson = False,
) -> None:
    """Write the path that a flight log holds as a TUM trajectory."""

    def body() -> tuple[Result, ExitCode]:
        if not log.is_file():
            raise FileNotFoundError(f"{log}: no such file")

        from companion.logs.tum import write_tum
        from companion.replay.motion import recorded_trajectory

        path = recorded_trajectory(log, source)
        write_tum(tum, path)
        if not json_output:
            print(f"{tum}: {len(path)} poses, {path.length_m:.1f} m")
        return {"tum": str(tum), "poses": len(path), "length_m": path.length_m}, ExitCode.OK

    conclude(body, json_output)


app.command(epilog=metrics_cli.EPILOG)(metrics_cli.metrics)


@app.command(epilog="Example: companion schema > field_configs/profile.schema.json")
def schema(json_output: AsJson = False) -> None:
    """Print the JSON schema of profiles.

    Editors complete and check profiles with it while one types.
    """

    def body() -> tuple[Result, ExitCode]:
        from companion.config import json_schema, schema_text

        if not json_output:
            print(schema_text(), end="")
        return {"schema": json_schema()}, ExitCode.OK

    conclude(body, json_output)


@app.command(epilog="Example: companion engage --vehicle uav1")
def engage(
    release: Annotated[bool, typer.Option("--release", help="Withdraw the permission.")] = False,
    vehicle: Vehicle = None,
    json_output: AsJson = False,
) -> None:
    """Permit the running companion to take control.

    It does so only when armed, airborne and healthy; `--release` withdraws the permission.
    """

    def body() -> tuple[Result, ExitCode]:
        answer = _ask("release" if release else "engage", vehicle)
        accepted = answer.get("ok") is True
        text = "released" if release else "authorised"
        if not json_output:
            print(text if accepted else f"refused: {answer.get('error', 'no reason given')}")
        return answer, ExitCode.OK if accepted else ExitCode.NO_GO

    conclude(body, json_output)


@app.command(epilog="Example: companion status --json")
def status(vehicle: Vehicle = None, json_output: AsJson = False) -> None:
    """Show what the running companion is doing."""

    def body() -> tuple[Result, ExitCode]:
        answer = _ask("status", vehicle)
        if not json_output:
            for key, value in answer.items():
                if key != "ok":
                    print(f"{key}: {value}")
        return answer, ExitCode.OK if answer.get("ok") is True else ExitCode.NO_GO

    conclude(body, json_output)


@app.command(epilog="Example: companion warmup")
def warmup(json_output: AsJson = False) -> None:
    """Compile the numerical kernels.

    Done once at installation, so that nothing is compiled in the air.
    """

    def body() -> tuple[Result, ExitCode]:
        from companion.kernel_cache import load_kernels

        def show(name: str, index: int, total: int) -> None:
            print(f"\r{index}/{total} {name:<40}", end="", file=sys.stderr, flush=True)

        kernels = load_kernels(show if sys.stderr.isatty() else None)
        if not json_output:
            print(f"{kernels} kernels ready")
        return {"kernels": kernels}, ExitCode.OK

    conclude(body, json_output)


def _ask(verb: str, vehicle: str | None) -> Result:
    """Send a request to the one running companion, or to the named one."""
    from companion.control_socket import NotRunningError, ask
    from companion.directories import control_sockets

    found = control_sockets(os.environ)
    if vehicle is not None:
        found = {name: path for name, path in found.items() if name == vehicle}
    if not found:
        name = f" named {vehicle}" if vehicle is not None else ""
        raise NotRunningError(f"no companion{name} runs here, or its socket belongs to another user")
    if len(found) > 1:
        raise NotRunningError(f"several companions run here, choose one with --vehicle: {', '.join(found)}")
    return ask(next(iter(found.values())), {"verb": verb})


if __name__ == "__main__":
    sys.exit(main())
