"""Rotations as unit quaternions (w, x, y, z) and matrices, batched over leading axes.

`q_a_b` rotates a vector's coordinates from frame b into frame a. Perturbations are on the right
(body) side: ``q (+) theta = q * exp(theta)``. Source: J. Sola, "Quaternion kinematics for the
error-state Kalman filter", 2017, equations 101-103 and 183.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

IDENTITY: FloatArray = np.array([1.0, 0.0, 0.0, 0.0])
IDENTITY.setflags(write=False)
_CONJUGATE: FloatArray = np.array([1.0, -1.0, -1.0, -1.0])


def normalize(q: ArrayLike) -> FloatArray:
    """Return `q` (..., 4) scaled to unit norm, with w >= 0.

    Raises:
        ValueError: if a quaternion has no direction (zero or not finite).
    """
    quaternion = np.asarray(q, dtype=np.float64)
    if quaternion.ndim == 1:  # many times a second: five times faster than what follows, and the same bits
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
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    w = aw * bw - ax * bx - ay * by - az * bz
    product = np.empty((*w.shape, 4))
    product[..., 0] = w
    product[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    product[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    product[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return product


def conjugate(q_a_b: ArrayLike) -> FloatArray:
    """Return q_b_a, the inverse of a unit quaternion (..., 4)."""
    return np.multiply(np.asarray(q_a_b, dtype=np.float64), _CONJUGATE)


def rotate(q_a_b: ArrayLike, v_b: ArrayLike) -> FloatArray:
    """Return v_a: the vectors v_b (..., 3) expressed in frame a."""
    q = np.asarray(q_a_b, dtype=np.float64)
    v = np.asarray(v_b, dtype=np.float64)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    vx, vy, vz = v[..., 0], v[..., 1], v[..., 2]
    # v + 2 w (u x v) + 2 u x (u x v), with u the imaginary part.
    cx, cy, cz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    rotated = np.empty((*cx.shape, 3))
    rotated[..., 0] = vx + w * cx + (y * cz - z * cy)
    rotated[..., 1] = vy + w * cy + (z * cx - x * cz)
    rotated[..., 2] = vz + w * cz + (x * cy - y * cx)
    return rotated


def to_matrix(q_a_b: ArrayLike) -> FloatArray:
    """Return R_a_b (..., 3, 3) of unit quaternions (..., 4)."""
    q = np.asarray(q_a_b, dtype=np.float64)
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
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)


def yaw_of(q: ArrayLike) -> FloatArray:
    """Return the heading (...) in radians: the angle of the body's x axis in the parent's xy plane."""
    quaternion = np.asarray(q, dtype=np.float64)
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return np.asarray(np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)))


def angle_between(q_a: ArrayLike, q_b: ArrayLike) -> FloatArray:
    """Return the angle (...) in radians of the rotation that takes one attitude to the other."""
    return np.asarray(np.linalg.norm(log(multiply(conjugate(q_a), q_b)), axis=-1))
