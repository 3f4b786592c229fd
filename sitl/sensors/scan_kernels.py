"""Firing directions of the Mid-360 as a two-dimensional Fourier series, for any slot."""

import math

import numpy as np

from companion.compiled import compiled
from companion.messages import FloatArray

LINES = 4
FIRING_PERIOD_NS = 20_000
"""The four emitters fire together; their results follow each other in the stream."""


@compiled("void(int64, float64, float64, int64, int64, float64[:, ::1], float64[:, ::1])")
def evaluate_directions(
    first_slot: int,
    rotor_hz: float,
    nod_hz: float,
    rotor_order: int,
    nod_order: int,
    coefficients: FloatArray,
    directions_lidar: FloatArray,
) -> None:
    """Write the unit directions (n, 3) in which slots `first_slot` onwards look, lidar frame.

    The vector to line c is sum_j coefficients[j, 3 * c : 3 * c + 3] * basis[j]. The basis is 1, then the
    cosine and sine of k * rotor + l * nod for k = 0, l = 1..nod_order, then for k = 1..rotor_order,
    l = -nod_order..nod_order.
    """
    basis = np.empty((2 * rotor_order + 1) * (2 * nod_order + 1))
    nod = np.empty((nod_order + 1, 2))
    nod[0, 0], nod[0, 1] = 1.0, 0.0
    basis[0] = 1.0
    sums = np.empty(LINES * 3)
    first_firing, last_firing = first_slot // LINES, (first_slot + directions_lidar.shape[0] - 1) // LINES
    for firing in range(first_firing, last_firing + 1):
        t = firing * (FIRING_PERIOD_NS * 1e-9)
        # Phases are reduced to one turn first, so that a long uptime costs no precision.
        rotor_phase = 2.0 * math.pi * ((rotor_hz * t) % 1.0)
        nod_phase = 2.0 * math.pi * ((nod_hz * t) % 1.0)
        rotor_cos, rotor_sin = math.cos(rotor_phase), math.sin(rotor_phase)
        nod_cos, nod_sin = math.cos(nod_phase), math.sin(nod_phase)
        j = 1
        for m in range(1, nod_order + 1):
            nod[m, 0] = nod[m - 1, 0] * nod_cos - nod[m - 1, 1] * nod_sin
            nod[m, 1] = nod[m - 1, 1] * nod_cos + nod[m - 1, 0] * nod_sin
            basis[j], basis[j + 1] = nod[m, 0], nod[m, 1]
            j += 2
        turn_cos, turn_sin = 1.0, 0.0
        for _ in range(rotor_order):
            turn_cos, turn_sin = (
                turn_cos * rotor_cos - turn_sin * rotor_sin,
                turn_sin * rotor_cos + turn_cos * rotor_sin,
            )
            for m in range(-nod_order, nod_order + 1):
                other_cos = nod[abs(m), 0]
                other_sin = nod[abs(m), 1] if m >= 0 else -nod[abs(m), 1]
                basis[j] = turn_cos * other_cos - turn_sin * other_sin
                basis[j + 1] = turn_sin * other_cos + turn_cos * other_sin
                j += 2
        # All lines at once: twelve sums do not wait for each other as the terms of one do.
        ax, ay, az, bx, by, bz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        cx, cy, cz, dx, dy, dz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(basis.shape[0]):
            term = basis[j]
            ax, ay, az = (
                ax + coefficients[j, 0] * term, ay + coefficients[j, 1] * term, az + coefficients[j, 2] * term
            )  # fmt: skip
            bx, by, bz = (
                bx + coefficients[j, 3] * term, by + coefficients[j, 4] * term, bz + coefficients[j, 5] * term
            )  # fmt: skip
            cx, cy, cz = (
                cx + coefficients[j, 6] * term, cy + coefficients[j, 7] * term, cz + coefficients[j, 8] * term
            )  # fmt: skip
            dx, dy, dz = (
                dx + coefficients[j, 9] * term,
                dy + coefficients[j, 10] * term,
                dz + coefficients[j, 11] * term,
            )  # fmt: skip
        sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = ax, ay, az, bx, by, bz
        sums[6], sums[7], sums[8], sums[9], sums[10], sums[11] = cx, cy, cz, dx, dy, dz
        for line in range(LINES):
            i = firing * LINES + line - first_slot
            if i >= 0 and i < directions_lidar.shape[0]:
                x, y, z = sums[3 * line], sums[3 * line + 1], sums[3 * line + 2]
                scale = 1.0 / math.sqrt(x * x + y * y + z * z)
                directions_lidar[i, 0] = x * scale
                directions_lidar[i, 1] = y * scale
                directions_lidar[i, 2] = z * scale
