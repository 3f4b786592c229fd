"""Rotations as unit quaternions (w, x, y, z) and matrices, batched over leading axes.

`q_a_b` rotates a vector's coordinates from frame b into frame a. Perturbations are on the right
(body) side: ``q (+) theta = q * exp(theta)``. Source: J. Sola, "Quaternion kinematics for the
error-state Kalman filter", 2017, equations 101-103 and 183.

Single quaternions and vectors come many times a second: where that is several times faster, they are
worked out in plain numbers, in the order of operations of the arrays, so with the same bits.
"""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
_N = TypeVar("_N", float, FloatArray)

IDENTITY: FloatArray = np.array([1.0, 0.0, 0.0, 0.0])
IDENTITY.setflags(write=False)
_CONJUGATE: FloatArray = np.array([1.0, -1.0, -1.0, -1.0])


def normalize(q: ArrayLike) -> FloatArray:
    """Return `q` (..., 4) scaled to unit norm, with w >= 0.

    Raises:
        ValueError: if a quaternion has no direction (zero or not finite).
    """
    quaternion = np.asarray(q, dtype=np.float64)
    if quaternion.ndim == 1:
        w, x, y, z = quaternion.tolist()
        length = math.sqrt(w * w + x * x + y * y + z * z)
        if not 0.0 < length < math.inf:
            raise ValueError("a quaternion must be finite and not zero")
        length = math.copysign(length, w)
        return np.array([w / length, x / length, y / length, z / length])
    norm = np.sqrt(np.sum(quaternion * quaternion, axis=-1, keepdims=True))
    # Written so that not-a-number fails the comparison too.
    if not np.all((norm > 0.0) & (norm < np.inf)):
        raise ValueError("a quaternion must be finite and not zero")
    unit: FloatArray = quaternion / np.copysign(norm, quaternion[..., :1])
    return unit


def multiply(q_a_b: ArrayLike, q_b_c: ArrayLike) -> FloatArray:
    """Return q_a_c = q_a_b * q_b_c, both (..., 4) and broadcast against each other."""
    a = np.asarray(q_a_b, dtype=np.float64)
    b = np.asarray(q_b_c, dtype=np.float64)
    if a.ndim == 1 and b.ndim == 1:
        return np.array(_product(*a.tolist(), *b.tolist()))
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    return np.stack(_product(aw, ax, ay, az, bw, bx, by, bz), axis=-1)


def _product(aw: _N, ax: _N, ay: _N, az: _N, bw: _N, bx: _N, by: _N, bz: _N) -> tuple[_N, _N, _N, _N]:
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q_a_b: ArrayLike) -> FloatArray:
    """Return q_b_a, the inverse of a unit quaternion (..., 4)."""
    return np.multiply(np.asarray(q_a_b, dtype=np.float64), _CONJUGATE)


def rotate(q_a_b: ArrayLike, v_b: ArrayLike) -> FloatArray:
    """Return v_a: the vectors v_b (..., 3) expressed in frame a."""
    q = np.asarray(q_a_b, dtype=np.float64)
    v = np.asarray(v_b, dtype=np.float64)
    if q.ndim == 1 and v.ndim == 1:
        return np.array(_rotated(*q.tolist(), *v.tolist()))
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    return np.stack(_rotated(w, x, y, z, v[..., 0], v[..., 1], v[..., 2]), axis=-1)


def _rotated(w: _N, x: _N, y: _N, z: _N, vx: _N, vy: _N, vz: _N) -> tuple[_N, _N, _N]:
    # v + 2 w (u x v) + 2 u x (u x v), with u the imaginary part.
    cx, cy, cz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * cx + (y * cz - z * cy),
        vy + w * cy + (z * cx - x * cz),
        vz + w * cz + (x * cy - y * cx),
    )


def to_matrix(q_a_b: ArrayLike) -> FloatArray:
    """Return R_a_b (..., 3, 3) of unit quaternions (..., 4)."""
    q = np.asarray(q_a_b, dtype=np.float64)
    if q.ndim == 1:
        w, x, y, z = q.tolist()
        return np.array(
            [
                [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
                [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
                [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
            ]
        )
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    matrix = np.empty((*w.shape, 3, 3))
    matrix[..., 0, 0] = 1.0 - 2.0 * (y * y + z * z)
    matrix[..., 0, 1] = 2.0 * (x * y - w * z)
    matrix[..., 0, 2] = 2.0 * (x * z + w * y)
    matrix[..., 1, 0] = 2.0 * (x * y + w * z)
    matrix[..., 1, 1] = 1.0 - 2.0 * (x * x + z * z)
    matrix[..., 1, 2] = 2.0 * (y * z - w * x)
    matrix[..., 2, 0] = 2.0 * (x * z - w * y)
    matrix[..., 2, 1] = 2.0 * (y * z + w * x)
    matrix[..., 2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return matrix


def from_matrix(R_a_b: ArrayLike) -> FloatArray:
    """Return q_a_b (..., 4) of rotation matrices (..., 3, 3), by the largest of Shepperd's four forms."""
    R = np.asarray(R_a_b, dtype=np.float64)
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    candidates = np.empty((*trace.shape, 4, 4))
    candidates[..., 0, 0] = 1.0 + trace
    for axis in range(3):
        candidates[..., axis + 1, axis + 1] = 1.0 - trace + 2.0 * R[..., axis, axis]
    candidates[..., 0, 1] = candidates[..., 1, 0] = R[..., 2, 1] - R[..., 1, 2]
    candidates[..., 0, 2] = candidates[..., 2, 0] = R[..., 0, 2] - R[..., 2, 0]
    candidates[..., 0, 3] = candidates[..., 3, 0] = R[..., 1, 0] - R[..., 0, 1]
    candidates[..., 1, 2] = candidates[..., 2, 1] = R[..., 0, 1] + R[..., 1, 0]
    candidates[..., 1, 3] = candidates[..., 3, 1] = R[..., 0, 2] + R[..., 2, 0]
    candidates[..., 2, 3] = candidates[..., 3, 2] = R[..., 1, 2] + R[..., 2, 1]
    # The form with the largest divisor loses the least precision.
    best = np.argmax(np.diagonal(candidates, axis1=-2, axis2=-1), axis=-1)
    return normalize(np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :])


def exp(theta: ArrayLike) -> FloatArray:
    """Return the quaternions (..., 4) of rotation vectors (..., 3) in radians."""
    vector = np.asarray(theta, dtype=np.float64)
    if vector.ndim == 1:
        x, y, z = vector.tolist()
        turn = 0.5 * math.sqrt(x * x + y * y + z * z)
        inner = math.pi * (turn / math.pi or 1e-20)  # as `np.sinc` does
        share = float(np.sin(inner)) / inner
        return np.array([np.cos(turn), 0.5 * x * share, 0.5 * y * share, 0.5 * z * share])
    half = 0.5 * np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * vector * np.sinc(half / np.pi)], axis=-1)


def log(q: ArrayLike) -> FloatArray:
    """Return the shortest rotation vectors (..., 3) in radians of unit quaternions (..., 4)."""
    quaternion = np.asarray(q, dtype=np.float64)
    quaternion = np.where(quaternion[..., :1] < 0.0, -quaternion, quaternion)
    imaginary = quaternion[..., 1:]
    sine = np.linalg.norm(imaginary, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quaternion[..., :1])
    small = sine < 1e-12
    return imaginary * np.where(small, 2.0, angle / np.where(small, 1.0, sine))


def slerp(q_start: ArrayLike, q_end: ArrayLike, fraction: ArrayLike) -> FloatArray:
    """Interpolate along the shortest arc; `fraction` (...) is 0 at `q_start` and 1 at `q_end`."""
    start = np.asarray(q_start, dtype=np.float64)
    step = log(multiply(conjugate(start), q_end))
    return multiply(start, exp(np.asarray(fraction, dtype=np.float64)[..., None] * step))


def from_yaw(yaw: ArrayLike) -> FloatArray:
    """Return rotations (..., 4) about z by `yaw` (...) radians."""
    half = 0.5 * np.asarray(yaw, dtype=np.float64)
    if half.ndim == 0:
        return np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)


def yaw_of(q: ArrayLike) -> FloatArray:
    """Return the heading (...) in radians: the angle of the body's x axis in the parent's xy plane."""
    quaternion = np.asarray(q, dtype=np.float64)
    if quaternion.ndim == 1:
        qw, qx, qy, qz = quaternion.tolist()
        return np.asarray(np.arctan2(2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qy * qy + qz * qz)))
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return np.asarray(np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)))


def angle_between(q_a: ArrayLike, q_b: ArrayLike) -> FloatArray:
    """Return the angle (...) in radians of the rotation that takes one attitude to the other."""
    return np.asarray(np.linalg.norm(log(multiply(conjugate(q_a), q_b)), axis=-1))
