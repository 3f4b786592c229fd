"""What a model was trained on, what it achieves and where it fails: a page from what is stored."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.control.policy import Policy
from companion.errors import LogError
from sitl.campaign.cases import FAILURES, CaseSummary, compare_methods, summarise
from sitl.campaign.conditions import labels_of
from sitl.campaign.definition import LEARNED, CampaignDefinition
from sitl.campaign.differences import metric_difference
from sitl.campaign.report import tables_of
from sitl.campaign.runner import stored_trials
from sitl.campaign.tables_labels import method_title, world_title
from sitl.campaign.tables_rendering import Row, Table, markdown
from sitl.swarm.record import TrialRecord
from sitl.training.curve import MAX_BYTES

_CURVE_ROWS = 12
_CURVE = {
    "update": "Update",
    "samples": "Samples",
    "wall_s": "Time (s)",
    "error_mps": "From the teacher (m/s)",
    "reward": "Reward",
    "episode_SR": "SR in training (%)",
    "evaluation_score": "Score",
}
_INTRODUCTION = (
    "# The learned follower\n\n"
    "`follower.onnx` flies a follower from what it perceives alone: own motion, neighbours, obstacles. "
    "It never flies by itself: the law beside it runs in every tick, and takes over in the same tick when "
    "the model is late or gives no sound velocity. `sitl card` writes this page from stored results.\n"
)


@dataclass(frozen=True, slots=True)
class Results:
    """What was flown of one campaign.

    Attributes:
        definition: the campaign's file.
        records: its trials.
    """

    definition: CampaignDefinition
    records: Sequence[TrialRecord]

    @classmethod
    def stored(cls, definition: CampaignDefinition, folder: Path) -> "Results":
        """Read them from a campaign's folder.

        Raises:
            LogError: if nothing of the campaign is there, or it cannot be read.
        """
        try:
            records = stored_trials(folder, definition)
        except FileNotFoundError:
            records = []
        if not records:
            raise LogError(f"{folder}: nothing of the campaign {definition.title!r} has been flown")
        return cls(definition, records)


def card(model: Policy, results: Sequence[Results], training: Path | None = None) -> str:
    """Return the page as Markdown.

    Args:
        model: the model.
        results: campaigns in which it has flown.
        training: folder of its training, with configuration and curve.

    Raises:
        LogError: if the training's files cannot be read.
    """
    parts = [_INTRODUCTION, markdown(_model_table(model)), _evaluation_text(model.metadata.evaluation)]
    if training is not None:
        parts.append(_training_text(training))
    cases = [case for result in results for case in summarise(result.records)]
    learned = [case for result in results for case in _learned_cases(result)]
    if learned:
        parts.append(markdown(_failing_table(learned)))
    compared = _against_laws(results)
    if compared is not None:
        parts.append(markdown(compared))
    for result in results:
        parts.append(f"# {result.definition.title}\n")
        parts.extend(markdown(table) for table in tables_of(result.records, result.definition))
    if not cases:
        parts.append("No campaign has been flown with it yet.\n")
    return "\n".join(part for part in parts if part)


def _model_table(model: Policy) -> Table:
    said = model.metadata
    inputs = "; ".join(
        f"{name} ({', '.join(map(str, ('batch', *shape)))})" for name, shape in model.contract.inputs.items()
    )
    rows = {
        "File": f"sha256 {model.sha256}",
        "Contract": said.contract,
        "Inputs": inputs,
        "Output": "velocity (batch, 3) in the heading frame, m/s, before limits",
        "Limits": ", ".join(f"{name} {value:g}" for name, value in said.limits.items()),
        "Law beside it": f"{model.contract.law}, gains {said.teacher}" if model.contract.law else "any",
        "Training configuration": f"sha256 {said.configuration_sha256}",
        "Sources": said.commit or "unknown",
        "ONNX operators": f"opset {said.opset}",
    }
    return Table("model", "Model", ("What",), ("Value",), tuple(Row(row) for row in rows.items()))


def _evaluation_text(evaluation: Any) -> str:
    """Return the table that the model itself carries; its scenes are for training, not the held-out ones."""
    if not isinstance(evaluation, list) or not evaluation:
        return ""
    names = ("world", "method", "followers", "trials", "SR", "FR", "MS", "AL")
    rows = tuple(Row(tuple(_plain(row.get(name)) for name in names)) for row in evaluation)
    note = "Scenes between training and test: from seeds for training that no training flies."
    return markdown(Table("evaluation", "At export", names[:3], names[3:], rows, (note,)))


def _training_text(folder: Path) -> str:
    configuration = folder / "configuration.yaml"
    try:
        text = configuration.read_text(encoding="utf-8")
    except OSError as error:
        raise LogError(f"{configuration}: cannot be read: {error.strerror}") from None
    return (
        "## Trained on\n\nThe whole configuration, with everything that its file leaves to defaults:\n\n"
        f"```yaml\n{text}```\n\n{markdown(_curve_table(folder / 'curve.csv'))}"
    )


def _curve_table(path: Path) -> Table:
    rows = _curve_rows(path)
    wanted = {name: title for name, title in _CURVE.items() if any(row.get(name) for row in rows)}
    # Rows with an evaluation say most; where there is one at the end alone, evenly spread ones.
    judged = [row for row in rows if row.get("evaluation_score")]
    judged = judged if len(judged) > 1 else rows
    count = min(_CURVE_ROWS, len(judged))
    chosen = [judged[round(k * (len(judged) - 1) / max(count - 1, 1))] for k in range(count)]
    lines = tuple(Row(tuple(row.get(name) or "-" for name in wanted)) for row in chosen)
    titles = tuple(wanted.values())
    return Table("curve", "How it learned", titles[:1], titles[1:], lines)


def _curve_rows(path: Path) -> list[dict[str, str]]:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise LogError(f"{path}: larger than any learning curve ({MAX_BYTES} bytes)")
        with path.open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from None


def _learned_cases(result: Results) -> list[CaseSummary]:
    labels = _method_labels(result)
    return [case for case in summarise(result.records) if labels.get(case.method) == LEARNED]


def _method_labels(result: Results) -> dict[str, str]:
    """Return the method behind every label in the results."""
    return {
        label: entry.method_name
        for entry in result.definition.method_entries
        for label, _, _ in labels_of(result.definition, entry)
    }


def _failing_table(cases: Sequence[CaseSummary]) -> Table:
    """Return where the model fails most, worst first."""
    worst = sorted((case for case in cases if case.successes < case.trials), key=lambda case: case.SR)
    names = [end for end in FAILURES if any(case.failures[end] for case in worst)]
    rows = tuple(
        Row(
            (
                world_title(case.world),
                method_title(case.method),
                str(case.followers),
                str(case.trials),
                f"{case.SR:.1f}",
                *(str(case.failures[end]) for end in names),
            )
        )
        for case in worst
    )
    heads = ("World", "Method", "Followers"), ("Trials", "SR (%)", *names)
    notes = () if rows else ("It has not failed in any trial of the campaigns below.",)
    return Table("failures", "Where it fails", *heads, rows, notes)


def _against_laws(results: Sequence[Results]) -> Table | None:
    """Return the model beside every law on the same scenes: success, and means of what both flew."""
    rows = []
    for result in results:
        labels = _method_labels(result)
        learned = [name for name, method in labels.items() if method == LEARNED]
        laws = [name for name, method in labels.items() if method == "flock"]
        for case in summarise(result.records):
            if case.method not in learned:
                continue
            for law in laws:
                rows += _versus(result.records, case, law)
    if not rows:
        return None
    return Table(
        "versus",
        "Against flock",
        ("World", "Methods", "Followers"),
        ("Scenes", "SR (%)", "flock", "p", "FR (m)", "p", "MS (m)", "p", "AL", "p"),
        tuple(rows),
        (
            "Differences of FR, MS and AL are means over common scenes, the model minus the law; p is "
            "McNemar's for SR and the paired t test's for the others.",
        ),
    )


def _versus(records: Sequence[TrialRecord], case: CaseSummary, law: str) -> list[Row]:
    pair = compare_methods(
        records, case.method, law, world=case.world, followers=case.followers, fidelity=case.fidelity
    )
    if not pair.pairs:
        return []
    cells = [
        world_title(case.world),
        f"{method_title(case.method)} / {method_title(law)}",
        str(case.followers),
        str(pair.pairs),
        f"{100.0 * (pair.both + pair.only_first) / pair.pairs:.1f}",
        f"{100.0 * (pair.both + pair.only_second) / pair.pairs:.1f}",
        _p(pair.p),
    ]
    for metric in ("FR", "MS", "AL"):
        other = (case.world, law, case.followers, case.fidelity)
        apart = metric_difference(records, case.key, other, metric)
        cells += [f"{apart.mean:+.3f}", _p(apart.p)]
    return [Row(tuple(cells))]


def _p(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def _plain(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def evaluation_rows(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows of `Evaluated.rows` with as much as a model carries."""
    names = ("world", "method", "followers", "trials", "SR", "SR_ci95", "MP", "FR", "MS", "AL", "MDO")
    return [{name: row[name] for name in names} for row in rows]
