"""The normalised innovation of one scan."""

import numpy as np

from companion.compiled import compiled
from companion.messages import FloatArray

RESULT_SIZE = 10
"""Whitened innovation 0-5, moved metres 6, turned radians 7, what the filter does not model: 8 and 9."""

_POSITION_FLOOR_M = 0.002  # what a map of noisy points is off by, beyond what the filter knows
_ROTATION_FLOOR = 3.5e-4  # rad; 0.02 degrees
_SCALE_ERROR = 0.005  # of a chip's axes
_COHERENT = 0.2  # of shaking that adds up over a scan instead of averaging out
_HARD_SHAKING = 1.0  # m/s^2; beyond it rotor tones that fold to low frequencies dominate,
_HARD_TURNING = 0.02  # rad/s, the same,
_FOLDED_FORCE = 1.5  # and this much of what lies beyond adds up,
_FOLDED_RATE = 0.5  # or this much
_MISSING_AFTER = 1.5  # of the usual interval


@compiled("void(float64[::1], float64[::1], float64[:,::1], float64[:,::1], float64[::1])")
def innovate(
    predicted: FloatArray, corrected: FloatArray, covariance: FloatArray, way: FloatArray, result: FloatArray
) -> None:
    """Compare a corrected pose with its prediction.

    With e the difference (position in the map, rotation in the IMU frame) and S the covariance of the
    prediction plus what the filter does not model, the whitened innovation is L^-1 e with S = L L'.

    Args:
        predicted: (>= 12,) p_map, then R_map_imu by rows.
        corrected: (>= 12,) likewise.
        covariance: (>= 6, >= 6) of the prediction's p and theta.
        way: (n, 22) of the propagation since the scan before, as `kernels.propagate` leaves it.
        result: (10,) see `RESULT_SIZE`.
    """
    count = way.shape[0] - 1
    position_m, angle = _POSITION_FLOOR_M, _ROTATION_FLOOR
    if count >= 2:
        passed_s = way[count, 0] - way[0, 0]
        usual_s = np.median(way[1:, 0] - way[:count, 0])
        missing_s = 0.0
        turn = np.zeros(3)
        squares = np.zeros(6)
        for k in range(count):
            interval_s = way[k + 1, 0] - way[k, 0]
            if interval_s > _MISSING_AFTER * usual_s:
                missing_s += interval_s
            for axis in range(3):
                turn[axis] += way[k, 19 + axis] * passed_s / count
            if k > 0:
                for axis in range(6):
                    step = way[k, 16 + axis] - way[k - 1, 16 + axis]
                    squares[axis] += 0.5 * step * step / (count - 1)
        shaking = np.sqrt(max(squares[0], squares[1], squares[2]))
        rate = np.sqrt(max(squares[3], squares[4], squares[5]))
        adding_up = (_COHERENT + missing_s / passed_s) * shaking + _FOLDED_FORCE * max(
            0.0, shaking - _HARD_SHAKING
        )
        position_m += adding_up * passed_s * passed_s
        angle += (_COHERENT * rate + _FOLDED_RATE * max(0.0, rate - _HARD_TURNING)) * passed_s
        angle += _SCALE_ERROR * np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    e = np.zeros(6)
    for axis in range(3):
        e[axis] = corrected[axis] - predicted[axis]
    # D = R_predicted' R_corrected = Exp(theta); its skew part is theta sin(angle) / angle.
    D = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                D[i, j] += predicted[3 + 3 * k + i] * corrected[3 + 3 * k + j]
    e[3], e[4], e[5] = 0.5 * (D[2, 1] - D[1, 2]), 0.5 * (D[0, 2] - D[2, 0]), 0.5 * (D[1, 0] - D[0, 1])
    sine = np.sqrt(e[3] ** 2 + e[4] ** 2 + e[5] ** 2)
    turned = np.arctan2(sine, 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0))
    if sine > 1e-9:
        e[3:6] *= turned / sine
    S = np.zeros((6, 6))
    for i in range(6):
        unmodelled = position_m if i < 3 else angle
        for j in range(i + 1):
            S[i, j] = covariance[i, j] + (unmodelled * unmodelled if i == j else 0.0)
    # Cholesky, and the whitened innovation by forward substitution, in place.
    for i in range(6):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= S[i, k] * S[j, k]
            S[i, j] = np.sqrt(max(total, 1e-18)) if i == j else total / S[j, j]
        total = e[i]
        for k in range(i):
            total -= S[i, k] * result[k]
        result[i] = total / S[i, i]
    result[6] = np.sqrt(e[0] ** 2 + e[1] ** 2 + e[2] ** 2)
    result[7] = turned
    result[8], result[9] = position_m, angle
