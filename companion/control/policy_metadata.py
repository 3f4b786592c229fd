"""What a model file says about itself: read before it flies, written when it is exported."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.control.observation import CONTRACTS, Contract
from companion.errors import ModelError
from companion.messages import Float32Array

RANGED = ("ego", "neighbours")
"""Inputs whose usual range a model states; of neighbours it is that of a present one."""
PRESENT_COLUMN = 6
"""Where a row of `neighbours` says whether there is anybody, in every contract."""

_SHA256 = re.compile(r"[0-9a-f]{64}")
_OLDEST_OPSET, _NEWEST_OPSET = 13, 22
_MOST_CHARACTERS = 200_000
_KEYS = (
    "contract",
    "inputs",
    "limits",
    "configuration_sha256",
    "commit",
    "evaluation",
    "teacher",
    "observation_low",
    "observation_high",
    "opset",
)


@dataclass(frozen=True, slots=True, eq=False)
class PolicyMetadata:
    """What belongs to a model.

    Attributes:
        contract: name of what it is shown.
        limits: `max_speed_mps` and the like: the limits of commands that it was trained with.
        configuration_sha256: of the training configuration.
        commit: source code that trained it.
        evaluation: table of what it achieved, as JSON knows it.
        teacher: `FollowerSettings.law_sha256` of the law that must run beside it; empty if any may.
        observation_low: for each of `RANGED`, lower bound of what each feature usually was.
        observation_high: upper bound, likewise.
        opset: of the ONNX operators it uses.
    """

    contract: str
    limits: Mapping[str, float]
    configuration_sha256: str
    commit: str
    evaluation: Any
    teacher: str
    observation_low: Mapping[str, Float32Array]
    observation_high: Mapping[str, Float32Array]
    opset: int

    def table(self) -> dict[str, str]:
        """Return the entries of the model file; `read` gives them back."""
        shapes = {name: list(shape) for name, shape in CONTRACTS[self.contract].inputs.items()}
        bounds = [
            {name: [float(value) for value in table[name]] for name in RANGED}
            for table in (self.observation_low, self.observation_high)
        ]
        return {
            "contract": self.contract,
            "inputs": json.dumps(shapes),
            "limits": json.dumps(dict(self.limits)),
            "configuration_sha256": self.configuration_sha256,
            "commit": self.commit,
            "evaluation": json.dumps(self.evaluation),
            "teacher": self.teacher,
            "observation_low": json.dumps(bounds[0]),
            "observation_high": json.dumps(bounds[1]),
            "opset": str(self.opset),
        }


def read(name: str, entries: Mapping[str, str]) -> PolicyMetadata:
    """Read the entries of a model file.

    Args:
        name: of the file, for errors.
        entries: key and text.

    Raises:
        ModelError: if an entry is missing or wrong; the text names it, what was found and what is wanted.
    """
    missing = [key for key in _KEYS if key not in entries]
    if missing:
        raise ModelError(f"{name}: no metadata {', '.join(missing)}; it was not exported for this companion")
    contract = CONTRACTS.get(entries["contract"])
    if contract is None:
        known = ", ".join(CONTRACTS)
        raise ModelError(f"{name}: contract {_short(entries['contract'])}, this companion knows {known}")
    _compare_inputs(name, _json(name, "inputs", entries), contract)
    limits = _json(name, "limits", entries)
    if not isinstance(limits, dict) or not all(_is_number(value) for value in limits.values()):
        raise ModelError(f"{name}: limits {_short(entries['limits'])}, wanted numbers by name")
    for key in ("configuration_sha256", "teacher"):
        may_be_empty = key == "teacher" and contract.law is None
        if not _SHA256.fullmatch(entries[key]) and not (may_be_empty and not entries[key]):
            raise ModelError(f"{name}: {key} {_short(entries[key])}, wanted 64 hexadecimal digits")
    opset = entries["opset"]
    if not opset.isdecimal() or not _OLDEST_OPSET <= int(opset) <= _NEWEST_OPSET:
        raise ModelError(f"{name}: opset {_short(opset)}, wanted one from {_OLDEST_OPSET} to {_NEWEST_OPSET}")
    low = _bounds(name, "observation_low", entries, contract)
    high = _bounds(name, "observation_high", entries, contract)
    for which in RANGED:
        if np.any(low[which] > high[which]):
            raise ModelError(f"{name}: observation_low of {which} exceeds observation_high")
    return PolicyMetadata(
        contract=contract.name,
        limits={str(key): float(value) for key, value in limits.items()},
        configuration_sha256=entries["configuration_sha256"],
        commit=entries["commit"],
        evaluation=_json(name, "evaluation", entries),
        teacher=entries["teacher"],
        observation_low=low,
        observation_high=high,
        opset=int(opset),
    )


def _compare_inputs(name: str, found: Any, contract: Contract) -> None:
    wanted = {key: list(shape) for key, shape in contract.inputs.items()}
    if found != wanted:
        raise ModelError(
            f"{name}: inputs {_short(json.dumps(found))}, contract {contract.name} has {json.dumps(wanted)}"
        )


def _bounds(name: str, key: str, entries: Mapping[str, str], contract: Contract) -> dict[str, Float32Array]:
    table = _json(name, key, entries)
    bounds = {}
    for which in RANGED:
        width = contract.inputs[which][-1]
        values = table.get(which) if isinstance(table, dict) else None
        if not isinstance(values, list) or len(values) != width or not all(map(_is_number, values)):
            found = f"{len(values)} values" if isinstance(values, list) else "nothing"
            raise ModelError(f"{name}: {key} has {found} for {which}, wanted {width} finite numbers")
        bounds[which] = np.array(values, np.float32)
    return bounds


def _json(name: str, key: str, entries: Mapping[str, str]) -> Any:
    try:
        if len(entries[key]) > _MOST_CHARACTERS:
            raise ValueError
        return json.loads(entries[key])
    except (ValueError, RecursionError):
        raise ModelError(f"{name}: {key} {_short(entries[key])}, wanted JSON") from None


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _short(text: str) -> str:
    return repr(text if len(text) <= 80 else text[:77] + "...")
