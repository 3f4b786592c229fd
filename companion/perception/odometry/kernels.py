"""Hot loops of inertial propagation and de-skewing: arrays in, arrays out.

A state is 24 numbers: p_map 0-2, R_map_imu 3-11 by rows, v_map 12-14, gyro bias 15-17, accelerometer
bias 18-20, g_map 21-23. Its error has 18: p, theta (right perturbation), v, gyro bias, accelerometer
bias, gravity, in this order.
"""

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import FloatArray, PointArray

SEGMENT_WIDTH = 22  # time, p, R by rows, v, a_map, omega_imu


@inlined
def rotate_by(R: FloatArray, x: float, y: float, z: float) -> None:
    """Multiply R (9,) from the right by Exp((x, y, z)), in place."""
    square = x * x + y * y + z * z
    if square < 1e-8:
        s, c = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        angle = np.sqrt(square)
        s, c = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
    e00, e01, e02 = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    e10, e11, e12 = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    e20, e21, e22 = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)
    for row in range(0, 9, 3):
        a, b, d = R[row], R[row + 1], R[row + 2]
        R[row] = a * e00 + b * e10 + d * e20
        R[row + 1] = a * e01 + b * e11 + d * e21
        R[row + 2] = a * e02 + b * e12 + d * e22


@compiled("void(float64[::1], float64[:,::1], float64[::1], float64[:,::1], float64[:,::1], float64[:,::1])")
def propagate(
    state: FloatArray,
    covariance: FloatArray,
    t_s: FloatArray,
    inertial: FloatArray,
    noise: FloatArray,
    segments: FloatArray,
) -> None:
    """Integrate a state and its covariance, in place, through consecutive intervals.

    Rate and specific force are constant in each interval; the force is turned by the attitude at the
    interval's middle.

    Args:
        state: (24,).
        covariance: (18, 18).
        t_s: (n,) limits of the intervals, seconds, ascending.
        inertial: (n - 1, 6) gyro rad/s and specific force m/s^2 of each interval.
        noise: (n - 1, 4) variances per interval: rate and acceleration densities (already spectral,
            multiplied by dt here), gyro and accelerometer bias walks.
        segments: (>= n, 22) receives time, p, R, v at each limit and the acceleration and rate of the
            interval that begins there; the last row repeats those of the last interval.
    """
    F = np.zeros((18, 18))
    FP = np.zeros((18, 18))
    R_middle = np.zeros(9)
    step = np.zeros(9)
    a = np.zeros(3)
    for k in range(t_s.shape[0]):
        segment = segments[k]
        segment[0] = t_s[k]
        segment[1:4] = state[0:3]
        segment[4:13] = state[3:12]
        segment[13:16] = state[12:15]
        if k + 1 == t_s.shape[0]:
            segment[16:22] = segments[k - 1, 16:22] if k > 0 else np.zeros(6)
            break
        dt = t_s[k + 1] - t_s[k]
        wx = inertial[k, 0] - state[15]
        wy = inertial[k, 1] - state[16]
        wz = inertial[k, 2] - state[17]
        for i in range(3):
            a[i] = inertial[k, 3 + i] - state[18 + i]
        R_middle[:] = state[3:12]
        rotate_by(R_middle, 0.5 * wx * dt, 0.5 * wy * dt, 0.5 * wz * dt)
        step[:] = 0.0
        step[0], step[4], step[8] = 1.0, 1.0, 1.0
        rotate_by(step, -wx * dt, -wy * dt, -wz * dt)

        F[:, :] = 0.0
        for i in range(18):
            F[i, i] = 1.0
        for i in range(3):
            r0, r1, r2 = R_middle[3 * i], R_middle[3 * i + 1], R_middle[3 * i + 2]
            # dv/dtheta = -R [a]x dt
            t0, t1, t2 = -(r1 * a[2] - r2 * a[1]), -(r2 * a[0] - r0 * a[2]), -(r0 * a[1] - r1 * a[0])
            F[i, 3], F[i, 4], F[i, 5] = 0.5 * dt * dt * t0, 0.5 * dt * dt * t1, 0.5 * dt * dt * t2
            F[6 + i, 3], F[6 + i, 4], F[6 + i, 5] = dt * t0, dt * t1, dt * t2
            for j in range(3):
                F[3 + i, 3 + j] = step[3 * i + j]
                F[i, 12 + j] = -0.5 * dt * dt * R_middle[3 * i + j]
                F[6 + i, 12 + j] = -dt * R_middle[3 * i + j]
            F[i, 6 + i] = dt
            F[i, 15 + i] = 0.5 * dt * dt
            F[6 + i, 15 + i] = dt
            F[3 + i, 9 + i] = -dt

        for i in range(18):
            for j in range(18):
                total = 0.0
                for m in range(18):
                    if F[i, m] != 0.0:
                        total += F[i, m] * covariance[m, j]
                FP[i, j] = total
        for i in range(18):
            for j in range(i + 1):
                total = 0.0
                for m in range(18):
                    if F[j, m] != 0.0:
                        total += FP[i, m] * F[j, m]
                covariance[i, j] = total
                covariance[j, i] = total
        for i in range(3):
            covariance[i, i] += noise[k, 1] * dt * dt * dt / 3.0
            covariance[i, 6 + i] += noise[k, 1] * dt * dt / 2.0
            covariance[6 + i, i] += noise[k, 1] * dt * dt / 2.0
            covariance[3 + i, 3 + i] += noise[k, 0] * dt
            covariance[6 + i, 6 + i] += noise[k, 1] * dt
            covariance[9 + i, 9 + i] += noise[k, 2] * dt
            covariance[12 + i, 12 + i] += noise[k, 3] * dt

        for i in range(3):
            acceleration = state[21 + i]
            for j in range(3):
                acceleration += R_middle[3 * i + j] * a[j]
            segment[16 + i] = acceleration
            state[i] += (state[12 + i] + 0.5 * acceleration * dt) * dt
            state[12 + i] += acceleration * dt
        segment[19], segment[20], segment[21] = wx, wy, wz
        rotate_by(state[3:12], wx * dt, wy * dt, wz * dt)


@compiled("void(float32[:,::1], int32[::1], float64[:,::1], int64, float64[::1], float64[:,::1])")
def deskew(
    points_lidar: PointArray,
    offsets_ns: NDArray[np.int32],
    segments: FloatArray,
    count: int,
    T_imu_lidar: FloatArray,
    points_imu: FloatArray,
) -> None:
    """Move points measured along the way into the IMU frame at the end of the way.

    Source: W. Xu, F. Zhang, "FAST-LIO", 2021, equation 10 (backward propagation), here with each
    interval's motion evaluated in closed form from its start.

    Args:
        points_lidar: (n, 3) metres.
        offsets_ns: (n,) time of each point after time 0 of `segments`.
        segments: (>= count, 22) as `propagate` wrote them, times in seconds.
        count: how many of them are valid; the last is the end.
        T_imu_lidar: (12,) rotation by rows, then translation.
        points_imu: (n, 3) receives the result.
    """
    end = segments[count - 1]
    k = count - 2
    for i in range(points_lidar.shape[0] - 1, -1, -1):
        t = offsets_ns[i] * 1e-9
        while k > 0 and segments[k, 0] > t:
            k -= 1
        while k < count - 2 and segments[k + 1, 0] <= t:
            k += 1
        s = segments[k]
        dt = t - s[0]
        lx, ly, lz = (
            np.float64(points_lidar[i, 0]),
            np.float64(points_lidar[i, 1]),
            np.float64(points_lidar[i, 2]),
        )
        x = T_imu_lidar[0] * lx + T_imu_lidar[1] * ly + T_imu_lidar[2] * lz + T_imu_lidar[9]
        y = T_imu_lidar[3] * lx + T_imu_lidar[4] * ly + T_imu_lidar[5] * lz + T_imu_lidar[10]
        z = T_imu_lidar[6] * lx + T_imu_lidar[7] * ly + T_imu_lidar[8] * lz + T_imu_lidar[11]
        # Exp(omega dt) to third order: a segment lasts milliseconds.
        rx, ry, rz = s[19] * dt, s[20] * dt, s[21] * dt
        ax, ay, az = ry * z - rz * y, rz * x - rx * z, rx * y - ry * x
        bx, by, bz = ry * az - rz * ay, rz * ax - rx * az, rx * ay - ry * ax
        x += ax + 0.5 * bx + (ry * bz - rz * by) / 6.0
        y += ay + 0.5 * by + (rz * bx - rx * bz) / 6.0
        z += az + 0.5 * bz + (rx * by - ry * bx) / 6.0
        mx = s[4] * x + s[5] * y + s[6] * z + s[1] + (s[13] + 0.5 * s[16] * dt) * dt - end[1]
        my = s[7] * x + s[8] * y + s[9] * z + s[2] + (s[14] + 0.5 * s[17] * dt) * dt - end[2]
        mz = s[10] * x + s[11] * y + s[12] * z + s[3] + (s[15] + 0.5 * s[18] * dt) * dt - end[3]
        points_imu[i, 0] = end[4] * mx + end[7] * my + end[10] * mz
        points_imu[i, 1] = end[5] * mx + end[8] * my + end[11] * mz
        points_imu[i, 2] = end[6] * mx + end[9] * my + end[12] * mz


@compiled("int64(float64[:,::1], float64, int64[::1], int64[::1], int64[::1])")
def thin(
    points: FloatArray,
    cell_m: float,
    keys: NDArray[np.int64],
    stamps: NDArray[np.int64],
    chosen: NDArray[np.int64],
) -> int:
    """Choose the first point of every cell of a grid.

    Args:
        points: (n, 3) metres.
        cell_m: edge of a cell.
        keys: (m,) scratch, m a power of two above n.
        stamps: (m + 1,) scratch; a slot is taken where its stamp equals this call's, which is the
            last entry, counted up by each call.
        chosen: (>= n,) receives the indices of the chosen points, ascending.

    Returns:
        The number of chosen points.
    """
    mask = keys.shape[0] - 1
    stamp = stamps[keys.shape[0]] + 1
    stamps[keys.shape[0]] = stamp
    inverse = 1.0 / cell_m
    count = 0
    for i in range(points.shape[0]):
        ix = np.int64(np.floor(points[i, 0] * inverse)) + 1048576
        iy = np.int64(np.floor(points[i, 1] * inverse)) + 1048576
        iz = np.int64(np.floor(points[i, 2] * inverse)) + 1048576
        key = (ix << 42) | (iy << 21) | iz
        slot = ((key * -7046029254386353131) >> 40) & mask
        while stamps[slot] == stamp and keys[slot] != key:
            slot = (slot + 1) & mask
        if stamps[slot] != stamp:
            stamps[slot] = stamp
            keys[slot] = key
            chosen[count] = i
            count += 1
    return count
