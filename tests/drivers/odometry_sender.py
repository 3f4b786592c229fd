"""What another process would send: MAVLink ODOMETRY by its fields, made by pymavlink."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from pymavlink.dialects.v20 import common as dialect

from companion.geometry import frames, rotation
from companion.geometry.rotation import FloatArray

NAN = float("nan")
LOCAL_NED, BODY_FRD, BODY_FLU, LOCAL_FRD, LOCAL_FLU = 1, 12, 13, 20, 21


def triangle(*diagonal: float) -> list[float]:
    """Return the 21 numbers of a diagonal covariance."""
    values: list[float] = np.diag(diagonal)[np.triu_indices(6)].tolist()
    return values


@dataclass(frozen=True)
class Stated:
    """One message, every field of it."""

    time_usec: int = 1_000_000
    frame_id: int = LOCAL_FRD
    child_frame_id: int = BODY_FRD
    p: tuple[float, float, float] = (1.0, 2.0, -3.0)
    q: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    v: tuple[float, float, float] = (0.5, 0.0, 0.0)
    omega: tuple[float, float, float] = (0.0, 0.0, 0.1)
    pose_covariance: list[float] = field(default_factory=lambda: triangle(4e-4, 4e-4, 4e-4, 1e-4, 1e-4, 1e-4))
    velocity_covariance: list[float] = field(
        default_factory=lambda: triangle(1e-2, 1e-2, 1e-2, 1.0, 1.0, 1.0)
    )
    reset_counter: int = 0
    quality: int = 80

    def with_(self, **changes: object) -> "Stated":
        return replace(self, **changes)  # type: ignore[arg-type]

    def bytes(self, system_id: int = 1, component_id: int = 197) -> bytes:
        """Return the MAVLink 2 frame."""
        sender = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        message = dialect.MAVLink_odometry_message(
            self.time_usec,
            self.frame_id,
            self.child_frame_id,
            *self.p,
            list(self.q),
            *self.v,
            *self.omega,
            self.pose_covariance,
            self.velocity_covariance,
            self.reset_counter,
            3,
            self.quality,
        )
        return bytes(message.pack(sender))


@dataclass(frozen=True)
class Motion:
    """A motion in our frames."""

    p_map: FloatArray
    q_map_body: FloatArray
    v_map: FloatArray
    omega_body: FloatArray


A_MOTION = Motion(
    np.array([1.0, -2.0, 3.0]),
    rotation.multiply(rotation.from_yaw(0.7), rotation.exp([0.2, -0.3, 0.0])),
    np.array([0.5, -0.4, 0.3]),
    np.array([0.1, -0.2, 0.3]),
)


def unchanged(v: ArrayLike) -> FloatArray:
    """Return vectors as they are, like the functions of `frames` that turn them."""
    return np.asarray(v, dtype=np.float64)


def stated_in(motion: Motion, frame_id: int, child_frame_id: int) -> Stated:
    """Return a motion as a sender with these frames states it."""
    R_map_body = rotation.to_matrix(motion.q_map_body)
    turn = {LOCAL_FRD: frames.frd_from_flu, LOCAL_NED: frames.ned_from_enu, LOCAL_FLU: unchanged}[frame_id]
    turn_child = frames.frd_from_flu if child_frame_id == BODY_FRD else unchanged
    R_frame_map = turn(np.eye(3)).T
    R_child_body = turn_child(np.eye(3)).T
    q = rotation.from_matrix(R_frame_map @ R_map_body @ R_child_body.T)
    v_child = R_child_body @ R_map_body.T @ motion.v_map
    return Stated(
        frame_id=frame_id,
        child_frame_id=child_frame_id,
        p=tuple(turn(motion.p_map)),
        q=tuple(q),
        v=tuple(v_child),
        omega=tuple(R_child_body @ motion.omega_body),
    )


def euler(q: FloatArray) -> tuple[float, float, float]:
    """Return roll, pitch, yaw."""
    w, x, y, z = q.tolist()
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(2 * (w * y - z * x)),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
