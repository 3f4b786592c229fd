"""Hot loop of publishing: from the IMU's motion in the map to the body's in the levelled one."""

import numpy as np

from companion.compiled import compiled, inlined
from companion.messages import FloatArray

MOTION_SIZE = 13
"""Position, attitude (w, x, y, z), velocity and rate of the body."""


@inlined
def cross_columns(v: FloatArray, row: FloatArray, result: FloatArray) -> None:
    """Return row times the matrix [v]x, whose product with x is v cross x."""
    result[0] = row[1] * v[2] - row[2] * v[1]
    result[1] = row[2] * v[0] - row[0] * v[2]
    result[2] = row[0] * v[1] - row[1] * v[0]


@compiled("void(float64[::1], float64[:,::1])")
def level(g_map: FloatArray, R_level_map: FloatArray) -> None:
    """Find the smallest rotation that takes gravity straight down.

    Args:
        g_map: (3,) gravity, not zero and not straight up.
        R_level_map: (3, 3) receives the rotation.
    """
    length = np.sqrt(g_map[0] ** 2 + g_map[1] ** 2 + g_map[2] ** 2)
    ux, uy, uz = g_map[0] / length, g_map[1] / length, g_map[2] / length
    # The axis u x (0, 0, -1) has the sine's length, and 1 + cosine = 1 - uz.
    ax, ay = -uy, ux
    scale = 1.0 / max(1.0 - uz, 1e-12)
    R_level_map[0, 0], R_level_map[0, 1], R_level_map[0, 2] = 1.0 - scale * ay * ay, scale * ax * ay, ay
    R_level_map[1, 0], R_level_map[1, 1], R_level_map[1, 2] = scale * ax * ay, 1.0 - scale * ax * ax, -ax
    R_level_map[2, 0], R_level_map[2, 1] = -ay, ax
    R_level_map[2, 2] = 1.0 - scale * (ax * ax + ay * ay)


@inlined
def to_quaternion(R: FloatArray, q: FloatArray) -> None:
    """Write a rotation matrix (3, 3) as a quaternion (4,) with w >= 0, by the largest of four forms."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace >= R[0, 0] and trace >= R[1, 1] and trace >= R[2, 2]:
        q[0], q[1], q[2], q[3] = 1.0 + trace, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    elif R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2]:
        q[0], q[1] = R[2, 1] - R[1, 2], 1.0 - trace + 2.0 * R[0, 0]
        q[2], q[3] = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]
    elif R[1, 1] >= R[2, 2]:
        q[0], q[1] = R[0, 2] - R[2, 0], R[0, 1] + R[1, 0]
        q[2], q[3] = 1.0 - trace + 2.0 * R[1, 1], R[1, 2] + R[2, 1]
    else:
        q[0], q[1] = R[1, 0] - R[0, 1], R[0, 2] + R[2, 0]
        q[2], q[3] = R[1, 2] + R[2, 1], 1.0 - trace + 2.0 * R[2, 2]
    scale = 1.0 / np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    if q[0] < 0.0:
        scale = -scale
    for i in range(4):
        q[i] *= scale


@compiled(
    "void(float64[::1], float64[:,::1], float64[:,::1], float64[::1], float64[::1], float64[:,::1], float64,"
    " float64[::1], float64[::1], float64[:,::1], float64[:,::1])"
)
def publish(
    state: FloatArray,
    covariance: FloatArray,
    anchored: FloatArray,
    omega_imu: FloatArray,
    p_imu_body: FloatArray,
    R_imu_body: FloatArray,
    correlation: float,
    floors: FloatArray,
    motion: FloatArray,
    pose_covariance: FloatArray,
    velocity_covariance: FloatArray,
) -> None:
    """Move motion and covariance from the IMU to the body and from the map to its levelled frame.

    To the filter's error come the map's own: a twist (rho, phi) that displaces what lies at x by
    rho + phi cross x, and with it attitude, velocity and gravity as the filter feels them.

    Args:
        state: (24,) see `kernels`.
        covariance: (18, 18) of its error against the map.
        anchored: (6, 6) of the map's twist against the start, rho first.
        omega_imu: (3,) rate free of bias, rad/s.
        p_imu_body: (3,) body in the IMU frame.
        R_imu_body: (3, 3) its axes.
        correlation: factor on the covariance of pose and velocity against the map.
        floors: (3,) smallest variances of position, rotation and velocity on each axis.
        motion: (13,) receives position, attitude, velocity and rate of the body.
        pose_covariance: (6, 6) receives position in the levelled map, then rotation in the body.
        velocity_covariance: (3, 3) receives that of the velocity in the levelled map.
    """
    L, R_level_imu, R_level_body = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    level(state[21:24], L)
    for i in range(3):
        for j in range(3):
            R_level_imu[i, j] = 0.0
            for k in range(3):
                R_level_imu[i, j] += L[i, k] * state[3 + 3 * k + j]
    for i in range(3):
        for j in range(3):
            R_level_body[i, j] = 0.0
            for k in range(3):
                R_level_body[i, j] += R_level_imu[i, k] * R_imu_body[k, j]
    swing = np.empty(3)  # velocity of the body origin against the IMU
    swing[0] = omega_imu[1] * p_imu_body[2] - omega_imu[2] * p_imu_body[1]
    swing[1] = omega_imu[2] * p_imu_body[0] - omega_imu[0] * p_imu_body[2]
    swing[2] = omega_imu[0] * p_imu_body[1] - omega_imu[1] * p_imu_body[0]
    p, v = motion[0:3], motion[7:10]
    for i in range(3):
        p[i], v[i], motion[10 + i] = 0.0, 0.0, 0.0
        for k in range(3):
            p[i] += L[i, k] * state[k] + R_level_imu[i, k] * p_imu_body[k]
            v[i] += L[i, k] * state[12 + k] + R_level_imu[i, k] * swing[k]
            motion[10 + i] += R_imu_body[k, i] * omega_imu[k]
    to_quaternion(R_level_body, motion[3:7])

    # Derivatives of (p, theta, v) of the body by the filter's 18 errors.
    J = np.zeros((9, 18))
    part = np.empty(3)
    length = np.sqrt(state[21] ** 2 + state[22] ** 2 + state[23] ** 2)
    for i in range(3):
        J[i, 0:3] = L[i]
        J[6 + i, 6:9] = L[i]
        cross_columns(p_imu_body, R_level_imu[i], part)
        for j in range(3):
            J[i, 3 + j] = -part[j]
            J[6 + i, 9 + j] = part[j]
            J[3 + i, 3 + j] = R_imu_body[j, i]
        cross_columns(swing, R_level_imu[i], part)
        for j in range(3):
            J[6 + i, 3 + j] = -part[j]
    # An error d of gravity turns the levelled frame by phi = (-d_y, d_x, z) / g, and about the vertical by
    # what keeps the rotation the smallest.
    lean_x, lean_y = -state[22] / (length - state[23]), state[21] / (length - state[23])
    for j in range(3):
        x, y = -L[1, j] / length, L[0, j] / length
        z = lean_x * y - lean_y * x
        for i in range(3):
            J[3 + i, 15 + j] = R_level_body[0, i] * x + R_level_body[1, i] * y + R_level_body[2, i] * z
        for row, r in ((0, p), (6, v)):
            J[row, 15 + j] = y * r[2] - z * r[1]
            J[row + 1, 15 + j] = z * r[0] - x * r[2]
            J[row + 2, 15 + j] = x * r[1] - y * r[0]

    # The filter's errors by the map's twist.
    E = np.zeros((18, 6))
    for i in range(3):
        E[i, i] = 1.0
        for j in range(3):
            E[3 + i, 3 + j] = state[3 + 3 * j + i]
    for block, first in ((0, 0), (6, 12), (15, 21)):
        x, y, z = state[first], state[first + 1], state[first + 2]
        E[block, 4], E[block, 5] = z, -y
        E[block + 1, 3], E[block + 1, 5] = -z, x
        E[block + 2, 3], E[block + 2, 4] = y, -x

    total = np.zeros((9, 9))
    product, scaled = np.empty(18), np.empty(6)
    for i in range(9):
        for j in range(18):
            product[j] = 0.0
            for k in range(18):
                if J[i, k] != 0.0:
                    factor = correlation if j < 9 and k < 9 else 1.0
                    product[j] += J[i, k] * factor * covariance[k, j]
        for k in range(9):
            for j in range(18):
                total[i, k] += product[j] * J[k, j]
    JE = J @ E
    for i in range(9):
        for j in range(6):
            scaled[j] = 0.0
            for k in range(6):
                scaled[j] += JE[i, k] * anchored[k, j]
        for k in range(9):
            for j in range(6):
                total[i, k] += scaled[j] * JE[k, j]
    for i in range(6):
        for j in range(6):
            pose_covariance[i, j] = 0.5 * (total[i, j] + total[j, i])
        pose_covariance[i, i] = max(pose_covariance[i, i], floors[0] if i < 3 else floors[1])
    for i in range(3):
        for j in range(3):
            velocity_covariance[i, j] = 0.5 * (total[6 + i, 6 + j] + total[6 + j, 6 + i])
        velocity_covariance[i, i] = max(velocity_covariance[i, i], floors[2])
