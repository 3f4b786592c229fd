"""Perception, motion and rules of one trial, as the kernels read them."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from companion.logs.metrics import DEFAULT_CAP_M
from companion.messages import FloatArray
from sitl.abstract import layout_kernels as place
from sitl.abstract.settings import PRESETS, Preset
from sitl.training import batch_layout_kernels as at
from sitl.training.environment_settings import EnvironmentSettings

_NEVER_S = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """Under which one trial is flown.

    Attributes:
        parameters: (47,) of the abstract swarm and of training, see `batch_layout_kernels`.
        quadrotor: (22,) of the quadrotor.
        limits: (7,) of the grid.
    """

    parameters: FloatArray
    quadrotor: FloatArray
    limits: FloatArray

    def copied(self) -> "Conditions":
        """Return the same numbers in arrays of their own."""
        return Conditions(self.parameters.copy(), self.quadrotor.copy(), self.limits.copy())


class ConditionsSource:
    """Draws the conditions of trials."""

    def __init__(self, settings: EnvironmentSettings) -> None:
        """Work out what does not change."""
        self._settings = settings
        self._known = {preset: _known(settings, preset) for preset in PRESETS}

    def draw(self, preset: Preset, rng: Generator) -> Conditions:
        """Return the conditions of one trial, round one of the known perceptions."""
        conditions = self._known[preset].copied()
        self._settings.randomisation.vary(rng, conditions.parameters, conditions.quadrotor, conditions.limits)
        return conditions


def _known(settings: EnvironmentSettings, preset: Preset) -> Conditions:
    abstract = settings.abstract(preset)
    parameters = np.zeros(at.N_PARAMETERS)
    parameters[: place.N_PARAMETERS] = abstract.packed(settings.swarm.termination, 0.0, DEFAULT_CAP_M)
    parameters[at.STRAYED] = settings.strayed_m if settings.end_on_loss else _NEVER_S
    if not settings.end_on_loss:
        parameters[place.LEADER_UNSEEN] = _NEVER_S
    return Conditions(parameters, abstract.packed_quadrotor(), abstract.packed_grid()[0])
