"""The `sitl` command: simulated flights."""

import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from companion import __version__
from companion.command_line import AsJson, Result, conclude, run
from companion.errors import ProfileError
from companion.exit_codes import ExitCode
from sitl.bench_cli import app as bench_app
from sitl.campaign_cli import campaign, trial
from sitl.odometry_peer_cli import odometry_peer
from sitl.policy_cli import card, evaluate, export
from sitl.swarm_cli import run_swarm
from sitl.train_cli import train
from sitl.tune_cli import tune
from sitl.world_cli import world

if TYPE_CHECKING:
    from sitl.outcome import Ending, Outcome
    from sitl.scenario import Stage

LOG_NAME = "flight.mcap"
_LAST_RUN = Path("runs/last")

app = typer.Typer(
    name="sitl",
    help="Software in the loop: the LiDAR, its IMU, the vehicle and PX4, emulated to the byte.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

app.add_typer(bench_app, name="bench")
app.command(
    epilog="Example: sitl campaign field_configs/campaign_comparison.yaml --trials 100 --worlds pillars_5m"
)(campaign)
app.command(
    epilog="Example: sitl trial runs/campaign --world pillars_5m --method flock --followers 4 --trial 17 "
    "--out trial_17.mcap"
)(trial)
app.command(epilog="Example: sitl train field_configs/train_best.yaml --minutes 10 --resume")(train)
app.command(epilog="Example: sitl evaluate runs/train_best/best.pt --trials 100 --against flock")(evaluate)
app.command(epilog="Example: sitl export runs/train_best/best.pt --out follower.onnx")(export)
app.command(
    epilog="Example: sitl card field_configs/campaign_comparison.yaml --training training_runs/train_best"
)(card)
app.command(
    epilog="Example: sitl tune pacnav --target paper --budget 300 --out field_configs/follower_pacnav_T1.yaml"
)(tune)
app.command(
    "odometry-peer", epilog="Example: sitl odometry-peer field_configs/sitl_uav_leader_external.yaml"
)(odometry_peer)
app.command(epilog="Example: sitl world pillars_5m --seed 7 --out world.html")(world)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    return run(app, "sitl", arguments)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"sitl {__version__}")
        raise typer.Exit


@app.callback()
def _top(
    _: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and leave.")
    ] = False,
) -> None:
    """Software in the loop: the LiDAR, its IMU, the vehicle and PX4, emulated to the byte."""


@app.command("run", epilog="Example: sitl run field_configs/sitl_leader_pillars.yaml --seed 7")
def run_scenario(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO", help="YAML scenario.")],
    seed: Annotated[int | None, typer.Option(min=0, help="Instead of the scenario's own.")] = None,
    wire: Annotated[bool, typer.Option("--wire", help="Real sockets, MAVSDK and real time.")] = False,
    px4: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Fly a PX4 that runs already, e.g. udpin://0.0.0.0:14540."),
    ] = None,
    px4_truth: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Where that PX4's simulator publishes its motion.")
    ] = "127.0.0.1:19410",
    px4_params: Annotated[
        Literal["check", "apply"], typer.Option(help="Compare that PX4's parameters, or write them too.")
    ] = "check",
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for flight.mcap; of a swarm for one such folder each, vehicle_00_leader, "
            "vehicle_01_follower, ..., or for swarm.mcap if abstract. Older logs become previous-*."
        ),
    ] = Path("runs/last"),
    fidelity: Annotated[
        Literal["full", "abstract"],
        typer.Option(help="Of a swarm: packets, odometry and tracking, or perception as a model."),
    ] = "full",
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, max=64, help="Processes of a swarm, one a core by default; results are the same."
        ),
    ] = None,
    packets: Annotated[
        bool,
        typer.Option("--packets/--no-packets", help="Log the LiDAR's packets and clouds of a swarm too."),
    ] = True,
    json_output: AsJson = False,
) -> None:
    """Fly one scenario and judge it: one vehicle, or a swarm if it has a section `swarm`.

    Without options: step by step, as fast as possible, and the same seed writes the same bytes. With `--wire`
    the process that flies is `companion fly` itself. Leaves with 0 on success and 3 when the flight failed.
    """
    truth_address = _address(px4_truth)
    if wire and px4 is not None:
        raise typer.BadParameter("--wire and --px4 exclude each other: both fly in real time")

    def body() -> tuple[Result, ExitCode]:
        from sitl.outcome import evaluate
        from sitl.scenario import load_scenario

        wanted = load_scenario(scenario)
        if wanted.swarm is not None:
            if wire or px4 is not None:
                raise ProfileError(f"{scenario}: a swarm flies in lockstep only: take --wire and --px4 away")
            return run_swarm(
                wanted,
                scenario.parent,
                seed,
                out,
                fidelity=fidelity,
                workers=workers,
                packets=packets,
                quiet=json_output,
                on_progress=_show,
            )
        if fidelity == "abstract":
            raise ProfileError(f"{scenario}: without a section swarm there is no abstract fidelity")
        out.mkdir(parents=True, exist_ok=True)
        log = out / LOG_NAME
        for older in (log, log.with_name(f"{LOG_NAME}.open")):
            if older.exists():
                older.replace(older.with_name(f"previous-{older.name}"))
        if px4 is not None:
            from sitl.px4_flight import fly_px4

            ending = fly_px4(
                wanted,
                scenario.parent,
                seed,
                log,
                url=px4,
                truth_address=truth_address,
                apply=px4_params == "apply",
                on_progress=_show,
                on_parameter=lambda line: print(f"PX4: {line}", file=sys.stderr),
            )
        else:
            from sitl.scenario import set_stage

            stage = set_stage(wanted, scenario.parent, seed)
            ending = _on_the_wire(stage, log) if wire else _lockstep(stage, log)
        if sys.stderr.isatty():
            print(file=sys.stderr)
        outcome = evaluate(ending, log)
        if not json_output:
            _print_outcome(outcome)
        return outcome.as_dict(), ExitCode.OK if outcome.success else ExitCode.NO_GO

    conclude(body, json_output)


def _address(text: str) -> tuple[str, int]:
    """Return host and port of ``HOST:PORT``."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65_536:
        raise typer.BadParameter(f"{text!r} is not HOST:PORT, like 127.0.0.1:19410")
    return host, int(port)


def _on_the_wire(stage: "Stage", log: Path) -> "Ending":
    from sitl.wire import fly_wire

    return fly_wire(stage, log, on_progress=_show)


def _lockstep(stage: "Stage", log: Path) -> "Ending":
    from companion.kernel_cache import load_kernels
    from sitl.lockstep import fly_lockstep

    load_kernels()
    # Like Ctrl-C: the log is closed in order.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    return fly_lockstep(stage, log, _show)


@app.command(epilog="Example: sitl px4 --gnss-denied")
def px4(
    gnss_denied: Annotated[
        bool, typer.Option("--gnss-denied", help="Boot with the parameters of a flight without GNSS.")
    ] = False,
    truth: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Where to publish the true motion.")
    ] = "127.0.0.1:19410",
    companion_port: Annotated[int, typer.Option(min=1, max=65535, help="UDP port of the companion.")] = 14540,
    seed: Annotated[int, typer.Option(min=0, help="Of all noise.")] = 1,
    json_output: AsJson = False,
) -> None:
    """Stand in for a PX4 with its internal simulator, until stopped.

    For trying `sitl run --px4` where no PX4 is at hand.
    """
    truth_address = _address(truth)

    def body() -> tuple[Result, ExitCode]:
        import asyncio

        from companion.clock import SystemClock
        from sitl.autopilot_parameters import GNSS_DENIED
        from sitl.mavlink_sockets import MavlinkSocketSettings
        from sitl.px4_standin import Px4StandIn

        sockets = MavlinkSocketSettings(companion_port=companion_port)
        parameters = GNSS_DENIED if gnss_denied else {}
        stand_in = Px4StandIn(parameters, sockets, truth_address, SystemClock(), seed)
        asyncio.run(stand_in.run())
        return {}, ExitCode.OK

    conclude(body, json_output)


@app.command(epilog="Example: sitl convert runs/last/flight.mcap flight.bag --to rosbag1 --truth flight.tum")
def convert(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="Flight log, network capture or LVX2 file.")
    ],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="File to write (a folder for ROS 2); must not exist.")
    ],
    to: Annotated[
        Literal["pcap", "pcapng", "lvx2", "rosbag1", "rosbag2", "rosbag2-mcap"],
        typer.Option(help="Format to write."),
    ],
    stamps: Annotated[
        Literal["sensor", "host"],
        typer.Option(help="In bags: the sensor's time, or when the driver received each packet."),
    ] = "sensor",
    truth: Annotated[
        Path | None, typer.Option(metavar="TUM", help="Write the true motion of an emulated flight here.")
    ] = None,
    json_output: AsJson = False,
) -> None:
    """Write the LiDAR's packets of a flight in a format that other programs read."""

    def body() -> tuple[Result, ExitCode]:
        from sitl.recording_writers.conversion import convert as write

        result = write(recording, out, to, stamps=stamps, truth=truth)
        if not json_output:
            print(f"{out}: {result['packets']} packets of {result['sensor']}")
        return result, ExitCode.OK

    conclude(body, json_output)


@app.command(epilog="Example: sitl schema > field_configs/scenario.schema.json")
def schema(json_output: AsJson = False) -> None:
    """Print the JSON schema of scenarios, for editors."""

    def body() -> tuple[Result, ExitCode]:
        from sitl.scenario import json_schema, schema_text

        if not json_output:
            print(schema_text(), end="")
        return {"schema": json_schema()}, ExitCode.OK

    conclude(body, json_output)


def _show(seconds: float, state: str, goal_distance_m: float) -> None:
    """Keep one line of progress on a terminal."""
    if sys.stderr.isatty():
        line = f"{seconds:5.0f} s  {state:<10} {goal_distance_m:5.1f} m to the goal"
        print(f"\r{line}", end="", file=sys.stderr, flush=True)


def _print_outcome(outcome: "Outcome") -> None:
    def number(value: float | None, digits: int, unit: str) -> str:
        return "-" if value is None else f"{value:.{digits}f} {unit}"

    odometry, latency, setpoints = outcome.odometry, outcome.latency_ms, outcome.setpoints
    rows = [
        ("flight", f"{'success' if outcome.success else 'FAILED'}: {outcome.reason}"),
        ("goal distance", number(outcome.goal_distance_m, 2, "m")),
        ("collisions", str(outcome.collisions)),
        ("simulated", f"{outcome.sim_time_s:.1f} s, {outcome.real_time_factor:.1f} x real time"),
        ("odometry", f"{number(odometry.ape_rmse_m, 3, 'm')} RMSE"),
        ("drift", number(odometry.drift_percent, 2, "%")),
        ("scan to setpoint", f"{number(latency.p50, 1, 'ms')} median, {number(latency.p99, 1, 'ms')} p99"),
        ("setpoints", f"{number(setpoints.rate_hz, 1, 'Hz')}"),
        ("longest gap", number(setpoints.max_gap_ms, 0, "ms")),
        ("LiDAR packets", f"{outcome.livox.packets} received, {outcome.livox.lost} lost"),
        ("log", outcome.log),
    ]
    for name, value in rows:
        print(f"{name:<17} {value}")
