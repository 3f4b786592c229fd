"""Hot loop of dead reckoning between two poses that somebody else has stated.

A motion is 15 numbers: p_map 0-2, R_map_imu 3-11 by rows, v_map 12-14.
"""

import numpy as np

from companion.compiled import compiled
from companion.messages import FloatArray
from companion.perception.odometry.kernels import rotate_by


@compiled("void(float64[::1], float64[::1], float64[:,::1], float64, float64[:,::1])")
def dead_reckon(
    motion: FloatArray, t_s: FloatArray, inertial: FloatArray, gravity: float, segments: FloatArray
) -> None:
    """Move a motion, in place, through consecutive intervals of constant rate and specific force.

    Args:
        motion: (15,).
        t_s: (n,) limits of the intervals, seconds, ascending.
        inertial: (n - 1, 6) gyro rad/s and specific force m/s^2 of each interval, free of bias.
        gravity: m/s^2, pulling along -z of the map.
        segments: (>= n, 22) receives time, p, R, v at each limit and the acceleration and rate of the
            interval that begins there; the last row repeats those of the last interval.
    """
    R_middle = np.zeros(9)
    last = t_s.shape[0] - 1
    for k in range(t_s.shape[0]):
        segment = segments[k]
        segment[0] = t_s[k]
        segment[1:16] = motion
        if k == last:
            segment[16:22] = segments[k - 1, 16:22] if k > 0 else np.zeros(6)
            break
        dt = t_s[k + 1] - t_s[k]
        wx, wy, wz = inertial[k, 0], inertial[k, 1], inertial[k, 2]
        R_middle[:] = motion[3:12]
        rotate_by(R_middle, 0.5 * wx * dt, 0.5 * wy * dt, 0.5 * wz * dt)
        for i in range(3):
            acceleration = -gravity if i == 2 else 0.0
            for j in range(3):
                acceleration += R_middle[3 * i + j] * inertial[k, 3 + j]
            segment[16 + i] = acceleration
            motion[i] += (motion[12 + i] + 0.5 * acceleration * dt) * dt
            motion[12 + i] += acceleration * dt
        segment[19], segment[20], segment[21] = wx, wy, wz
        rotate_by(motion[3:12], wx * dt, wy * dt, wz * dt)
