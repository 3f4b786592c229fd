"""Firing directions of the Mid-360 as a two-dimensional Fourier series, for any slot."""

import math

import numpy as np

from companion.compiled import compiled
from companion.messages import FloatArray

LINES = 4
FIRING_PERIOD_NS = 20_000
"""The four emitters fire together; their results follow each other in the stream."""


@compiled("void(int64, float64, float64, int64, int64, float64[:, :, ::1], float64[:, ::1])")
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

    The vector to line c is sum_j coefficients[c, j] * basis[j]. The basis is 1, then the cosine and sine
    of k * rotor + l * nod for k = 0, l = 1..nod_order, then for k = 1..rotor_order,
    l = -nod_order..nod_order.
    """
    basis = np.empty((2 * rotor_order + 1) * (2 * nod_order + 1))
    nod = np.empty((nod_order + 1, 2))
    nod[0, 0], nod[0, 1] = 1.0, 0.0
    basis[0] = 1.0
    last_firing = -1
    for i in range(directions_lidar.shape[0]):
        firing = (first_slot + i) // LINES
        line = (first_slot + i) % LINES
        if firing != last_firing:
            last_firing = firing
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
        x, y, z = 0.0, 0.0, 0.0
        for j in range(basis.shape[0]):
            x += coefficients[line, j, 0] * basis[j]
            y += coefficients[line, j, 1] * basis[j]
            z += coefficients[line, j, 2] * basis[j]
        scale = 1.0 / math.sqrt(x * x + y * y + z * z)
        directions_lidar[i, 0] = x * scale
        directions_lidar[i, 1] = y * scale
        directions_lidar[i, 2] = z * scale
