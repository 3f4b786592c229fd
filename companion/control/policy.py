"""Learned models: loading with every check that can be made on the ground, and inference on one core."""

from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from companion.control import policy_metadata
from companion.control.followers.settings import FollowerSettings
from companion.control.model_file import model_path, read_model
from companion.control.observation import CONTRACTS, OUTPUT, Contract, Observation
from companion.control.policy_metadata import PRESENT_COLUMN, RANGED, PolicyMetadata
from companion.errors import ModelError
from companion.messages import Float32Array

_FLOAT32 = "tensor(float)"
_WARM_UP_RUNS = 20
_HASH_SHOWN = 12


class Policy:
    """A model that is ready to be asked.

    Attributes:
        path: its file.
        sha256: of the file.
        contract: what it is shown.
        metadata: what it says about itself.
    """

    def __init__(
        self, session: onnxruntime.InferenceSession, path: Path, sha256: str, metadata: PolicyMetadata
    ) -> None:
        """Take a checked model; use `load_policy`."""
        self._session = session
        self.path = path
        self.sha256 = sha256
        self.metadata = metadata
        self.contract: Contract = CONTRACTS[metadata.contract]
        self._low, self._high = {}, {}
        for name in RANGED:
            low, high = metadata.observation_low[name], metadata.observation_high[name]
            # Half as much again on either side: what is a little unusual says nothing.
            room = np.maximum(0.5 * (high - low), 0.05)
            self._low[name], self._high[name] = low - room, high + room

    def __str__(self) -> str:
        """Name and beginning of the hash."""
        return f"{self.path.name} {self.sha256[:_HASH_SHOWN]}"

    def velocities(self, observation: Observation) -> Float32Array:
        """Return the wanted velocities (batch, 3) in the heading frame, m/s, before limits.

        Equal observations give equal bytes; what is in the batch besides may change the last digits.
        """
        velocities: Float32Array = self._session.run([OUTPUT], observation.inputs)[0]
        return velocities

    def unusual(self, observation: Observation, row: int = 0) -> int:
        """Return how many features are far from everything that training showed the model.

        Args:
            observation: of the model's contract.
            row: which follower of the batch.
        """
        ego, rows = observation.ego[row], observation.neighbours[row]
        rows = rows[rows[:, PRESENT_COLUMN] > 0.5]
        count = np.count_nonzero((ego < self._low["ego"]) | (ego > self._high["ego"]))
        count += np.count_nonzero((rows < self._low["neighbours"]) | (rows > self._high["neighbours"]))
        return int(count)

    def warm_up(self) -> None:
        """Run it some times, so that the first time in the air takes no longer than others.

        Raises:
            ModelError: if it cannot be run, or gives what is no velocity.
        """
        observation = Observation(self.contract)
        try:
            for _ in range(_WARM_UP_RUNS):
                velocities = self.velocities(observation)
        except Exception as error:
            raise ModelError(f"{self.path}: cannot be run: {_one_line(error)}") from None
        if velocities.shape != (1, 3) or not np.isfinite(velocities).all():
            raise ModelError(
                f"{self.path}: gives {velocities.tolist()} where nothing is seen, wanted a finite velocity"
            )


def load_policy(settings: FollowerSettings) -> Policy:
    """Load the model that a follower is configured to fly by, and warm it up.

    Raises:
        ModelError: if there is none or it does not fit; the text names file, what was found, what is wanted.
    """
    policy = read_policy(model_path(settings), settings.model_sha256)
    law = policy.contract.law
    if law is not None:
        if settings.method != law:
            raise ModelError(f"{policy.path}: flies beside the law {law}, the profile has {settings.method}")
        gains = settings.law_sha256()
        if policy.metadata.teacher != gains:
            raise ModelError(
                f"{policy.path}: was trained beside {law} with gains of sha256 {policy.metadata.teacher}, "
                f"the profile's have {gains}"
            )
    policy.warm_up()
    return policy


def read_policy(path: Path, sha256: str | None = None) -> Policy:
    """Load a model whatever law flies beside it.

    Args:
        path: its file.
        sha256: what the file must hash to, None for anything.

    Raises:
        ModelError: if there is none, or its hash, contract or shapes are others than wanted.
    """
    data, found = read_model(path)
    if sha256 is not None and found != sha256:
        raise ModelError(f"{path}: sha256 {found}, the profile wants {sha256}")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise ModelError(f"{path}: not a model that can be run: {_one_line(error)}") from None
    entries = session.get_modelmeta().custom_metadata_map
    metadata = policy_metadata.read(str(path), entries)
    _check_ports(path, session, CONTRACTS[metadata.contract])
    return Policy(session, path, found, metadata)


def _check_ports(path: Path, session: onnxruntime.InferenceSession, contract: Contract) -> None:
    inputs = {port.name: port for port in session.get_inputs()}
    if set(inputs) != set(contract.inputs):
        found, wanted = ", ".join(sorted(inputs)), ", ".join(sorted(contract.inputs))
        raise ModelError(f"{path}: inputs {found}, contract {contract.name} has {wanted}")
    for name, shape in contract.inputs.items():
        _check_port(path, f"input {name}", inputs[name], shape)
    outputs = session.get_outputs()
    if [port.name for port in outputs] != [OUTPUT]:
        found = ", ".join(port.name for port in outputs)
        raise ModelError(f"{path}: outputs {found}, wanted {OUTPUT}")
    _check_port(path, f"output {OUTPUT}", outputs[0], (3,))


def _check_port(path: Path, what: str, port: Any, shape: tuple[int, ...]) -> None:
    """Compare type and shape; the batch may be of any size."""
    found = tuple(port.shape)
    if port.type != _FLOAT32 or found[1:] != shape or isinstance(found[0], int):
        axes = ", ".join(str(axis) for axis in ("batch" if isinstance(a, str) else a for a in found))
        wanted = ", ".join(str(axis) for axis in ("batch", *shape))
        raise ModelError(f"{path}: {what} is {port.type} ({axes}), wanted {_FLOAT32} ({wanted})")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:300]
