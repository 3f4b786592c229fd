"""What the abstract swarm assumes of perception and flight."""

import math
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from companion.messages import FloatArray
from companion.perception.neighbours import NeighbourSettings
from companion.perception.occupancy import GridSettings
from companion.settings import Settings
from sitl.abstract import layout_kernels as place
from sitl.dynamics import STEP_S, QuadrotorSettings
from sitl.swarm.settings import TerminationSettings
from sitl.wind import WindSettings

CONTROL_STEP_S = 0.05
HISTORY = 32
_LONGEST_DELAY_S = 1.0
_CULL_MARGIN_M = 1.0

Preset = Literal["paper", "measured"]


class PerceptionSettings(Settings):
    """What a follower perceives of the others and of obstacles, and when; defaults as in the paper."""

    scan_period_s: float = Field(default=0.1, ge=CONTROL_STEP_S, le=1.0)
    """Neighbours and obstacles are new once in this time and held meanwhile."""
    obstacle_delay_s: float = Field(default=0.1, ge=0.0, le=_LONGEST_DELAY_S)
    """Age of the obstacle grid when it arrives."""
    neighbour_delay_s: float = Field(default=0.2, ge=0.0, le=_LONGEST_DELAY_S)
    """Age of a neighbour's state when it arrives."""
    ego_delay_s: float = Field(default=0.1, ge=0.0, le=_LONGEST_DELAY_S)
    """Age of the own motion, where neighbours are not predicted to now; otherwise it is that of now."""
    position_sigma_m: float = Field(default=0.02, ge=0.0, le=2.0)
    """Standard deviation of each component of a neighbour's position."""
    position_sigma_per_m: float = Field(default=0.0, ge=0.0, le=0.2)
    """What is added to it for each metre of distance, m."""
    position_memory_s: float = Field(default=0.0, ge=0.0, le=60.0)
    """Time after which such an error has faded to 1/e; 0: a new one with every scan."""
    velocity_sigma_mps: float = Field(default=0.05, ge=0.0, le=2.0)
    """Standard deviation of each component of a neighbour's velocity."""
    velocity_sigma_per_m: float = Field(default=0.0, ge=0.0, le=0.2)
    """What is added to it for each metre of distance, m/s."""
    velocity_memory_s: float = Field(default=0.0, ge=0.0, le=60.0)
    """Time after which such an error has faded to 1/e."""
    ego_velocity_sigma_mps: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of each component of the own velocity."""
    range_m: float = Field(default=10.0, gt=0.0, le=100.0)
    """Neighbours farther away are not seen."""
    lowest_elevation_deg: float = Field(default=-7.0, ge=-90.0, le=89.0)
    """Lower edge of the field of view, which tilts with the body."""
    highest_elevation_deg: float = Field(default=52.0, ge=-89.0, le=90.0)
    """Upper edge of it."""
    body_radius_m: float = Field(default=0.15, gt=0.0, le=1.0)
    """Of the ball that a vehicle is to the others' sight."""
    free_rays: int = Field(default=2, ge=1, le=5)
    """Of five rays, to the centre and to four points of the rim, so many must be free to see a vehicle."""
    dropout: float = Field(default=0.0, ge=0.0, lt=1.0)
    """Share of scans in which a visible neighbour is missed."""
    dropout_far: float = Field(default=0.0, ge=0.0, le=1.0)
    """What is added to it at `range_m`; with the square of the distance up to there."""
    sightings: int = Field(default=1, ge=1, le=20)
    """Scans in a row in which a new neighbour must be seen before it is known; those in sight when the trial
    begins are known at once."""
    coast_s: float = Field(default=0.0, ge=0.0, le=5.0)
    """A known neighbour stays known for so long after it was last seen, carried on."""

    @model_validator(mode="after")
    def _field_of_view_is_open(self) -> "PerceptionSettings":
        if self.lowest_elevation_deg >= self.highest_elevation_deg:
            raise ValueError("lowest_elevation_deg must be below highest_elevation_deg")
        if self.dropout + self.dropout_far > 1.0:
            raise ValueError("dropout and dropout_far together must not exceed 1")
        return self


PRESETS: dict[Preset, PerceptionSettings] = {
    "paper": PerceptionSettings(),
    "measured": PerceptionSettings(
        obstacle_delay_s=0.05,
        neighbour_delay_s=0.05,
        ego_delay_s=0.0,
        position_sigma_m=0.004,
        position_sigma_per_m=0.0033,
        position_memory_s=0.18,
        velocity_sigma_mps=0.046,
        velocity_sigma_per_m=0.0081,
        velocity_memory_s=0.19,
        ego_velocity_sigma_mps=0.011,
        dropout=0.0,
        dropout_far=0.21,
        sightings=9,
        coast_s=0.5,
    ),
}
"""The paper's perception, and the one that `sitl bench tracking --fit` finds of our own tracker and
odometry in full fidelity; computing takes part of a control step there and counts as a whole one."""


class LagSettings(Settings):
    """A vehicle whose velocity follows the command with a first-order lag."""

    time_least_s: float = Field(default=0.2, ge=0.02, le=2.0)
    """Each vehicle's time constant is drawn uniformly from here ..."""
    time_greatest_s: float = Field(default=0.4, ge=0.02, le=2.0)
    """... to here."""
    max_acceleration_mps2: float = Field(default=6.0, gt=0.0, le=50.0)
    """Limit of its acceleration."""


class AbstractSettings(Settings):
    """A swarm without packets, odometry or tracker: perception as a model, flight as in full fidelity."""

    perception: PerceptionSettings = PerceptionSettings()
    """What followers perceive."""
    neighbours: NeighbourSettings = NeighbourSettings()
    """How many are passed on, and whether they are predicted to now (`max_age_s` has no meaning here)."""
    grid: GridSettings = GridSettings()
    """The obstacle grid."""
    rays_per_cell: int = Field(default=2, ge=1, le=8)
    """Rays across a cell of the grid each way, for tilted rods and boxes; pillars and balls are exact."""
    dynamics: Literal["quadrotor", "lag"] = "quadrotor"
    """`quadrotor` flies as in full fidelity, `lag` with a first-order lag of the velocity."""
    quadrotor: QuadrotorSettings = QuadrotorSettings()
    """Response of the quadrotor; its command delay holds for both kinds."""
    substep_s: float = Field(default=0.01, ge=STEP_S, le=0.025)
    """Step of the quadrotor's motion; a whole number of them makes a control step."""
    lag: LagSettings = LagSettings()
    """Response of the lagged vehicle."""
    wind: WindSettings = WindSettings()
    """Weather; the lagged vehicle does not feel it."""

    @model_validator(mode="after")
    def _steps_fit(self) -> "AbstractSettings":
        if abs(CONTROL_STEP_S / self.substep_s - self.substeps) > 1e-6:
            raise ValueError(f"substep_s must divide {CONTROL_STEP_S} s evenly")
        if self.grid.azimuths != 72 or self.grid.elevations != 12:
            raise ValueError("followers' laws read a grid of 72 azimuths and 12 elevations")
        return self

    @classmethod
    def of(cls, preset: Preset) -> "AbstractSettings":
        """Return one of the known settings.

        `paper` is the published perception, and a velocity that lags; `measured` is the perception of our
        tracker and odometry in full fidelity, and the response that was measured on PX4.
        """
        return cls(perception=PRESETS[preset], dynamics="lag" if preset == "paper" else "quadrotor")

    @property
    def substeps(self) -> int:
        """Return how many steps of motion make a control step."""
        return round(CONTROL_STEP_S / self.substep_s)

    def packed(self, termination: TerminationSettings, timeout_s: float, cap_m: float) -> FloatArray:
        """Return the numbers in the order of `sitl.abstract.layout_kernels`."""
        seen, wind = self.perception, self.wind
        numbers = {
            place.CONTROL_STEP: CONTROL_STEP_S,
            place.SCAN_STEPS: max(1, _steps(seen.scan_period_s)),
            place.GRID_DELAY: _steps(seen.obstacle_delay_s),
            place.NEIGHBOUR_DELAY: _steps(seen.neighbour_delay_s),
            place.EGO_DELAY: _steps(seen.ego_delay_s),
            place.COMPENSATE: float(self.neighbours.compensate_latency),
            place.NEIGHBOUR_COUNT: self.neighbours.count,
            place.SIGHT_RANGE: seen.range_m,
            place.SIGHT_LOWEST: math.sin(math.radians(seen.lowest_elevation_deg)),
            place.SIGHT_HIGHEST: math.sin(math.radians(seen.highest_elevation_deg)),
            place.FREE_RAYS: seen.free_rays,
            place.BODY_RADIUS: seen.body_radius_m,
            place.DROPOUT: seen.dropout,
            place.DROPOUT_FAR: seen.dropout_far,
            place.SIGHTINGS: seen.sightings,
            place.COAST: seen.coast_s,
            place.POSITION_SIGMA: seen.position_sigma_m,
            place.POSITION_SIGMA_FAR: seen.position_sigma_per_m,
            place.POSITION_MEMORY: seen.position_memory_s,
            place.VELOCITY_MEMORY: seen.velocity_memory_s,
            place.VELOCITY_SIGMA: seen.velocity_sigma_mps,
            place.VELOCITY_SIGMA_FAR: seen.velocity_sigma_per_m,
            place.EGO_VELOCITY_SIGMA: seen.ego_velocity_sigma_mps,
            place.GROUND: self.quadrotor.ground_height_m,
            place.CULL_RANGE: max(seen.range_m, self.grid.max_range_m, cap_m) + _CULL_MARGIN_M,
            place.QUADROTOR: float(self.dynamics == "quadrotor"),
            place.SUBSTEPS: self.substeps,
            place.COMMAND_DELAY: max(1, round(self.quadrotor.command_delay_s / self.substep_s)),
            place.LAG_LEAST: self.lag.time_least_s,
            place.LAG_GREATEST: self.lag.time_greatest_s,
            place.LAG_ACCELERATION: self.lag.max_acceleration_mps2,
            place.WIND_X: wind.mean_world_mps[0],
            place.WIND_Y: wind.mean_world_mps[1],
            place.WIND_Z: wind.mean_world_mps[2],
            place.GUST: wind.gust_mps,
            place.VERTICAL_GUST: wind.vertical_gust_mps,
            place.GUST_TIME: wind.gust_time_s,
            place.VERTICAL_GUST_TIME: wind.vertical_gust_time_s,
            place.VEHICLE_RADIUS: termination.vehicle_radius_m,
            place.LOWEST_ALTITUDE: termination.altitude_m[0],
            place.HIGHEST_ALTITUDE: termination.altitude_m[1],
            place.LEADER_UNSEEN: termination.leader_unseen_s,
            place.GOAL_TOLERANCE: termination.goal_tolerance_m,
            place.GATHERED: termination.gathered_m,
            place.TIMEOUT: timeout_s,
            place.CAP: cap_m,
        }
        return np.array([numbers[index] for index in range(place.N_PARAMETERS)], np.float64)

    def packed_quadrotor(self) -> FloatArray:
        """Return the quadrotor's numbers for the substep."""
        numbers = self.quadrotor.packed().copy()
        numbers[0] = self.substep_s
        return numbers

    def packed_grid(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return what `grid_kernels.draw_grid` wants: limits, rays by azimuth and elevation, edges."""
        low, high = (
            math.radians(self.grid.lowest_elevation_deg),
            math.radians(self.grid.highest_elevation_deg),
        )
        seen = self.perception
        limits = np.array(
            [
                self.grid.min_range_m,
                self.grid.max_range_m,
                self.quadrotor.ground_height_m + self.grid.min_height_m,
                low,
                high,
                math.sin(math.radians(seen.lowest_elevation_deg)),
                math.sin(math.radians(seen.highest_elevation_deg)),
            ]
        )
        columns, rows = self.grid.azimuths, self.grid.elevations
        azimuths = (np.arange(columns * self.rays_per_cell) + 0.5) * (
            2.0 * np.pi / (columns * self.rays_per_cell)
        )
        elevations = low + (np.arange(rows * self.rays_per_cell) + 0.5) * (
            (high - low) / (rows * self.rays_per_cell)
        )
        column_edges = np.arange(columns + 1) * (2.0 * np.pi / columns)
        row_edges = low + np.arange(rows + 1) * ((high - low) / rows)
        return (
            limits,
            np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1),
            np.stack([np.cos(elevations), np.sin(elevations)], axis=1),
            np.stack([np.cos(column_edges), np.sin(column_edges)], axis=1),
            np.stack([row_edges, np.cos(row_edges), np.sin(row_edges)], axis=1),
        )


def _steps(duration_s: float) -> int:
    return round(duration_s / CONTROL_STEP_S)
