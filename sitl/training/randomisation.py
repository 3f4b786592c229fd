"""How far trials of training differ from each other, beyond their scenes."""

import math
from typing import Annotated

import numpy as np
from numpy.random import Generator
from pydantic import Strict, model_validator

from companion.messages import FloatArray
from companion.settings import Settings
from companion.yaml_problems import misfit
from sitl.abstract import grid_kernels
from sitl.abstract import layout_kernels as place
from sitl.abstract.settings import CONTROL_STEP_S
from sitl.dynamics_kernels import DRAG, HORIZONTAL_GAIN, VERTICAL_GAIN

Range = Annotated[tuple[float, float], Strict(False)]

HISTORY_ROWS = 12
"""Control steps that the environment remembers; no delay is longer."""

_SIGMAS = (
    place.POSITION_SIGMA,
    place.POSITION_SIGMA_FAR,
    place.VELOCITY_SIGMA,
    place.VELOCITY_SIGMA_FAR,
)
_DELAYS = (place.GRID_DELAY, place.NEIGHBOUR_DELAY, place.EGO_DELAY)


class RandomisationSettings(Settings):
    """What is drawn anew for every swarm and trial, uniformly between two bounds; defaults change nothing."""

    obstacle_delay_s: Range = (0.0, 0.0)
    """Added to the age of the obstacle grid."""
    neighbour_delay_s: Range = (0.0, 0.0)
    """Added to the age of neighbours' states."""
    sigma_factor: Range = (1.0, 1.0)
    """All errors of neighbours are multiplied with it."""
    ego_velocity_sigma_mps: Range = (0.0, 0.0)
    """Standard deviation that is added to each component of the own velocity: errors of odometry."""
    dropout: Range = (0.0, 0.0)
    """Added to the share of scans in which a visible neighbour is missed."""
    range_factor: Range = (1.0, 1.0)
    """The range of sight is multiplied with it."""
    tilt_deg: Range = (0.0, 0.0)
    """By this the field of view is tilted up or down: both its edges are moved."""
    lag_factor: Range = (1.0, 1.0)
    """Time constants of lagging vehicles are multiplied with it."""
    command_delay_s: Range = (0.0, 0.0)
    """Added to the time until a command takes effect."""
    gain_factor: Range = (1.0, 1.0)
    """The velocity gains of quadrotors are multiplied with it."""
    drag_factor: Range = (1.0, 1.0)
    """Their drag is multiplied with it."""
    wind_mps: Range = (0.0, 0.0)
    """Speed of a steady wind from a random direction; lagging vehicles do not feel it."""
    gust_mps: Range = (0.0, 0.0)
    """Standard deviation of horizontal gusts; a third of it vertically."""

    @model_validator(mode="after")
    def _bounds_are_ordered(self) -> "RandomisationSettings":
        for name, (low, high) in self:
            if low > high:
                raise misfit((name,), f"{low:g} to {high:g}", "two rising numbers")
            if name != "tilt_deg" and low < 0.0:
                raise misfit((name,), f"{low:g}", "nothing below 0")
        if self.obstacle_delay_s[1] + self.neighbour_delay_s[1] > 0.4:
            raise misfit(("neighbour_delay_s",), "delays over 0.4 s together", "at most 0.4 s")
        return self

    def vary(self, rng: Generator, parameters: FloatArray, quadrotor: FloatArray, limits: FloatArray) -> None:
        """Draw one trial's conditions; always takes equally many numbers from the generator.

        Args:
            rng: where chance comes from.
            parameters: of the abstract swarm, changed in place; see `sitl.abstract.layout_kernels`.
            quadrotor: of its dynamics, likewise.
            limits: of its grid, likewise.
        """
        drawn = {name: float(rng.uniform(*bounds)) for name, bounds in self}
        heading = float(rng.uniform(-math.pi, math.pi))
        parameters[place.GRID_DELAY] += _steps(drawn["obstacle_delay_s"])
        parameters[place.NEIGHBOUR_DELAY] += _steps(drawn["neighbour_delay_s"])
        for delay in _DELAYS:
            parameters[delay] = min(parameters[delay], HISTORY_ROWS - 2)
        for sigma in _SIGMAS:
            parameters[sigma] *= drawn["sigma_factor"]
        parameters[place.EGO_VELOCITY_SIGMA] += drawn["ego_velocity_sigma_mps"]
        room = max(0.95 - parameters[place.DROPOUT_FAR], 0.0)
        parameters[place.DROPOUT] = min(parameters[place.DROPOUT] + drawn["dropout"], room)
        parameters[place.SIGHT_RANGE] *= drawn["range_factor"]
        tilt = math.radians(drawn["tilt_deg"])
        for edge, low in ((place.SIGHT_LOWEST, True), (place.SIGHT_HIGHEST, False)):
            parameters[edge] = math.sin(math.asin(parameters[edge]) + tilt)
            limits[grid_kernels.SIGHT_LOWEST if low else grid_kernels.SIGHT_HIGHEST] = parameters[edge]
        parameters[place.LAG_LEAST] *= drawn["lag_factor"]
        parameters[place.LAG_GREATEST] *= drawn["lag_factor"]
        substep_s = CONTROL_STEP_S / parameters[place.SUBSTEPS]
        parameters[place.COMMAND_DELAY] += round(drawn["command_delay_s"] / substep_s)
        quadrotor[HORIZONTAL_GAIN] *= drawn["gain_factor"]
        quadrotor[VERTICAL_GAIN] *= drawn["gain_factor"]
        quadrotor[DRAG] *= drawn["drag_factor"]
        parameters[place.WIND_X] += drawn["wind_mps"] * math.cos(heading)
        parameters[place.WIND_Y] += drawn["wind_mps"] * math.sin(heading)
        parameters[place.GUST] += drawn["gust_mps"]
        parameters[place.VERTICAL_GUST] += drawn["gust_mps"] / 3.0


WIDE = RandomisationSettings(
    obstacle_delay_s=(0.0, 0.05),
    neighbour_delay_s=(0.0, 0.1),
    sigma_factor=(0.5, 2.0),
    ego_velocity_sigma_mps=(0.0, 0.05),
    dropout=(0.0, 0.1),
    range_factor=(0.8, 1.0),
    tilt_deg=(-2.0, 2.0),
    lag_factor=(0.8, 1.3),
    command_delay_s=(0.0, 0.05),
    gain_factor=(0.85, 1.15),
    drag_factor=(0.7, 1.5),
    wind_mps=(0.0, 1.5),
    gust_mps=(0.0, 0.5),
)
"""What a follower must cope with outdoors, round what was measured of our tracker and odometry."""


def _steps(duration_s: float) -> int:
    return int(np.floor(duration_s / CONTROL_STEP_S + 0.5))
