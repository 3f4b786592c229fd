"""The verb `sitl odometry-peer`."""

from pathlib import Path
from typing import Annotated

import typer

from companion.command_line import AsJson, Result, conclude
from companion.exit_codes import ExitCode

_Port = typer.Option(
    min=1, max=65_535, help="UDP port that hears copies of the LiDAR's packets of this kind."
)


def odometry_peer(
    profile: Annotated[Path, typer.Argument(metavar="PROFILE", help="YAML profile of the vehicle.")],
    points_port: Annotated[int, _Port] = 57_301,
    imu_port: Annotated[int, _Port] = 57_401,
    to: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Where MAVLink ODOMETRY goes.")
    ] = "127.0.0.1:14580",
    json_output: AsJson = False,
) -> None:
    """Play somebody else's odometry process, until stopped.

    It estimates from a copy of the LiDAR's packets, on a clock of its own, and sends MAVLink ODOMETRY to a
    companion whose profile says `odometry.source: external`.
    """
    host, _, port = to.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65_536:
        raise typer.BadParameter(f"{to!r} is not HOST:PORT, like 127.0.0.1:14580")

    def body() -> tuple[Result, ExitCode]:
        from companion.clock import SystemClock
        from companion.config import load_profile
        from companion.kernel_cache import load_kernels
        from sitl.odometry_peer import serve

        vehicle = load_profile(profile)
        load_kernels()
        sent = serve(vehicle, points_port, imu_port, (host, int(port)), SystemClock())
        return {"sent": sent}, ExitCode.OK

    conclude(body, json_output)
