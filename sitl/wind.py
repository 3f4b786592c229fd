"""Wind for simulated vehicles: a steady part and gusts."""

import numpy as np
from numpy.random import Generator
from pydantic import Field

from companion.messages import FloatArray
from companion.settings import Settings
from sitl.worlds.primitives import Vector


class WindSettings(Settings):
    """Weather of a scenario."""

    mean_world_mps: Vector = (0.0, 0.0, 0.0)
    """Steady velocity of the air."""
    gust_mps: float = Field(default=0.0, ge=0.0, le=15.0)
    """Standard deviation of each horizontal gust component."""
    vertical_gust_mps: float = Field(default=0.0, ge=0.0, le=15.0)
    """Standard deviation of the vertical gusts."""
    gust_time_s: float = Field(default=2.0, gt=0.0, le=60.0)
    """Correlation time of the horizontal gusts."""
    vertical_gust_time_s: float = Field(default=0.7, gt=0.0, le=60.0)
    """Correlation time of the vertical gusts."""


GENTLE_GUSTS = WindSettings(gust_mps=0.3, vertical_gust_mps=0.1)
"""What full fidelity flies in unless told otherwise."""


class Wind:
    """Velocity of the air at n vehicles, each in gusts of its own.

    Each gust component is a first-order Gauss-Markov process, the longitudinal form of Dryden's
    turbulence with the passage through the turbulence replaced by a correlation time.
    Source: MIL-F-8785C, section 3.7, equations for the longitudinal spectrum.
    """

    def __init__(self, rng: Generator, vehicles: int, settings: WindSettings) -> None:
        """Start with gusts in their stationary distribution."""
        self._rng = rng
        self._mean_world = np.array(settings.mean_world_mps)
        self._sigma = np.array([settings.gust_mps, settings.gust_mps, settings.vertical_gust_mps])
        self._time_s = np.array([settings.gust_time_s, settings.gust_time_s, settings.vertical_gust_time_s])
        self._gusts_world = self._sigma * rng.standard_normal((vehicles, 3))
        self._step_s = 0.0
        self._kept = self._fresh = self._sigma

    def step(self, step_s: float) -> FloatArray:
        """Return the wind (n, 3) in m/s of the next `step_s` seconds."""
        if step_s != self._step_s:
            self._step_s = step_s
            self._kept = np.exp(-step_s / self._time_s)
            self._fresh = self._sigma * np.sqrt(1.0 - self._kept**2)
        deviates = self._rng.standard_normal(self._gusts_world.shape)
        self._gusts_world = self._kept * self._gusts_world + self._fresh * deviates
        wind: FloatArray = self._mean_world + self._gusts_world
        return wind
