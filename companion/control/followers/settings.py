"""Which law a follower flies by, and the gains of each; which learned model has its say."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from companion.control.followers.baseline_settings import (
    LloydSettings,
    PacnavSettings,
    ReynoldsApfSettings,
    VpfPolarSettings,
    VpfSettings,
)
from companion.control.followers.flock_settings import FlockSettings
from companion.control.followers.layout_kernels import LAW_PARAMETERS, METHOD_IDS, PARAMETER_COUNT
from companion.messages import FloatArray
from companion.settings import Settings

Controller = Literal["law", "policy"]
Method = Literal["flock", "pacnav", "vpf", "vpf_polar", "reynolds_apf", "lloyd"]
METHODS: dict[str, type[Settings]] = {
    "flock": FlockSettings,
    "pacnav": PacnavSettings,
    "vpf": VpfSettings,
    "vpf_polar": VpfPolarSettings,
    "reynolds_apf": ReynoldsApfSettings,
    "lloyd": LloydSettings,
}
"""The settings of each law."""
SHIPPED_MODEL = "shipped"
"""Stands for the model that comes with the companion."""


class CommandSettings(Settings):
    """What holds for the velocity of every law."""

    max_speed_mps: float = Field(default=2.0, gt=0.0, le=8.0)
    """Largest speed that is asked for."""
    max_vertical_speed_mps: float = Field(default=1.0, gt=0.0, le=3.0)
    """Largest climb or descent that is asked for."""
    max_acceleration_mps2: float = Field(default=4.0, gt=0.0, le=10.0)
    """Largest change of the velocity per second."""
    height_per_s: float = Field(default=1.0, ge=0.0, le=5.0)
    """Vertical speed for each metre that the neighbours are higher on average (all laws but `flock`)."""
    height_speed_mps: float = Field(default=0.5, ge=0.0, le=3.0)
    """Limit of that vertical speed."""
    recovery_height_m: float = Field(default=1.0, ge=0.0, le=50.0)
    """Over the start; where a follower goes that sees nobody."""


class FollowerSettings(Settings):
    """How a follower flies."""

    controller: Controller = "law"
    """Whose velocity is flown: `law`, or `policy`: a learned model's, beside which the law flies along and
    takes over in the same tick when the model is late or gives no sound velocity."""
    model: str = Field(default=SHIPPED_MODEL, min_length=1, max_length=4096)
    """For `controller: policy`: `shipped`, or an ONNX file; a relative path begins at the profile."""
    model_sha256: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")
    """Hash that the model's file must have; if not given, that of the file that is there at the start."""
    method: Method = "flock"
    """The law."""
    command: CommandSettings = CommandSettings()
    """What holds for every law's velocity."""
    flock: FlockSettings = FlockSettings()
    """Gains of `flock`."""
    pacnav: PacnavSettings = PacnavSettings()
    """Gains of `pacnav`."""
    vpf: VpfSettings = VpfSettings()
    """Gains of `vpf`."""
    vpf_polar: VpfPolarSettings = VpfPolarSettings()
    """Gains of `vpf_polar`."""
    reynolds_apf: ReynoldsApfSettings = ReynoldsApfSettings()
    """Gains of `reynolds_apf`."""
    lloyd: LloydSettings = LloydSettings()
    """Gains of `lloyd`."""

    def located(self, folder: Path) -> "FollowerSettings":
        """Return the same with a model's relative path made one that begins at a folder."""
        if self.model == SHIPPED_MODEL or Path(self.model).is_absolute():
            return self
        return self.model_copy(update={"model": str((folder / self.model).resolve())})

    def law_sha256(self) -> str:
        """Return the hash of the law with its gains: a model that flies beside it knows it by that."""
        gains = getattr(self, self.method).model_dump(mode="json")
        text = json.dumps({"law": self.method, "gains": gains}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def packed(self, method: str | None = None) -> FloatArray:
        """Return the parameters (PARAMETER_COUNT,) that `steer` wants for a law.

        Args:
            method: the law; the configured one if None.

        Raises:
            KeyError: if there is no such law.
        """
        name = self.method if method is None else method
        if name not in METHOD_IDS:
            raise KeyError(f"no law {name!r}, there are {', '.join(METHOD_IDS)}")
        parameters = np.zeros(PARAMETER_COUNT)
        command = [float(value) for _, value in self.command]
        gains = [float(value) for _, value in getattr(self, name)]
        parameters[: len(command)] = command
        parameters[LAW_PARAMETERS : LAW_PARAMETERS + len(gains)] = gains
        return parameters


@dataclass(frozen=True, slots=True)
class Gain:
    """One gain of a law, as a tuner sees it.

    Attributes:
        name: key in the law's section.
        default: its value without configuration.
        low: smallest value allowed.
        high: greatest value allowed.
    """

    name: str
    default: float
    low: float
    high: float


def gains_of(method: str) -> tuple[Gain, ...]:
    """Return all gains of a law with their bounds, in the order of its parameters.

    Raises:
        KeyError: if there is no such law.
    """
    gains = []
    for name, field in METHODS[method].model_fields.items():
        bounds = {"low": -np.inf, "high": np.inf}
        for limit in field.metadata:
            for key, bound in (("ge", "low"), ("gt", "low"), ("le", "high"), ("lt", "high")):
                if (value := getattr(limit, key, None)) is not None:
                    bounds[bound] = float(value)
        gains.append(Gain(name, float(field.default), bounds["low"], bounds["high"]))
    return tuple(gains)


def with_gains(settings: FollowerSettings, method: str, gains: Mapping[str, float]) -> FollowerSettings:
    """Return settings that fly a law with some of its gains changed, checked as those of a file are.

    Raises:
        pydantic.ValidationError: if a gain is unknown or out of bounds.
    """
    section = {**getattr(settings, method).model_dump(), **gains}
    return FollowerSettings.model_validate({**settings.model_dump(), "method": method, method: section})
