"""The verbs `sitl campaign` and `sitl trial`."""

import functools
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from companion.command_line import AsJson, Result, conclude
from companion.exit_codes import ExitCode

if TYPE_CHECKING:
    from sitl.campaign.runner import Execute
    from sitl.swarm.record import TrialRecord

_LOGS = "logs"
_SEVERAL = "separated by commas, or the option once for each"
_COLUMNS = (("MP", 1, 6), ("FR", 2, 7), ("MS", 2, 6), ("AL", 2, 6), ("MDO", 2, 7))


def campaign(
    definition: Annotated[Path, typer.Argument(metavar="FILE", help="YAML definition of the campaign.")],
    trials: Annotated[
        int | None, typer.Option(min=1, max=1_000_000, help="Scenes in each case, instead of the file's.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Processes; as many as there are cores by default.")
    ] = None,
    ray: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Fly on this Ray cluster: HOST:PORT, or auto for one here."),
    ] = None,
    fidelity: Annotated[
        Literal["abstract", "full"] | None, typer.Option(help="Instead of what the file says.")
    ] = None,
    worlds: Annotated[
        list[str] | None, typer.Option(metavar="NAME,...", help=f"Only these worlds; {_SEVERAL}.")
    ] = None,
    methods: Annotated[
        list[str] | None, typer.Option(metavar="NAME,...", help=f"Only these methods; {_SEVERAL}.")
    ] = None,
    followers: Annotated[
        list[str] | None, typer.Option(metavar="N,...", help=f"Only these sizes; {_SEVERAL}.")
    ] = None,
    perceptions: Annotated[
        list[str] | None, typer.Option(metavar="NAME,...", help=f"Only these perceptions; {_SEVERAL}.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the results; what is in it is kept.")] = Path(
        "runs/campaign"
    ),
    json_output: AsJson = False,
) -> None:
    """Fly many trials of swarms and write the tables.

    Every method flies the same scenes, and results do not depend on the number of workers or computers. A run
    that was stopped goes on where it was when it is started again with the same folder. A part of a campaign
    is printed as that part; tables and pages in the folder show everything of the campaign that is there.
    """
    if workers is not None and ray is not None:
        raise typer.BadParameter("--workers and --ray exclude each other: the cluster knows its own size")

    def body() -> tuple[Result, ExitCode]:
        from sitl.campaign.cases import summarise
        from sitl.campaign.conditions import conditions_of
        from sitl.campaign.definition import load_definition
        from sitl.campaign.progress import ProgressLine
        from sitl.campaign.report import write_report
        from sitl.campaign.runner import run_campaign, stored_trials
        from sitl.campaign.tasks import selection_of
        from sitl.campaign.trial_log import write_failed_logs

        wanted = load_definition(definition)
        changes = {"trials": trials, "fidelity": fidelity}
        wanted = wanted.model_copy(update={name: new for name, new in changes.items() if new is not None})
        conditions = conditions_of(wanted, definition)
        selection = selection_of(
            wanted,
            worlds=_chosen(worlds, [entry.name for entry in wanted.world_entries], "world"),
            methods=_chosen(methods, [entry.name for entry in wanted.method_entries], "method"),
            followers=_chosen(followers, [str(count) for count in wanted.followers], "number of followers"),
            perceptions=_chosen(perceptions, [*wanted.perceived()], "perception"),
        )
        # Like Ctrl-C: results and table are left in order.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        line = ProgressLine(wanted.title)
        try:
            records = run_campaign(conditions, selection, out, _executor(workers, ray), line.show)
        except KeyboardInterrupt:
            line.close()
            typer.echo(f"stopped; the same command goes on from what is in {out}", err=True)
            raise
        finally:
            line.close()
        if conditions.rules.fidelity == "abstract":
            write_failed_logs(out / _LOGS, conditions, records, wanted.failed_logs)
        stored = stored_trials(out, wanted)
        files = write_report(out, stored, wanted, functools.partial(_log_of, out))
        rows = [case.as_dict() for case in summarise(records)]
        if not json_output:
            _print_rows(rows)
            typer.echo(f"written, with all {len(stored)} trials: {', '.join(map(str, files))}")
        return {"rows": rows, "files": [*map(str, files)], "trials_in_files": len(stored)}, ExitCode.OK

    conclude(body, json_output)


def trial(
    campaign_folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a campaign's results.")],
    world: Annotated[str, typer.Option(help="Name of the world.")],
    method: Annotated[str, typer.Option(help="Name of the method.")],
    followers: Annotated[int, typer.Option(min=1, max=20, help="Size of the swarm without its leader.")],
    number: Annotated[int, typer.Option("--trial", min=0, help="Number of the trial, from 0.")],
    out: Annotated[
        Path, typer.Option(help="Log to write, ending in .mcap; a folder of logs in full fidelity.")
    ],
    json_output: AsJson = False,
) -> None:
    """Fly one trial of a campaign again, exactly as it was, and leave its log."""

    def body() -> tuple[Result, ExitCode]:
        from sitl.campaign.again import fly_again

        record, logs = fly_again(campaign_folder, (world, method, followers, number), out)
        if not json_output:
            typer.echo(f"{record.end} after {record.t_end_s:.1f} s: {', '.join(map(str, logs))}")
        result = {"end": record.end, "ended_by": list(record.ended_by), "t_end_s": record.t_end_s}
        return result | {"logs": [str(log) for log in logs]}, ExitCode.OK

    conclude(body, json_output)


def _log_of(folder: Path, record: "TrialRecord") -> str | None:
    """Return where a trial's log lies in a campaign's folder, if it is there."""
    from sitl.campaign.journal import key_of
    from sitl.campaign.trial_log import log_stem

    name = f"{_LOGS}/{log_stem(key_of(record))}.mcap"
    return name if (folder / name).exists() else None


def _executor(workers: int | None, ray: str | None) -> "Execute":
    from sitl.campaign.scenes import prepare
    from sitl.campaign.trials import fly_scenes

    if ray is not None:
        from sitl.campaign.ray_runner import on_cluster

        return functools.partial(on_cluster, fly_scenes, address=ray)
    from sitl.campaign.workers import cores, on_processes

    # Once here, so that workers find every kernel on the disk.
    prepare()
    return functools.partial(on_processes, fly_scenes, workers=workers or cores())


def _chosen(texts: list[str] | None, known: list[str], what: str) -> list[str]:
    """Return the names in lists separated by commas, in the order of the campaign's file."""
    if not texts:
        return known
    from companion.errors import ProfileError

    names = [name.strip() for text in texts for name in text.split(",")]
    for name in names:
        if name not in known:
            raise ProfileError(
                f"the campaign has no {what} {name!r}; it has {', '.join(filter(None, known)) or 'none'}"
            )
    return [name for name in known if name in names]


def _print_rows(rows: list[dict[str, Any]]) -> None:
    """Print a line for every case."""
    world, method = (max(map(len, [name, *(row[name] for row in rows)])) for name in ("world", "method"))
    heads = "".join(f"{name:>{width}}" for name, _, width in _COLUMNS)
    typer.echo(f"{'world':<{world}}  {'method':<{method}}  followers  trials   SR %  95 % interval  {heads}")
    for row in rows:
        low, high = row["SR_ci95"]
        means = "".join(f"{_number(row[name], digits):>{width}}" for name, digits, width in _COLUMNS)
        typer.echo(
            f"{row['world']:<{world}}  {row['method']:<{method}}  {row['followers']:9d}  {row['trials']:6d}  "
            f"{row['SR']:5.1f}  [{low:5.1f}, {high:5.1f}] {means}"
        )


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
