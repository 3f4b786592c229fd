"""Checkpoints: one file holds networks, optimisation and random numbers, or a policy alone.

The state of the swarms, tens of megabytes, lies in a file of its own beside it. With that file a training
goes on exactly as it would have; without it, it goes on with trials that begin anew.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from companion.errors import LogError
from sitl.training.environment_results import State
from sitl.training.settings import TrainingSettings, configuration_sha256, configuration_text, read_training

LAST = "last.pt"
SWARMS = "swarms.pt"
BEST = "best.pt"
MAX_BYTES = 1 << 30
_VERSION = 1


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What a checkpoint holds.

    Attributes:
        settings: of the training.
        update: how many updates have been made.
        samples: seen so far, over all streams.
        wall_s: that the training took so far.
        best_score: of the evaluations so far, None before the first.
        algorithm: see `ShardedPpo.save`; of the actor alone in a file that cannot be resumed.
        evaluation: of this very policy, empty if it was not evaluated.
    """

    settings: TrainingSettings
    update: int
    samples: int
    wall_s: float
    best_score: float | None
    algorithm: dict[str, Any]
    evaluation: dict[str, float]

    @property
    def resumable(self) -> bool:
        """Whether training can go on from here."""
        return "optimizer_state_dict" in self.algorithm

    def policy_only(self) -> "Checkpoint":
        """Return the same without what only training needs."""
        actor = {"actor_state_dict": self.algorithm["actor_state_dict"]}
        return Checkpoint(
            self.settings,
            self.update,
            self.samples,
            self.wall_s,
            self.best_score,
            actor,
            self.evaluation,
        )


def save(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint in one go: whatever happens, an old file is replaced as a whole or not at all."""
    content = {
        "version": _VERSION,
        "configuration": configuration_text(checkpoint.settings),
        "configuration_sha256": configuration_sha256(checkpoint.settings),
        "update": checkpoint.update,
        "samples": checkpoint.samples,
        "wall_s": checkpoint.wall_s,
        "best_score": checkpoint.best_score,
        "algorithm": checkpoint.algorithm,
        "evaluation": dict(checkpoint.evaluation),
    }
    _write(path, content)


def load(path: Path) -> Checkpoint:
    """Read a checkpoint; nothing in it is executed.

    Raises:
        LogError: if the file is no checkpoint of this version.
        FileNotFoundError: if there is none.
    """
    content = _read(path)
    version = content["version"]
    if version != _VERSION:
        raise LogError(f"{path}: a checkpoint of version {version}, this program reads {_VERSION}")
    return Checkpoint(
        settings=read_training(content["configuration"], str(path)),
        update=int(content["update"]),
        samples=int(content["samples"]),
        wall_s=float(content["wall_s"]),
        best_score=content["best_score"],
        algorithm=content["algorithm"],
        evaluation=content["evaluation"],
    )


def save_swarms(path: Path, update: int, state: State) -> None:
    """Write the state of the swarms after an update."""
    _write(path, {"version": _VERSION, "update": update, "state": _as_tensors(state)})


def load_swarms(path: Path, update: int) -> State | None:
    """Read the state of the swarms after an update; None if there is none of this update.

    Raises:
        LogError: if the file is none of ours.
    """
    if not path.exists():
        return None
    content = _read(path)
    if content["version"] != _VERSION or content["update"] != update:
        return None
    state: State = _as_arrays(content["state"])
    return state


def parameters_sha256(*states: Mapping[str, torch.Tensor]) -> str:
    """Return the hash of networks' names, shapes and bytes, whatever the file they come from looks like."""
    digest = hashlib.sha256()
    for state in states:
        for name in sorted(state):
            array = state[name].detach().cpu().contiguous().numpy()
            digest.update(f"{name} {array.dtype} {array.shape}\n".encode())
            digest.update(array.tobytes())
    return digest.hexdigest()


def _write(path: Path, content: dict[str, Any]) -> None:
    unfinished = path.with_name(f".{path.name}.new")
    torch.save(content, unfinished)
    unfinished.replace(path)


def _read(path: Path) -> dict[str, Any]:
    if path.stat().st_size > MAX_BYTES:
        raise LogError(f"{path}: larger than any checkpoint ({MAX_BYTES} bytes)")
    try:
        content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        content["version"], content["update"]
    except OSError:
        raise
    except Exception as error:
        raise LogError(f"{path}: not a checkpoint of a training ({type(error).__name__})") from error
    return content


def _as_tensors(value: Any) -> Any:
    """Return a nest of dictionaries and lists with arrays as tensors, which files may hold."""
    if isinstance(value, np.ndarray):
        # Kinds of integers that tensors lack travel as bytes.
        if value.dtype in (np.uint16, np.uint32, np.uint64):
            return {"__bytes__": value.tobytes(), "dtype": value.dtype.str, "shape": list(value.shape)}
        return torch.from_numpy(np.ascontiguousarray(value).copy())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return {key: _as_tensors(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_as_tensors(entry) for entry in value]
    return value


def _as_arrays(value: Any) -> Any:
    if isinstance(value, torch.Tensor):
        return value.numpy()
    if isinstance(value, Mapping):
        if "__bytes__" in value:
            return np.frombuffer(value["__bytes__"], value["dtype"]).reshape(value["shape"]).copy()
        return {key: _as_arrays(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_as_arrays(entry) for entry in value]
    return value
