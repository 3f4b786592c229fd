"""The verb `sitl tune`."""

import functools
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from companion.command_line import AsJson, Result, conclude
from companion.exit_codes import ExitCode

if TYPE_CHECKING:
    from sitl.tune.tuning import Tuned


def tune(
    method: Annotated[str, typer.Argument(metavar="METHOD", help="flock, pacnav, vpf, ...")],
    out: Annotated[
        Path, typer.Option(help="Profile to write; beside the uav_follower.yaml that it extends.")
    ],
    target: Annotated[
        Literal["paper", "common"],
        typer.Option(help="Flock radius and separation: the paper's for this method, or 1.8 m and 1.5 m."),
    ] = "common",
    budget: Annotated[int, typer.Option(min=4, max=1_000_000, help="Sets of gains to try.")] = 300,
    scenes: Annotated[int, typer.Option(min=2, max=10_000, help="For each set, in each world.")] = 32,
    seed: Annotated[int, typer.Option(min=1, max=2**31 - 1, help="Of scenes and search.")] = 1,
    workers: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Processes; as many as there are cores by default.")
    ] = None,
    case: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SITE:FOLLOWERS[:BEHAVIOUR][=WEIGHT]",
            help="For flock: a case of the exam instead of its own; give it several times. "
            "pillars_5m:10=2 is ten followers between pillars, and failing there counts twice; "
            "forest:4:hover is a leader that hovers on its way. Free space with four is always flown.",
        ),
    ] = None,
    json_output: AsJson = False,
) -> None:
    """Tune the gains of a followers' law on training scenes and write them as a profile.

    A vehicle's profile can extend the file, and a campaign can name it as the parameters of a method. The
    same seed finds the same gains. A search that was stopped goes on where it was when it is started again
    with the same file; its journal lies beside it.

    The laws of others are tuned in free space to a flock radius and a separation; then their one gain against
    obstacles is chosen in the 10 m field of pillars. `flock` is tuned to succeed in all cases of one exam:
    4 and 10 followers between pillars 5 m apart, both forests, and leaders that hover, reverse and turn.
    """

    def body() -> tuple[Result, ExitCode]:
        from companion.control.followers.settings import METHODS
        from companion.errors import ProfileError
        from sitl.campaign.progress import ProgressLine
        from sitl.campaign.runner import Progress
        from sitl.campaign.scenes import prepare
        from sitl.campaign.trials import fly_scenes
        from sitl.campaign.workers import cores, on_processes
        from sitl.tune.stored import BASE, store, stored_text
        from sitl.tune.tuning import tune as tune_law

        if method not in METHODS:
            raise ProfileError(f"there is no method {method!r}; there are {', '.join(METHODS)}")
        if not (out.parent / BASE).exists():
            raise ProfileError(f"{out}: must lie beside a {BASE}, which it will extend")
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        prepare()
        line = ProgressLine(f"tuning {method}", "sets of gains")

        def show(done: int, best: float) -> None:
            line.show(Progress(done, max(budget, done), 0), f"best {best:.3g}")

        try:
            tuned = tune_law(
                method,
                target,
                budget=budget,
                scenes=scenes,
                seed=seed,
                journal=out.with_suffix(".search.jsonl"),
                execute=functools.partial(on_processes, fly_scenes, workers=workers or cores()),
                on_progress=show,
                cases=case or (),
            )
        except KeyboardInterrupt:
            line.close()
            typer.echo("stopped; the same command goes on from the generations flown so far", err=True)
            raise
        finally:
            line.close()
        result = _summary(method, target, tuned)
        command = f"sitl tune {method} --target {target} --budget {budget} --scenes {scenes} --seed {seed}"
        command += "".join(f" --case {text}" for text in case or ())
        store(out, stored_text(tuned.found.follower, method, [f"Written by: {command}", *_remarks(result)]))
        if not json_output:
            typer.echo("\n".join([*_remarks(result), f"written: {out}"]))
        return result | {"file": str(out)}, ExitCode.OK

    conclude(body, json_output)


def _summary(method: str, target: str, tuned: "Tuned") -> Result:
    from sitl.campaign.cases import summarise_case

    free = summarise_case(tuned.free)
    parts = [summarise_case(trials) for trials in tuned.found.flown]
    return {
        "method": method,
        "target": target,
        "target_FR": tuned.exam.target.flock_radius_m,
        "target_MS": tuned.exam.target.minimum_separation_m,
        "FR": free.FR.mean,
        "MS": free.MS.mean,
        "AL": free.AL.mean,
        "score": tuned.found.score,
        "start_score": tuned.found.start_score,
        "evaluations": tuned.found.evaluations,
        "rows": [{"world": p.world, "followers": p.followers, "trials": p.trials, "SR": p.SR} for p in parts],
        "gains": getattr(tuned.found.follower, method).model_dump(),
    }


def _remarks(result: Result) -> list[str]:
    """Say in a few lines what was found."""
    rates = ", ".join(f"{row['world']} with {row['followers']}: {row['SR']:.1f} %" for row in result["rows"])
    return [
        f"Five vehicles in free space: FR {result['FR']:.2f} m, MS {result['MS']:.2f} m, "
        f"AL {result['AL']:.2f}; wanted were {result['target_FR']:.2f} m and {result['target_MS']:.2f} m.",
        f"Success on training scenes that the search had not seen: {rates}.",
        f"Score {result['score']:.4g}, before {result['start_score']:.4g}, "
        f"after {result['evaluations']} sets of gains.",
    ]
