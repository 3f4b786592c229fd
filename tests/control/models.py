"""Tiny models, made when they are needed: what a real one does is not the matter here."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper

from companion.control.followers.settings import FollowerSettings
from companion.control.observation import CONTRACTS, OUTPUT
from companion.control.policy_metadata import PolicyMetadata

COMMIT = "c0ffee"
CONFIGURATION_SHA256 = 64 * "a"
WIDE = 1e3


def metadata(
    contract: str = "best-2", settings: FollowerSettings | None = None, width: float = WIDE
) -> PolicyMetadata:
    """Return what belongs to a model for this contract; features within +-`width` are usual."""
    shapes = CONTRACTS[contract].inputs
    bounds = {name: np.full(shapes[name][-1], width, np.float32) for name in ("ego", "neighbours")}
    return PolicyMetadata(
        contract=contract,
        limits={"max_speed_mps": 2.0, "max_vertical_speed_mps": 1.0, "max_acceleration_mps2": 4.0},
        configuration_sha256=CONFIGURATION_SHA256,
        commit=COMMIT,
        evaluation=[{"world": "none", "success_rate": 1.0}],
        teacher=(settings or FollowerSettings()).law_sha256() if contract == "best-2" else "",
        observation_low={name: -values for name, values in bounds.items()},
        observation_high=bounds,
        opset=18,
    )


def save(
    path: Path,
    *,
    contract: str = "best-2",
    settings: FollowerSettings | None = None,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    scale: float = 0.0,
    shapes: Mapping[str, tuple[int, ...]] | None = None,
    entries: Callable[[dict[str, str]], dict[str, str]] = dict,
    output: str = OUTPUT,
    width: float = WIDE,
    batch: str | int = "batch",
) -> Path:
    """Write a model whose velocity is a constant, or for `best-2` the law's plus a constant.

    Args:
        path: of the file.
        contract: of its metadata.
        settings: whose law's hash the metadata name.
        offset: the constant, m/s.
        scale: 1 for the law's velocity plus the constant; `best-2` only.
        shapes: of inputs, where they are not the contract's.
        entries: changes the metadata.
        output: name of the output.
        width: of the usual range of every feature.
        batch: size of the first axis.
    """
    inputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [batch, *shape])
        for name, shape in {**CONTRACTS[contract].inputs, **(shapes or {})}.items()
    ]
    first = 10 if contract == "best-2" else 0
    numbers: dict[str, np.ndarray[Any, np.dtype[Any]]] = {
        "offset": np.array([offset], np.float32),
        "scale": np.array([2.0 * scale], np.float32),
        "begins": np.array([first], np.int64),
        "ends": np.array([first + 3], np.int64),
        "axis": np.array([1], np.int64),
    }
    nodes = [
        helper.make_node("Slice", ["ego", "begins", "ends", "axis"], ["law"]),
        helper.make_node("Mul", ["law", "scale"], ["scaled"]),
        helper.make_node("Add", ["scaled", "offset"], [output]),
    ]
    constants = [onnx.numpy_helper.from_array(values, name) for name, values in numbers.items()]
    result = helper.make_tensor_value_info(output, TensorProto.FLOAT, [batch, 3])
    graph = helper.make_graph(nodes, "follower", inputs, [result], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    helper.set_model_props(model, entries(metadata(contract, settings, width).table()))
    onnx.save(model, str(path))
    return path


def with_entry(key: str, value: Any) -> Callable[[dict[str, str]], dict[str, str]]:
    """Return a change of one entry of the metadata; None removes it."""

    def change(entries: dict[str, str]) -> dict[str, str]:
        rest = {name: text for name, text in entries.items() if name != key}
        if value is None:
            return rest
        return {**rest, key: value if isinstance(value, str) else json.dumps(value)}

    return change
