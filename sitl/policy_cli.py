"""The verbs `sitl export`, `sitl evaluate` and `sitl card`."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from companion.command_line import AsJson, Result, conclude
from companion.exit_codes import ExitCode

if TYPE_CHECKING:
    from sitl.abstract.policy_flight import Policy
    from sitl.campaign.cases import PairedComparison
    from sitl.campaign.differences import Difference
    from sitl.training.evaluation import Evaluation
    from sitl.training.settings import TrainingSettings

_CHECKPOINT = typer.Argument(metavar="CHECKPOINT", help="Of a training: best.pt, last.pt or imitated.pt.")
_WORKERS = typer.Option(min=1, max=256, help="Threads; as many as there are cores by default.")
_MODELS = Path("companion/models")


def export(
    checkpoint: Annotated[Path, _CHECKPOINT],
    out: Annotated[Path, typer.Option(help="Model to write.")],
    trials: Annotated[
        int, typer.Option(min=0, max=10_000, help="Scenes of each case of the table that the model carries.")
    ] = 40,
    workers: Annotated[int | None, _WORKERS] = None,
    json_output: AsJson = False,
) -> None:
    """Write a trained policy as the ONNX model that companions fly.

    File and network must agree on what followers see in flights of this very policy; otherwise nothing is
    written. The model carries its contract, limits and the table of its evaluation.
    """

    def body() -> tuple[Result, ExitCode]:
        from sitl.training.evaluation import TorchPolicy
        from sitl.training.export import export as write
        from sitl.training.model_card import evaluation_rows
        from sitl.training.runner import load_policy

        module, known = load_policy(_there(checkpoint))
        rows: list[dict[str, Any]] = []
        if trials:
            judge = _evaluation(known.settings, trials, workers)
            rows = evaluation_rows(judge.judge(TorchPolicy.of(module, known.settings.contract)).rows())
        done = write(module, known.settings, out, evaluation=rows)
        if not json_output:
            typer.echo(
                f"{done.path}: {done.size} bytes, sha256 {done.sha256}\n"
                f"within {done.difference_mps:.1e} m/s of the network on {done.observations} observations"
            )
        return {
            "model": str(done.path),
            "sha256": done.sha256,
            "bytes": done.size,
            "difference_mps": done.difference_mps,
            "observations": done.observations,
            "evaluation": rows,
        }, ExitCode.OK

    conclude(body, json_output)


def evaluate(
    policy: Annotated[Path, typer.Argument(metavar="POLICY", help="A model (.onnx) or a checkpoint (.pt).")],
    trials: Annotated[int, typer.Option(min=1, max=10_000, help="Scenes of each case.")] = 40,
    against: Annotated[
        str | None, typer.Option(metavar="METHOD", help="Fly this law in the same scenes, too.")
    ] = None,
    workers: Annotated[int | None, _WORKERS] = None,
    json_output: AsJson = False,
) -> None:
    """Judge a policy on the fixed scenes between training and test.

    They come from seeds for training that no training flies; campaigns judge on those held out.
    """

    def body() -> tuple[Result, ExitCode]:
        from companion.control.followers.settings import METHODS
        from companion.errors import ProfileError

        if against is not None and against not in METHODS:
            raise ProfileError(f"--against: no law {against!r}, there are {', '.join(METHODS)}")
        flown, settings = _policy(_there(policy))
        judge = _evaluation(settings, trials, workers)
        judged = judge.judge(flown)
        result: Result = {"score": judged.score, "rows": judged.rows()}
        texts = [_text(row) for row in judged.rows()]
        if against is not None:
            other = judge.judge_law(against)
            pairs, differences = judged.against(other), judged.differences(other)
            result |= {"against": other.rows(), "against_score": other.score}
            result["pairs"] = [
                pair.as_dict() | {name: number.as_dict() for name, number in metrics.items()}
                for pair, metrics in zip(pairs, differences, strict=True)
            ]
            texts += [_text(row) for row in other.rows()]
            texts += [f"minus {against}:", *map(_difference_text, pairs, differences)]
        if not json_output:
            typer.echo("\n".join([*texts, f"score {judged.score:.2f}"]))
        return result, ExitCode.OK

    conclude(body, json_output)


def card(
    campaigns: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Campaigns in which the model has flown.")
    ],
    results: Annotated[
        Path, typer.Option(help="Folder with a folder of results for each, called like its file.")
    ] = Path("runs"),
    model: Annotated[Path, typer.Option(help="The model.")] = _MODELS / "follower.onnx",
    training: Annotated[
        Path | None, typer.Option(help="Folder of its training, with configuration and curve.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Page to write.")] = _MODELS / "README.md",
    json_output: AsJson = False,
) -> None:
    """Write the model's page: what it was trained on, where it fails, and every table."""

    def body() -> tuple[Result, ExitCode]:
        from companion.control.policy import read_policy
        from companion.logs.figure_page import write_whole
        from sitl.campaign.definition import load_definition
        from sitl.training.model_card import Results
        from sitl.training.model_card import card as page

        known = read_policy(model)
        flown = [Results.stored(load_definition(path), results / path.stem) for path in campaigns]
        write_whole(out, page(known, flown, training))
        if not json_output:
            typer.echo(f"written: {out}")
        return {"page": str(out), "trials": sum(len(each.records) for each in flown)}, ExitCode.OK

    conclude(body, json_output)


def _policy(path: Path) -> "tuple[Policy, TrainingSettings]":
    """Return a policy and the settings under which it is judged."""
    from sitl.training.evaluation import TorchPolicy
    from sitl.training.runner import load_policy
    from sitl.training.settings import TrainingSettings

    if path.suffix == ".onnx":
        from companion.control.followers.settings import FollowerSettings
        from companion.control.policy import load_policy as load_model

        return load_model(FollowerSettings(controller="policy", model=str(path))), TrainingSettings()
    module, known = load_policy(path)
    return TorchPolicy.of(module, known.settings.contract), known.settings


def _evaluation(settings: "TrainingSettings", trials: int, workers: int | None) -> "Evaluation":
    """Build the scenes, and say how far they are."""
    from sitl.campaign.progress import ProgressLine
    from sitl.campaign.runner import Progress
    from sitl.campaign.scenes import prepare
    from sitl.campaign.workers import cores
    from sitl.training.evaluation import Evaluation

    prepare()
    line = ProgressLine("scenes of evaluations", "built")

    def show(done: int, total: int) -> None:
        line.show(Progress(done, total, 0))

    environment = settings.environment
    try:
        return Evaluation(
            trials,
            follower=environment.follower,
            abstract=environment.abstract,
            workers=workers or cores(),
            on_scene=show,
        )
    finally:
        line.close()


def _there(path: Path) -> Path:
    from companion.errors import ModelError

    if not path.is_file():
        raise ModelError(f"{path}: there is no such file")
    return path


def _difference_text(pair: "PairedComparison", metrics: Mapping[str, "Difference"]) -> str:
    numbers = "  ".join(f"{name} {each.mean:+.4f} (p {each.p:.3f})" for name, each in metrics.items())
    return f"{pair.world:<20}  SR {pair.difference_percent:+.1f} % (p {pair.p:.3f})  {numbers}"


def _text(row: dict[str, Any]) -> str:
    numbers = "  ".join(
        f"{name} {row[name]:.3f}" if row[name] is not None else f"{name} -" for name in ("FR", "MS", "AL")
    )
    flown = f"{row['world']:<20}  {row['method']:<12}  {row['trials']:5d} trials"
    return f"{flown}  SR {row['SR']:5.1f} %  {numbers}"
