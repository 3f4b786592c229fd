"""From a trained network to the file that flies, checked against the network on flights of its own."""

import subprocess
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch

from companion.control.observation import CONTRACTS, OUTPUT, Contract, Observation
from companion.control.policy import Policy, read_policy
from companion.control.policy_metadata import PRESENT_COLUMN, PolicyMetadata
from companion.errors import ModelError
from companion.messages import Float32Array
from sitl.abstract.policy_flight import PolicyStep
from sitl.abstract.trial import AbstractTrial
from sitl.training.evaluation import CASES, EvaluationCase, TorchPolicy
from sitl.training.settings import TrainingSettings, configuration_sha256
from sitl.worlds.seeds import training_seed

OPSET = 18
TOLERANCE_MPS = 1e-5
"""How far the file's velocities may be from the network's."""
OBSERVATIONS = 1000
"""On so many observations at least."""

_FIRST_SCENE = 800_000_000
_QUANTILES = (0.001, 0.999)
_KEPT = 8
"""Of every so many steps, one is kept."""


@dataclass(frozen=True, slots=True)
class Exported:
    """What became of an export.

    Attributes:
        path: of the model.
        sha256: of the file.
        difference_mps: largest difference of a velocity between file and network.
        observations: on how many observations.
        size: of the file, bytes.
    """

    path: Path
    sha256: str
    difference_mps: float
    observations: int
    size: int


def export(
    module: torch.nn.Module,
    settings: TrainingSettings,
    path: Path,
    *,
    evaluation: Any = (),
    commit: str | None = None,
    cases: Sequence[EvaluationCase] = CASES,
) -> Exported:
    """Write a network as a model that the companion loads, and prove that both say the same.

    Args:
        module: maps named observations to velocities (batch, 3), with every scaling inside.
        settings: of its training.
        path: of the model; a file of that name is replaced.
        evaluation: what it achieved, as JSON knows it.
        commit: of the sources that trained it; asked of Git by default.
        cases: in which flights observations are taken.

    Raises:
        ModelError: if the model says anything else than the network.
    """
    contract = CONTRACTS[settings.contract]
    follower = settings.environment.follower
    seen = record_observations(module.eval(), settings, cases)
    low, high = usual_ranges(seen, contract)
    metadata = PolicyMetadata(
        contract=contract.name,
        limits={name: float(value) for name, value in follower.command},
        configuration_sha256=configuration_sha256(settings),
        commit=source_commit() if commit is None else commit,
        evaluation=evaluation,
        teacher=follower.law_sha256() if contract.law is not None else "",
        observation_low=low,
        observation_high=high,
        opset=OPSET,
    )
    unfinished = path.with_name(f".{path.name}.new")
    unfinished.write_bytes(model_bytes(module, contract, metadata))
    try:
        model = read_policy(unfinished)
        difference = largest_difference(module, model, seen)
        if not difference <= TOLERANCE_MPS:
            raise ModelError(
                f"{path}: its velocities differ from the network's by {difference:.2e} m/s, "
                f"allowed are {TOLERANCE_MPS:.0e}"
            )
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return Exported(path, model.sha256, difference, len(seen.ego), path.stat().st_size)


def model_bytes(module: torch.nn.Module, contract: Contract, metadata: PolicyMetadata) -> bytes:
    """Return the ONNX file of a network; equal networks give equal bytes."""
    inputs = {name: torch.zeros(2, *shape) for name, shape in contract.inputs.items()}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(), torch.no_grad():
        # The exporter that needs no further package; it says on every call that there is a newer one.
        warnings.simplefilter("ignore")
        file = str(Path(folder) / "model.onnx")
        torch.onnx.export(
            module,
            tuple(inputs.values()),
            file,
            dynamo=False,
            input_names=list(inputs),
            output_names=[OUTPUT],
            dynamic_axes={name: {0: "batch"} for name in (*inputs, OUTPUT)},
            opset_version=metadata.opset,
        )
        model = onnx.load_model(file)
    model.doc_string = ""
    onnx.helper.set_model_props(model, metadata.table())
    onnx.checker.check_model(model, full_check=True)
    data: bytes = model.SerializeToString(deterministic=True)
    return data


def record_observations(
    module: torch.nn.Module, settings: TrainingSettings, cases: Sequence[EvaluationCase] = CASES
) -> Observation:
    """Return what followers see while a policy flies them, one flight a case, at least `OBSERVATIONS`."""
    contract = CONTRACTS[settings.contract]
    policy = TorchPolicy(module, contract)
    kept: dict[str, list[Float32Array]] = {name: [] for name in contract.inputs}
    count, scene = 0, _FIRST_SCENE
    while count < OBSERVATIONS:
        for case in cases:
            trial = _trial(case, settings, training_seed(scene))
            scene += 1
            step = PolicyStep(contract, [trial])
            number = 0
            while not trial.is_over:
                step.begin()
                if number % _KEPT == 0:
                    for name, array in step.observation.inputs.items():
                        kept[name].append(array.copy())
                    count += trial.followers
                step.finish(policy.velocities(step.observation))
                number += 1
    seen = Observation(contract, count)
    for name, arrays in kept.items():
        seen.inputs[name][:] = np.concatenate(arrays)
    return seen


def usual_ranges(
    seen: Observation, contract: Contract
) -> tuple[dict[str, Float32Array], dict[str, Float32Array]]:
    """Return lower and upper bounds of what each feature usually is; of neighbours that are present."""
    rows = seen.neighbours.reshape(-1, contract.neighbours[1])
    rows = rows[rows[:, PRESENT_COLUMN] > 0.5]
    if not len(rows):
        rows = np.zeros((1, contract.neighbours[1]), np.float32)
    tables = {"ego": seen.ego, "neighbours": rows}
    low, high = (
        {name: np.quantile(table, share, axis=0).astype(np.float32) for name, table in tables.items()}
        for share in _QUANTILES
    )
    return low, high


def largest_difference(module: torch.nn.Module, model: Policy, seen: Observation) -> float:
    """Return the largest difference of any velocity between a network and a model, m/s."""
    theirs = TorchPolicy(module, seen.contract).velocities(seen)
    return float(np.abs(theirs - model.velocities(seen)).max())


def source_commit() -> str:
    """Return the commit of the sources, with a mark if they have changed since; empty if nobody knows."""
    folder = Path(__file__).parent
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40"],
            cwd=folder, capture_output=True, text=True, timeout=10.0, check=True,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return ""
    return found.stdout.strip()


def _trial(case: EvaluationCase, settings: TrainingSettings, seed: int) -> AbstractTrial:
    follower = settings.environment.follower
    abstract = settings.environment.abstract(case.perception)
    return AbstractTrial(case.scene(seed), follower.method, follower, abstract)
