"""Kernels of the potential field: nearest obstacle per direction, and the force at a point."""

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.messages import FloatArray

_LEAST_ROOM_M = 0.05
_SAME_POINT_M = 1e-6


@compiled(
    "void(uint8[:,::1], float32[:,:,::1], int64[::1], float64, float64, float64, float64, float64[:,::1])"
)
def find_nearest(
    blocked: NDArray[np.uint8],
    surface: NDArray[np.float32],
    first: NDArray[np.int64],
    cell: float,
    x: float,
    y: float,
    reach: float,
    sectors: FloatArray,
) -> None:
    """Find the nearest obstacle in each direction.

    Args:
        blocked: (n, n) columns of the map in window order.
        surface: (n, n, 2) wrapped offsets of the returns from the columns' centres, m.
        first: (3,) lowest voxel of the window.
        cell: cell size, m.
        x: where to look from, m.
        y: likewise.
        reach: obstacles farther than this are passed over, m.
        sectors: (k, 3) result: unit direction from (x, y) to the obstacle and its distance, inf if none.
            Sector i covers the angles from i to i + 1 times 2 pi / k.
    """
    n = blocked.shape[0]
    count = sectors.shape[0]
    for sector in range(count):
        sectors[sector, 0] = 0.0
        sectors[sector, 1] = 0.0
        sectors[sector, 2] = math.inf
    span = int(reach / cell) + 2
    centre_i = math.floor(x / cell) - first[0]
    centre_j = math.floor(y / cell) - first[1]
    for i in range(max(centre_i - span, 0), min(centre_i + span + 1, n)):
        for j in range(max(centre_j - span, 0), min(centre_j + span + 1, n)):
            if not blocked[i, j]:
                continue
            ii = (i + first[0]) & (n - 1)
            jj = (j + first[1]) & (n - 1)
            dx = (i + first[0] + 0.5) * cell + surface[ii, jj, 0] - x
            dy = (j + first[1] + 0.5) * cell + surface[ii, jj, 1] - y
            gap = math.sqrt(dx * dx + dy * dy)
            if gap > reach or gap < _SAME_POINT_M:
                continue
            sector = int((math.atan2(dy, dx) / (2.0 * math.pi) % 1.0) * count) % count
            if gap < sectors[sector, 2]:
                sectors[sector, 0] = dx / gap
                sectors[sector, 1] = dy / gap
                sectors[sector, 2] = gap


@compiled("UniTuple(float64, 2)(float64[:,::1], float64, float64, float64, float64)")
def repulsion(
    sectors: FloatArray, vehicle_radius: float, gain: float, distance: float, limit: float
) -> tuple[float, float]:
    """Sum of the sectors' repulsions, gain (1/rho - 1/rho_0) / rho^2 each, cut at `limit`.

    The room rho_0 beyond which a sector does not repel is `distance`, or half of what lies between it and
    the opposite sector if that is less: two walls then push towards the middle, and not against each other
    with forces so steep that a slow vehicle swings between them.

    Args:
        sectors: (k, 3) unit direction to the nearest obstacle and its distance, m.
        vehicle_radius: taken off the distance to give the room rho, m.
        gain: strength, m^3.
        distance: room beyond which nothing repels, m.
        limit: greatest force of a sector.

    Returns:
        The force along x and y of the map.

    Source: O. Khatib, "Real-time obstacle avoidance for manipulators and mobile robots", 1986, eq. 18.
    """
    count = sectors.shape[0]
    force_x = 0.0
    force_y = 0.0
    for sector in range(count):
        room = max(sectors[sector, 2] - vehicle_radius, _LEAST_ROOM_M)
        opposite = max(sectors[(sector + count // 2) % count, 2] - vehicle_radius, _LEAST_ROOM_M)
        reach = min(distance, 0.5 * (room + opposite))
        if room < reach:
            strength = min(gain * (1.0 / room - 1.0 / reach) / (room * room), limit)
            force_x -= strength * sectors[sector, 0]
            force_y -= strength * sectors[sector, 1]
    total = math.sqrt(force_x * force_x + force_y * force_y)
    if total > limit:
        force_x *= limit / total
        force_y *= limit / total
    return force_x, force_y
