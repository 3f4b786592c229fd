"""The verb `sitl train`."""

import signal
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from companion.command_line import AsJson, Result, conclude
from companion.exit_codes import ExitCode

if TYPE_CHECKING:
    from sitl.training.environment import SwarmBatch
    from sitl.training.runner import Evaluate, Trained, Training
    from sitl.training.settings import TrainingSettings


def train(
    definition: Annotated[Path, typer.Argument(metavar="FILE", help="YAML file of the training.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder of checkpoints and curve; runs/NAME of the file by default.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the folder's last checkpoint.")
    ] = False,
    updates: Annotated[
        int | None, typer.Option(min=1, max=10_000_000, help="Last update, instead of the file's.")
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(min=0.05, max=100_000.0, help="End this run after so long.")
    ] = None,
    device: Annotated[Literal["cpu", "cuda"], typer.Option(help="Where swarms and networks live.")] = "cpu",
    workers: Annotated[
        int | None, typer.Option(min=1, max=256, help="Threads; as many as there are cores by default.")
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Instead of what the file says, e.g. ppo.epochs=3."),
    ] = None,
    imitate: Annotated[
        bool,
        typer.Option(
            "--imitate", help="Learn from flock, not from rewards; `start` can name what comes of it."
        ),
    ] = False,
    json_output: AsJson = False,
) -> None:
    """Train a follower's policy on swarms in abstract fidelity.

    The same file and seed give the same policy on the same processor. A training that was stopped, by Ctrl-C
    too, goes on with --resume. curve.csv and TensorBoard's files in the folder show how it learns.
    """
    if imitate and (resume or minutes is not None or device != "cpu"):
        raise typer.BadParameter("--imitate goes with --updates, its number of rounds; not with this")

    def body() -> tuple[Result, ExitCode]:
        from companion.errors import ProfileError
        from sitl.training.settings import load_training

        settings = load_training(definition, changes or [])
        folder = out or Path("runs") / definition.stem
        if imitate:
            return _imitate(settings, folder, updates, workers, json_output), ExitCode.OK
        start = None if settings.start is None else definition.parent / settings.start
        if start is not None and not start.is_file():
            raise ProfileError(f"{definition}: start: there is no file {start}")
        trained = _train(settings, folder, resume, start, updates, minutes, device, workers)
        if trained.stopped:
            typer.echo(f"stopped after update {trained.update}; --resume goes on from there", err=True)
            raise KeyboardInterrupt
        result = _result(trained)
        if not json_output:
            typer.echo(
                f"{trained.update} updates, {trained.samples} samples, "
                f"{trained.samples_per_s:.0f} samples/s ({trained.samples_per_cpu_s:.0f} a core's second)\n"
                "written: " + ", ".join(str(file) for file in trained.files)
            )
        return result, ExitCode.OK

    conclude(body, json_output)


_STOPS = (signal.SIGINT, signal.SIGTERM)


class _Stop:
    """Ctrl-C and SIGTERM let the present update end and be saved; a second one does not wait."""

    def __init__(self) -> None:
        self._asked = False
        self._before: list[Any] = []

    def __enter__(self) -> "_Stop":
        self._before = [signal.signal(number, self._ask) for number in _STOPS]
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in zip(_STOPS, self._before, strict=True):
            signal.signal(number, handler)

    def __call__(self) -> bool:
        return self._asked

    def _ask(self, number: int, frame: Any) -> None:
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True


class _Told:
    """The line of progress: updates, or time where time is the limit."""

    def __init__(self, settings: "TrainingSettings", last: int, minutes: float | None) -> None:
        from companion.clock import SystemClock
        from sitl.campaign.progress import ProgressLine

        self._last, self._wall_s = last, None if minutes is None else minutes * 60.0
        self._line = ProgressLine(settings.title, "updates" if minutes is None else "seconds")
        self._clock = SystemClock()
        self._began_ns = self._clock.now_ns()
        self._kept = -1

    def show(self, training: "Training", row: Mapping[str, float]) -> None:
        from sitl.campaign.runner import Progress

        if self._kept < 0:
            self._kept = training.update - 1
        remark = f"update {training.update}, {row['samples_per_s']:.0f} samples/s, reward {row['reward']:.3f}"
        if "episode_SR" in row:
            remark += f", SR {row['episode_SR']:.1f} %"
        if self._wall_s is None:
            progress = Progress(training.update, self._last, self._kept)
        else:
            passed = int((self._clock.now_ns() - self._began_ns) * 1e-9)
            progress = Progress(min(passed, int(self._wall_s)), int(self._wall_s), 0)
        self._line.show(progress, remark)

    def close(self) -> None:
        self._line.close()


def _train(
    settings: "TrainingSettings",
    folder: Path,
    resume: bool,
    start: Path | None,
    updates: int | None,
    minutes: float | None,
    device: str,
    workers: int | None,
) -> "Trained":
    from sitl.campaign.workers import cores
    from sitl.training.runner import Limits, Training, must_be_free
    from sitl.training.torch_threads import calm_threads

    threads = workers or cores()
    calm_threads()
    if not resume:
        # Before minutes go into scenes.
        must_be_free(folder)
    training = Training(
        settings,
        _batch(settings, device, threads),
        folder,
        resume=resume,
        start=start,
        device=device,
        threads=threads if device == "cpu" else 1,
        evaluate=_evaluation(settings, threads),
    )
    last = updates or settings.schedule.updates
    told = _Told(settings, last, minutes)
    try:
        with _Stop() as stop:
            wall_s = None if minutes is None else minutes * 60.0
            return training.run(Limits(last, wall_s), stop, on_update=told.show)
    finally:
        told.close()
        training.close()


def _imitate(
    settings: "TrainingSettings", folder: Path, rounds: int | None, workers: int | None, quiet: bool
) -> Result:
    """Let the file's network learn from the file's law."""
    from sitl.campaign.progress import ProgressLine
    from sitl.campaign.runner import Progress
    from sitl.campaign.workers import cores
    from sitl.training.clear_sight import ClearSight
    from sitl.training.imitation import Imitation, Swarms
    from sitl.training.torch_threads import calm_threads

    threads = workers or cores()
    calm_threads()
    plan = settings.imitation if rounds is None else settings.imitation.model_copy(update={"rounds": rounds})
    settings = settings.model_copy(update={"imitation": plan})
    swarms = _batch(settings, "cpu", threads)
    batch: Swarms = swarms
    if plan.sight == "clear":
        batch = ClearSight(swarms, cohesion=plan.cohesion, trust=plan.trust)
    imitation = Imitation(settings, batch, folder, evaluate=_evaluation(settings, threads))
    line = ProgressLine(f"{settings.title}, imitation", "rounds")

    def show(number: int, row: Mapping[str, float]) -> None:
        line.show(Progress(number, plan.rounds, 0), f"{row['error_mps']:.3f} m/s from the law")

    try:
        with _Stop() as stop:
            done = imitation.run(stop, show)
    finally:
        line.close()
        imitation.close()
    if done.stopped:
        typer.echo(f"stopped after round {done.rounds}; {done.files[0]} holds what was learned", err=True)
        raise KeyboardInterrupt
    if not quiet:
        typer.echo(
            f"{done.rounds} rounds, {done.samples} samples, {done.error_mps:.3f} m/s from the law\n"
            "written: " + ", ".join(str(file) for file in done.files)
        )
    return {
        "rounds": done.rounds,
        "samples": done.samples,
        "error_mps": done.error_mps,
        "score": done.score,
        "files": [str(file) for file in done.files],
    }


def _batch(settings: "TrainingSettings", device: str, workers: int) -> "SwarmBatch":
    """Build the swarms, and say how far their scenes are."""
    from sitl.campaign.progress import ProgressLine
    from sitl.campaign.runner import Progress
    from sitl.training.environment import SwarmBatch

    kind = SwarmBatch
    if device == "cuda":
        from sitl.training.cuda_batch import CudaSwarmBatch

        kind = CudaSwarmBatch
    line = ProgressLine("scenes", "built")

    def show(done: int, total: int) -> None:
        line.show(Progress(done, total, 0))

    try:
        return kind(settings.environment, settings.contract, settings.seed, workers, on_scene=show)
    finally:
        line.close()


def _evaluation(settings: "TrainingSettings", workers: int) -> "Evaluate | None":
    """Build the scenes of evaluations, if there are to be any."""
    from sitl.campaign.progress import ProgressLine
    from sitl.campaign.runner import Progress
    from sitl.training.evaluation import Evaluation

    schedule = settings.schedule
    if not schedule.evaluate_every:
        return None
    line = ProgressLine("scenes of evaluations", "built")

    def show(done: int, total: int) -> None:
        line.show(Progress(done, total, 0))

    try:
        judge = Evaluation(
            schedule.evaluation_trials,
            follower=settings.environment.follower,
            abstract=settings.environment.abstract,
            workers=workers,
            on_scene=show,
        )
    finally:
        line.close()
    return lambda policy: judge(policy, settings.contract)


def _result(trained: "Trained") -> Result:
    return {
        "update": trained.update,
        "samples": trained.samples,
        "wall_s": trained.wall_s,
        "samples_per_s": trained.samples_per_s,
        "samples_per_cpu_s": trained.samples_per_cpu_s,
        "parameters_sha256": trained.parameters_sha256,
        "best_score": trained.best_score,
        "files": [str(file) for file in trained.files],
    }
