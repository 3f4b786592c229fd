"""Hot loops of inertial propagation and de-skewing: arrays in, arrays out.

A state is 24 numbers: p_map 0-2, R_map_imu 3-11 by rows, v_map 12-14, gyro bias 15-17, accelerometer
bias 18-20, g_map 21-23. Its error has 18: p, theta (right perturbation), v, gyro bias, accelerometer
bias, gravity, in this order.
"""

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import FloatArray, PointArray

VIBRATION_SAMPLES = 12  # fewer do not tell vibration from motion
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
    A = np.zeros((9, 6))  # derivatives of p, theta, v by theta and accelerometer bias
    R_middle = np.zeros(9)
    step = np.zeros(9)
    a = np.zeros(3)
    rows = np.zeros((9, 18))
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

        half = 0.5 * dt * dt
        for i in range(3):
            r0, r1, r2 = R_middle[3 * i], R_middle[3 * i + 1], R_middle[3 * i + 2]
            # dv/dtheta = -R [a]x dt
            t0, t1, t2 = -(r1 * a[2] - r2 * a[1]), -(r2 * a[0] - r0 * a[2]), -(r0 * a[1] - r1 * a[0])
            A[i, 0], A[i, 1], A[i, 2] = half * t0, half * t1, half * t2
            A[6 + i, 0], A[6 + i, 1], A[6 + i, 2] = dt * t0, dt * t1, dt * t2
            for j in range(3):
                A[3 + i, j] = step[3 * i + j]
                A[i, 3 + j] = -half * R_middle[3 * i + j]
                A[6 + i, 3 + j] = -dt * R_middle[3 * i + j]

        # Rows of F P: biases and gravity stay as they are.
        for j in range(18):
            t0, t1, t2 = covariance[3, j], covariance[4, j], covariance[5, j]
            b0, b1, b2 = covariance[12, j], covariance[13, j], covariance[14, j]
            for i in range(3):
                rows[i, j] = (
                    covariance[i, j]
                    + dt * covariance[6 + i, j]
                    + half * covariance[15 + i, j]
                    + (A[i, 0] * t0 + A[i, 1] * t1 + A[i, 2] * t2)
                    + (A[i, 3] * b0 + A[i, 4] * b1 + A[i, 5] * b2)
                )
                rows[3 + i, j] = (
                    A[3 + i, 0] * t0 + A[3 + i, 1] * t1 + A[3 + i, 2] * t2 - dt * covariance[9 + i, j]
                )
                rows[6 + i, j] = (
                    covariance[6 + i, j]
                    + dt * covariance[15 + i, j]
                    + (A[6 + i, 0] * t0 + A[6 + i, 1] * t1 + A[6 + i, 2] * t2)
                    + (A[6 + i, 3] * b0 + A[6 + i, 4] * b1 + A[6 + i, 5] * b2)
                )
        for i in range(9):
            for j in range(9, 18):
                covariance[i, j] = rows[i, j]
                covariance[j, i] = rows[i, j]
        # Their columns times F', of which one half is enough.
        for i in range(9):
            row = rows[i]
            t0, t1, t2 = row[3], row[4], row[5]
            b0, b1, b2 = row[12], row[13], row[14]
            for j in range(i + 1):
                m = j % 3
                total = A[j, 0] * t0 + A[j, 1] * t1 + A[j, 2] * t2
                if j < 3:
                    total += row[m] + dt * row[6 + m] + half * row[15 + m]
                    total += A[j, 3] * b0 + A[j, 4] * b1 + A[j, 5] * b2
                elif j < 6:
                    total -= dt * row[9 + m]
                else:
                    total += row[6 + m] + dt * row[15 + m]
                    total += A[j, 3] * b0 + A[j, 4] * b1 + A[j, 5] * b2
                covariance[i, j] = total
                covariance[j, i] = total
        for i in range(3):
            covariance[i, i] += noise[k, 1] * dt * dt * dt / 3.0
            covariance[i, 6 + i] += noise[k, 1] * half
            covariance[6 + i, i] += noise[k, 1] * half
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


@inlined
def vibration(inertial: FloatArray, first: int, last: int, dt: float, shaking: FloatArray) -> None:
    """Estimate the white noise that samples show, as squared densities (2,) of rate and specific force.

    Means of two samples, of which the middle one of three counts double and negative, cancel steady
    motion and its steady change; tones near half the sampling rate, which integration averages out,
    cancel in the means. White noise of variance s^2 leaves 3 s^2. Source: the Hadamard variance, W. Riley,
    "Handbook of Frequency Stability Analysis", NIST SP 1065, 2008, section 5.8, for means of two.

    Args:
        inertial: (n, 6) samples.
        first: index of the first.
        last: index after the last.
        dt: mean interval, seconds.
        shaking: (2,) receives the densities.
    """
    for half in range(2):
        total = 0.0
        for i in range(first, last - 5):
            for axis in range(3 * half, 3 * half + 3):
                third = 0.5 * (inertial[i, axis] + inertial[i + 1, axis] + inertial[i + 4, axis])
                third += 0.5 * inertial[i + 5, axis] - inertial[i + 2, axis] - inertial[i + 3, axis]
                total += third * third
        shaking[half] = total * dt / (9.0 * (last - 5 - first))


@compiled(
    "int64(float64[::1], float64[:,::1], int64[::1], float64[:,::1], boolean[::1], int64, int64, int64,"
    " float64[::1], float64[::1], float64[::1], float64[:,::1])"
)
def integrate(
    state: FloatArray,
    covariance: FloatArray,
    t_ns: NDArray[np.int64],
    inertial: FloatArray,
    suspect: NDArray[np.bool_],
    start_ns: int,
    end_ns: int,
    origin_ns: int,
    noise: FloatArray,
    shaking: FloatArray,
    excess: FloatArray,
    segments: FloatArray,
) -> int:
    """Propagate a state in place from one instant to another through a history of samples.

    A sample is the mean over the interval that ends with it; before the oldest and after the newest, the
    nearest one holds. White noise is what `noise` says or what vibration shows, whichever is more. Where
    samples are missing or suspect, motion may have gone unseen.

    Args:
        state: (24,).
        covariance: (18, 18).
        t_ns: (n,) times of the samples, ascending, n > 0.
        inertial: (n, 6) gyro rad/s and specific force m/s^2.
        suspect: (n,) whether a sample is saturated or follows a break.
        start_ns: time of the state.
        end_ns: time to reach, later.
        origin_ns: zero of the times in `segments`.
        noise: (10,) squared densities of rate, force and their biases' walks; squared rate and force that
            may go unseen in a gap; the same for suspect samples; the shortest gap in seconds; and the
            squared density of rate that an unknown scale adds for each squared rad/s.
        shaking: (2,) squared densities that vibration showed last, kept up to date.
        excess: (2,) factors on both, learnt from what scans correct.
        segments: (>= n + 2, 22) as of `propagate`.

    Returns:
        The number of limits in `segments`.
    """
    n = t_ns.shape[0]
    low = int(np.searchsorted(t_ns, start_ns, side="right"))
    high = int(np.searchsorted(t_ns, end_ns, side="left"))
    count = high - low + 2
    t_s = np.empty(count)
    between = np.empty((count - 1, 6))
    variances = np.empty((count - 1, 4))
    t_s[0] = (start_ns - origin_ns) * 1e-9
    for k in range(count - 1):
        i = min(low + k, n - 1)
        t_s[k + 1] = ((t_ns[low + k] if k + 2 < count else end_ns) - origin_ns) * 1e-9
        between[k] = inertial[i]
    if count > VIBRATION_SAMPLES:
        vibration(between, 0, count - 1, (t_s[count - 1] - t_s[0]) / (count - 1), shaking)
    for k in range(count - 1):
        dt = t_s[k + 1] - t_s[k]
        variances[k, 0] = max(noise[0], max(noise[0], shaking[0]) * excess[0])
        variances[k, 1] = max(noise[1], max(noise[1], shaking[1]) * excess[1])
        turning = between[k, 0] ** 2 + between[k, 1] ** 2 + between[k, 2] ** 2
        variances[k, 0] += noise[9] * turning / 3.0
        variances[k, 2], variances[k, 3] = noise[2], noise[3]
        if dt > noise[8]:
            variances[k, 0] += noise[4] * dt
            variances[k, 1] += noise[5] * dt
        if suspect[min(low + k, n - 1)]:
            variances[k, 0] += noise[6] * dt
            variances[k, 1] += noise[7] * dt
    propagate(state, covariance, t_s, between, variances, segments)
    return count


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
