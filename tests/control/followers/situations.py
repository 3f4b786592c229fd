"""What a follower may meet: by hand, and at random."""

import numpy as np

from companion.control.followers.laws_kernels import steer
from companion.control.followers.layout_kernels import (
    AZIMUTHS,
    EGO_ALONE,
    EGO_DT,
    EGO_HEIGHT,
    EGO_P,
    EGO_SIZE,
    EGO_V,
    EGO_YAW,
    ELEVATIONS,
    MEMORY_SIZE,
    METHOD_IDS,
    NEIGHBOUR_SIZE,
)
from companion.control.followers.settings import FollowerSettings
from companion.messages import FloatArray

STEP_S = 0.05
ROWS = 6
LOWEST, HIGHEST = np.radians([-7.0, 52.0])
ELEVATION_EDGES = np.linspace(LOWEST, HIGHEST, ELEVATIONS + 1)
ELEVATION_CENTRES = 0.5 * (ELEVATION_EDGES[1:] + ELEVATION_EDGES[:-1])
AZIMUTH_CENTRES = (np.arange(AZIMUTHS) + 0.5) * 2.0 * np.pi / AZIMUTHS


def own(
    p: tuple[float, float, float] = (0.0, 0.0, 1.5),
    v: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    dt: float = STEP_S,
    alone: float = 0.0,
) -> FloatArray:
    """Return the own state (10,); velocity in the heading frame."""
    ego = np.zeros(EGO_SIZE)
    ego[EGO_P : EGO_P + 3] = p
    ego[EGO_V : EGO_V + 3] = v
    ego[EGO_YAW], ego[EGO_HEIGHT], ego[EGO_DT], ego[EGO_ALONE] = yaw, p[2], dt, alone
    return ego


def others(*states: tuple[float, ...]) -> FloatArray:
    """Return the rows (6, 8) of neighbours, each (x, y, z) or (x, y, z, vx, vy, vz), relative."""
    rows = np.zeros((ROWS, NEIGHBOUR_SIZE))
    for number, state in enumerate(states):
        rows[number, : len(state)] = state
        rows[number, 6:] = 1.0, 10.0 + number
    return rows


def free() -> FloatArray:
    """Return the ranges (72, 12) of an open field."""
    return np.full((AZIMUTHS, ELEVATIONS), np.inf)


def column(ranges: FloatArray, azimuth_deg: float, distance: float, rows: slice = slice(0, 5)) -> FloatArray:
    """Put something upright at a horizontal distance into the cells at one azimuth."""
    index = int(np.floor(azimuth_deg % 360.0 / 5.0))
    ranges[index, rows] = distance / np.cos(ELEVATION_CENTRES[rows])
    return ranges


def drawn(rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Draw an own state, neighbours and obstacles."""
    ego = own(
        p=(*rng.uniform(-20.0, 20.0, 2), rng.uniform(0.5, 3.5)),
        v=tuple(rng.uniform(-1.5, 1.5, 3)),
        yaw=rng.uniform(-np.pi, np.pi),
        dt=rng.choice([0.02, 0.05, 0.1]),
        alone=rng.choice([0.0, 5.0]),
    )
    states = []
    for _ in range(rng.integers(0, ROWS + 1)):
        angle, distance = rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 9.0)
        states.append(
            (
                distance * np.cos(angle),
                distance * np.sin(angle),
                rng.uniform(-0.5, 0.5),
                *rng.uniform(-2, 2, 3),
            )
        )
    states.sort(key=lambda state: float(np.linalg.norm(state[:3])))
    ranges = free()
    for _ in range(rng.integers(0, 12)):
        index, wide = rng.integers(0, AZIMUTHS), rng.integers(1, 8)
        low, high = sorted(rng.integers(0, ELEVATIONS, 2))
        for offset in range(wide):
            ranges[(index + offset) % AZIMUTHS, low : high + 1] = rng.uniform(0.4, 9.0)
    return ego, others(*states), ranges


class Follower:
    """One vehicle's law with its memory."""

    def __init__(self, method: str, settings: FollowerSettings | None = None) -> None:
        self.method = METHOD_IDS[method]
        self.settings = settings or FollowerSettings()
        self.parameters = self.settings.packed(method)
        self.memory = np.zeros(MEMORY_SIZE)

    def steer(self, ego: FloatArray, neighbours: FloatArray, ranges: FloatArray | None = None) -> FloatArray:
        """Return the command (3,) in the heading frame."""
        command = np.full(3, np.nan)
        cells = free() if ranges is None else ranges
        steer(self.method, ego, neighbours, cells, self.memory, self.parameters, command)
        return command

    def settle(self, ego: FloatArray, neighbours: FloatArray, ranges: FloatArray | None = None) -> FloatArray:
        """Return the command after two seconds in which nothing changes: no limit of acceleration is left."""
        for _ in range(40):
            command = self.steer(ego, neighbours, ranges)
        return command
