"""Hot loop of publishing: from the IMU's motion in the map to the body's."""

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
    " float64, float64[::1], float64[::1], float64[:,::1], float64[:,::1])"
)
def publish(
    state: FloatArray,
    covariance: FloatArray,
    anchored: FloatArray,
    omega_imu: FloatArray,
    p_imu_body: FloatArray,
    R_imu_body: FloatArray,
    correlation: float,
    tilt_variance: float,
    floors: FloatArray,
    motion: FloatArray,
    pose_covariance: FloatArray,
    velocity_covariance: FloatArray,
) -> None:
    """Move motion and covariance from the IMU to the body.

    To the filter's error come the map's own: a twist (rho, phi) that displaces what lies at x by
    rho + phi cross x, and with it attitude and velocity. One part of it grows where the map was built on
    uncertain poses. The other was there from the start: at rest an accelerometer cannot tell its bias
    from a tilt, so the map leans a little, and all it says leans with it.

    Args:
        state: (24,) see `kernels`.
        covariance: (18, 18) of its error against the map.
        anchored: (6, 6) of the map's twist against the start, rho first.
        omega_imu: (3,) rate free of bias, rad/s.
        p_imu_body: (3,) body in the IMU frame.
        R_imu_body: (3, 3) its axes.
        correlation: factor on the covariance of pose and velocity against the map.
        tilt_variance: of the map's lean about each horizontal axis, rad^2.
        floors: (3,) smallest variances of position, rotation and velocity on each axis.
        motion: (13,) receives position, attitude, velocity and rate of the body.
        pose_covariance: (6, 6) receives position in the map, then rotation in the body.
        velocity_covariance: (3, 3) receives that of the velocity in the map.
    """
    R_map_imu = state[3:12].reshape(3, 3)
    R_map_body = R_map_imu @ R_imu_body
    swing = np.empty(3)  # velocity of the body origin against the IMU
    swing[0] = omega_imu[1] * p_imu_body[2] - omega_imu[2] * p_imu_body[1]
    swing[1] = omega_imu[2] * p_imu_body[0] - omega_imu[0] * p_imu_body[2]
    swing[2] = omega_imu[0] * p_imu_body[1] - omega_imu[1] * p_imu_body[0]
    p, v = motion[0:3], motion[7:10]
    for i in range(3):
        p[i], v[i], motion[10 + i] = state[i], state[12 + i], 0.0
        for k in range(3):
            p[i] += R_map_imu[i, k] * p_imu_body[k]
            v[i] += R_map_imu[i, k] * swing[k]
            motion[10 + i] += R_imu_body[k, i] * omega_imu[k]
    to_quaternion(R_map_body, motion[3:7])

    # Derivatives of (p, theta, v) of the body by the filter's errors of pose, velocity and gyro bias.
    J = np.zeros((9, 12))
    part = np.empty(3)
    for i in range(3):
        J[i, i] = 1.0
        J[6 + i, 6 + i] = 1.0
        cross_columns(p_imu_body, R_map_imu[i], part)
        for j in range(3):
            J[i, 3 + j] = -part[j]
            J[6 + i, 9 + j] = part[j]
            J[3 + i, 3 + j] = R_imu_body[j, i]
        cross_columns(swing, R_map_imu[i], part)
        for j in range(3):
            J[6 + i, 3 + j] = -part[j]
    # Derivatives by a twist of the map.
    E = np.zeros((9, 6))
    for i in range(3):
        E[i, i] = 1.0
        for j in range(3):
            E[3 + i, 3 + j] = R_map_body[j, i]
    for row, r in ((0, p), (6, v)):
        E[row, 4], E[row, 5] = r[2], -r[1]
        E[row + 1, 3], E[row + 1, 5] = -r[2], r[0]
        E[row + 2, 3], E[row + 2, 4] = r[1], -r[0]
    twist = anchored.copy()
    twist[3, 3] += tilt_variance
    twist[4, 4] += tilt_variance

    total = np.zeros((9, 9))
    product, scaled = np.empty(12), np.empty(6)
    for i in range(9):
        for j in range(12):
            product[j] = 0.0
            for k in range(12):
                if J[i, k] != 0.0:
                    factor = correlation if j < 9 and k < 9 else 1.0
                    product[j] += J[i, k] * factor * covariance[k, j]
        for k in range(9):
            for j in range(12):
                total[i, k] += product[j] * J[k, j]
        for j in range(6):
            scaled[j] = 0.0
            for k in range(6):
                scaled[j] += E[i, k] * twist[k, j]
        for k in range(9):
            for j in range(6):
                total[i, k] += scaled[j] * E[k, j]
    for i in range(6):
        for j in range(6):
            pose_covariance[i, j] = 0.5 * (total[i, j] + total[j, i])
        pose_covariance[i, i] = max(pose_covariance[i, i], floors[0] if i < 3 else floors[1])
    for i in range(3):
        for j in range(3):
            velocity_covariance[i, j] = 0.5 * (total[6 + i, 6 + j] + total[6 + j, 6 + i])
        velocity_covariance[i, i] = max(velocity_covariance[i, i], floors[2])
