"""From the frames in which another process may state its odometry to ours.

`q` of a message is the attitude of the child frame in the frame, whichever two are stated, and roll,
pitch and yaw of its covariance are the angles of that same rotation, turned about z, then y, then x.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.drivers.external_odometry_settings import ChildFrame, Frame
from companion.geometry import frames, rotation
from companion.geometry.rotation import FloatArray

FRAME_IDS: dict[int, Frame] = {20: "local_frd", 1: "local_ned", 21: "local_flu"}
CHILD_FRAME_IDS: dict[int, ChildFrame] = {12: "body_frd", 13: "body_flu"}

_Turn = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class StatedMotion:
    """A pose and a twist as a message states them.

    Attributes:
        p: (3,) position of the child's origin in the frame.
        q: (4,) attitude of the child in the frame, unit quaternion (w, x, y, z).
        v, omega: (3,) velocity and angular rate in the child frame; may be not a number.
        covariance_pose: (6, 6) of x, y, z in the frame, roll, pitch, yaw.
        covariance_velocity: (3, 3) in the child frame.
    """

    p: FloatArray
    q: FloatArray
    v: FloatArray
    omega: FloatArray
    covariance_pose: FloatArray
    covariance_velocity: FloatArray


def to_map(motion: StatedMotion, frame: Frame, child_frame: ChildFrame) -> StatedMotion:
    """Return a stated motion in map and FLU body: velocity in the map, rotation covariance in the body."""
    turn: _Turn = _unchanged
    if frame == "local_frd":
        turn = frames.flu_from_frd
    elif frame == "local_ned":
        turn = frames.enu_from_ned
    R_map_frame = turn(np.eye(3)).T
    turn_child: _Turn = frames.flu_from_frd if child_frame == "body_frd" else _unchanged
    R_body_child = turn_child(np.eye(3)).T
    R_frame_child = rotation.to_matrix(motion.q)
    R_map_body = R_map_frame @ R_frame_child @ R_body_child.T
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = R_map_frame
    jacobian[3:, 3:] = R_body_child @ body_rates_of_euler_rates(motion.q)
    R_map_child = R_map_body @ R_body_child
    return StatedMotion(
        p=turn(motion.p),
        q=rotation.from_matrix(R_map_body),
        v=R_map_child @ motion.v,
        omega=turn_child(motion.omega),
        covariance_pose=_symmetric(jacobian @ motion.covariance_pose @ jacobian.T),
        covariance_velocity=_symmetric(R_map_child @ motion.covariance_velocity @ R_map_child.T),
    )


def body_rates_of_euler_rates(q: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) that turns rates of roll, pitch and yaw into rates about the body's axes.

    Source: Diebel, "Representing attitude", 2006, the inverse of equation 76.
    """
    w, x, y, z = q.tolist()
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    sin_pitch = min(max(2.0 * (w * y - z * x), -1.0), 1.0)
    cos_pitch = math.sqrt(1.0 - sin_pitch * sin_pitch)
    sin_roll, cos_roll = math.sin(roll), math.cos(roll)
    return np.array(
        [
            [1.0, 0.0, -sin_pitch],
            [0.0, cos_roll, sin_roll * cos_pitch],
            [0.0, -sin_roll, cos_roll * cos_pitch],
        ]
    )


def _unchanged(v: FloatArray) -> FloatArray:
    return v


def _symmetric(covariance: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (covariance + covariance.T))
