"""Firing directions of the Mid-360 as a two-dimensional Fourier series, for any slot."""

import math

import numpy as np

from companion.compiled import compiled, portable_inlined
from companion.messages import FloatArray

LINES = 4
FIRING_PERIOD_NS = 20_000
"""The four emitters fire together; their results follow each other in the stream."""

_FIRINGS_AT_ONCE = 256
"""More than a simulation step has; their rows of numbers still fit into the processor's cache."""


@portable_inlined
def _add_scaled(total: FloatArray, factor: float, row: FloatArray) -> None:
    for f in range(total.shape[0]):
        total[f] += factor * row[f]


@portable_inlined
def _add_four_scaled(
    total: FloatArray, factors: FloatArray, c: int, j: int,
    row_0: FloatArray, row_1: FloatArray, row_2: FloatArray, row_3: FloatArray,
) -> None:  # fmt: skip
    """Add four scaled rows, one after the other, to a total that is read and written but once."""
    k_0, k_1, k_2, k_3 = factors[j, c], factors[j + 1, c], factors[j + 2, c], factors[j + 3, c]
    for f in range(total.shape[0]):
        total[f] = (((total[f] + k_0 * row_0[f]) + k_1 * row_1[f]) + k_2 * row_2[f]) + k_3 * row_3[f]


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
    terms = coefficients.shape[0]
    first_firing, last_firing = first_slot // LINES, (first_slot + directions_lidar.shape[0] - 1) // LINES
    # Many firings side by side, since operations on rows of them do not wait for each other.
    block = max(min(last_firing + 1 - first_firing, _FIRINGS_AT_ONCE), 1)
    rotor, nod, turn = np.empty((2, block)), np.empty((nod_order + 2, 2, block)), np.empty((2, block))
    basis, sums = np.empty((terms, block)), np.empty((LINES * 3, block))
    nod[0, 0, :], nod[0, 1, :], basis[0, :] = 1.0, 0.0, 1.0
    for start in range(first_firing, last_firing + 1, block):
        for f in range(block):
            t = (start + f) * (FIRING_PERIOD_NS * 1e-9)
            # Phases are reduced to one turn first, so that a long uptime costs no precision.
            rotor_phase = 2.0 * math.pi * ((rotor_hz * t) % 1.0)
            nod_phase = 2.0 * math.pi * ((nod_hz * t) % 1.0)
            rotor[0, f], rotor[1, f] = math.cos(rotor_phase), math.sin(rotor_phase)
            nod[1, 0, f], nod[1, 1, f] = math.cos(nod_phase), math.sin(nod_phase)
            turn[0, f], turn[1, f] = 1.0, 0.0
        for m in range(2, nod_order + 1):
            for f in range(block):
                before_cos, before_sin, nod_cos, nod_sin = (
                    nod[m - 1, 0, f], nod[m - 1, 1, f], nod[1, 0, f], nod[1, 1, f]
                )  # fmt: skip
                nod[m, 0, f] = before_cos * nod_cos - before_sin * nod_sin
                nod[m, 1, f] = before_sin * nod_cos + before_cos * nod_sin
        j = 1
        for m in range(1, nod_order + 1):
            basis[j, :], basis[j + 1, :] = nod[m, 0], nod[m, 1]
            j += 2
        for _ in range(rotor_order):
            for f in range(block):
                turn[0, f], turn[1, f] = (
                    turn[0, f] * rotor[0, f] - turn[1, f] * rotor[1, f],
                    turn[1, f] * rotor[0, f] + turn[0, f] * rotor[1, f],
                )
            for m in range(-nod_order, nod_order + 1):
                sign = 1.0 if m >= 0 else -1.0
                for f in range(block):
                    other_cos, other_sin = nod[abs(m), 0, f], sign * nod[abs(m), 1, f]
                    basis[j, f] = turn[0, f] * other_cos - turn[1, f] * other_sin
                    basis[j + 1, f] = turn[1, f] * other_cos + turn[0, f] * other_sin
                j += 2
        for c in range(LINES * 3):
            sums[c, :] = 0.0
            by_fours = terms - terms % 4
            for j in range(0, by_fours, 4):
                _add_four_scaled(
                    sums[c], coefficients, c, j, basis[j], basis[j + 1], basis[j + 2], basis[j + 3]
                )
            for j in range(by_fours, terms):
                _add_scaled(sums[c], coefficients[j, c], basis[j])
        for f in range(block):
            for line in range(LINES):
                i = (start + f) * LINES + line - first_slot
                if i >= 0 and i < directions_lidar.shape[0]:
                    x, y, z = sums[3 * line, f], sums[3 * line + 1, f], sums[3 * line + 2, f]
                    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
                    directions_lidar[i, 0] = x * scale
                    directions_lidar[i, 1] = y * scale
                    directions_lidar[i, 2] = z * scale
