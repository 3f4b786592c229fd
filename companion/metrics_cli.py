"""The verb `companion metrics`: a swarm's flight from the logs of its vehicles."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.command_line import AsJson, Result, conclude
from companion.exit_codes import ExitCode

if TYPE_CHECKING:
    from companion.logs.swarm_starts import StartPose, Vector

_CAP_M = 4.0
EPILOG = "Example: companion metrics uav1.mcap uav2.mcap uav3.mcap --starts starts.yaml --airborne"


def metrics(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Flight logs (.mcap), one a UAV.")],
    start: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=x,y,z,yaw_deg", help="Where a UAV's odometry began, m and deg; repeated."),
    ] = None,
    starts: Annotated[
        Path | None,
        typer.Option(metavar="YAML", help="The same for all: starts: {NAME: {position_m, yaw_deg}}."),
    ] = None,
    waypoint: Annotated[
        list[str] | None,
        typer.Option(metavar="x,y,z", help="The leader's way, for mission progress; repeated, goal last."),
    ] = None,
    cap: Annotated[
        float,
        typer.Option(
            metavar="M",
            min=0.01,
            help="MDO averages over moments with an obstacle this near, as in campaigns; inf: over all.",
        ),
    ] = _CAP_M,
    airborne: Annotated[
        bool, typer.Option("--airborne", help="Leave out times at which not all UAVs flew.")
    ] = False,
    from_s: Annotated[
        float, typer.Option("--from", metavar="S", min=0.0, help="Leave out the time before.")
    ] = 0.0,
    to_s: Annotated[
        float | None, typer.Option("--to", metavar="S", min=0.0, help="Leave out the time after.")
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Page to write.")] = None,
    json_output: AsJson = False,
) -> None:
    """Compute the swarm metrics of one flight: FR, MS, AL, MDO, and mission progress.

    Maps are laid together by start poses, or by the truth in logs of simulated flights; computers' clocks by
    the time of day, or by clock_offset_s in the file of starts. MDO is measured from each UAV to the clouds
    that it recorded itself, without ground and other UAVs; --json says its cap as MDO_cap_m, null if none.
    """

    def body() -> tuple[Result, ExitCode]:
        for log in logs:
            if not log.is_file():
                raise FileNotFoundError(f"{log}: no such file")
        given, waypoints = _places(start or [], starts, waypoint or [])

        import math

        from companion.logs.swarm_report import SwarmRequest, judge, write_swarm_page

        request = SwarmRequest(
            logs=tuple(logs),
            starts=given,
            waypoints=waypoints,
            airborne=airborne,
            from_s=from_s,
            to_s=math.inf if to_s is None else to_s,
            cap_m=cap,
        )
        found = judge(request, _show if sys.stderr.isatty() else None)
        page = output or logs[0].with_name("swarm.html")
        write_swarm_page(found, page)
        if not json_output:
            for line in found.lines():
                typer.echo(line)
            typer.echo(str(page))
        return {**found.as_dict(), "page": str(page)}, ExitCode.OK

    conclude(body, json_output)


def _show(log: Path) -> None:
    """Show which log is being read."""
    typer.echo(f"reading {log}", err=True)


def _places(
    start: list[str], starts: Path | None, waypoint: list[str]
) -> "tuple[dict[str, StartPose] | None, list[Vector]]":
    """Return start poses by name, None if none is given, and the way; the command line goes over the file."""
    from companion.logs.swarm_starts import SwarmStarts, parse_start, parse_waypoint
    from companion.yaml_source import load

    file = load(starts, SwarmStarts) if starts is not None else None
    given = dict(file.starts) if file is not None else {}
    given |= dict(parse_start(text) for text in start)
    waypoints = [parse_waypoint(text) for text in waypoint]
    return given or None, waypoints or (file.waypoints_m if file is not None else [])
