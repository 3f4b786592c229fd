"""The part of `sitl run` that flies swarms."""

import math
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from companion.command_line import Result
from companion.exit_codes import ExitCode
from sitl.swarm.record import Fidelity

if TYPE_CHECKING:
    from sitl.scenario import Scenario
    from sitl.swarm.run import SwarmOutcome


def run_swarm(
    scenario: "Scenario",
    folder: Path,
    seed: int | None,
    out: Path,
    *,
    fidelity: Fidelity,
    workers: int | None,
    packets: bool,
    quiet: bool,
    on_progress: Callable[[float, str, float], None],
) -> tuple[Result, ExitCode]:
    """Fly a scenario with a swarm; see `sitl.swarm.run.fly_scenario`.

    Args:
        scenario: with its section `swarm`.
        folder: of its file.
        seed: instead of its own.
        out: folder of the logs.
        fidelity: of the flight.
        workers: processes, one a core if None.
        packets: log raw LiDAR packets and clouds too.
        quiet: print no table.
        on_progress: called once a simulated second.
    """
    from sitl.swarm.run import fly_scenario

    # Like Ctrl-C: the logs are closed in order.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    outcome = fly_scenario(
        scenario,
        folder,
        seed,
        out,
        fidelity=fidelity,
        workers=workers,
        packets=packets,
        on_progress=on_progress,
    )
    if sys.stderr.isatty():
        typer.echo(err=True)
    if not quiet:
        _print(outcome)
    return outcome.as_dict(), ExitCode.OK if outcome.record.end == "success" else ExitCode.NO_GO


def _print(outcome: "SwarmOutcome") -> None:
    record = outcome.record
    by = f" ({', '.join(map(str, record.ended_by))})" if record.ended_by else ""
    verdict = "success" if record.end == "success" else f"FAILED: {record.end.replace('_', ' ')}{by}"
    # Loaded late: the help of a command needs no numerical library.
    from companion.logs.metrics import DEFAULT_CAP_M

    far = f"none within {DEFAULT_CAP_M:g} m"
    rows = [
        ("swarm", verdict),
        ("followers", f"{record.followers}, {record.method}, {record.fidelity} fidelity"),
        ("time", f"{record.t_end_s:.1f} s since the start"),
        ("mission progress", f"{record.mission_progress_percent:.0f} %"),
        ("flock radius", _known(record.flock_radius_m, " m")),
        ("min. separation", _known(record.minimum_separation_m, " m")),
        ("alignment", _known(record.alignment)),
        ("obstacles", _known(record.obstacle_distance_m, " m", far if record.steps > 1 else "-")),
    ]
    if outcome.full is not None:
        factor = outcome.full.sim_time_s / outcome.full.wall_time_s
        rows.append(("simulated", f"{outcome.full.sim_time_s:.1f} s, {factor:.2f} x real time"))
        for member in outcome.full.members:
            who = "leader" if member.number == 0 else f"{member.leader_distance_m:.2f} m from the leader"
            rows.append((f"vehicle {member.number}", f"{member.state.value}, {who}, {member.log}"))
    else:
        rows.append(("log", str(outcome.logs[0])))
    for name, value in rows:
        typer.echo(f"{name:<17} {value}")


def _known(value: float, unit: str = "", otherwise: str = "-") -> str:
    return otherwise if math.isnan(value) else f"{value:.2f}{unit}"
