"""Which setpoints and external odometry messages the emulated autopilot takes, and how it reads them."""

import math
from typing import Any

from sitl.autopilot_inputs import ExternalVision, OffboardSetpoint, Vector, VisionFrame

LOCAL_NED, BODY_NED, BODY_FRD, MOCAP_NED, LOCAL_FRD, LOCAL_FLU = 1, 8, 12, 14, 20, 21
_ESTIMATORS = (1, 2, 3)
_QUATERNION_TOLERANCE = 1.0e-5
_COMPONENT_MAX = 1.0e5
_VARIANCE_MAX = 1.0e6
_FRAMES = {
    LOCAL_NED: VisionFrame.NORTH,
    LOCAL_FRD: VisionFrame.ODOMETRY,
    LOCAL_FLU: VisionFrame.ODOMETRY,
}
_IGNORE_POSITION, _IGNORE_VELOCITY = 0x7, 0x38
_IGNORE_YAW, _IGNORE_YAW_RATE = 0x400, 0x800


def flipped(x: float, y: float, z: float) -> Vector:
    """Return a vector between z-down and z-up axes that share x; either way."""
    return (x, -y, -z)


def external_vision(message: Any, t_sample_ns: int) -> ExternalVision | None:
    """Return what the estimator gets of an ODOMETRY message.

    Args:
        message: the decoded message.
        t_sample_ns: its stamp on the simulation's clock.

    Returns:
        None if the message is dropped whole: its estimator type is neither naive, vision nor VIO. A part
        that is missing, not finite, in an unsupported frame or (attitude) not of unit norm is left out.
    """
    if message.estimator_type not in _ESTIMATORS:
        return None
    frame = _FRAMES.get(message.frame_id, VisionFrame.UNSUPPORTED)
    sign = -1.0 if message.frame_id != LOCAL_FLU else 1.0
    p = _finite((message.x, sign * message.y, sign * message.z))
    return ExternalVision(
        t_ns=t_sample_ns,
        frame=frame,
        p_local=None if frame is VisionFrame.UNSUPPORTED else p,
        v=_velocity(message),
        v_in_body=message.child_frame_id == BODY_FRD,
        q_local_body=_attitude(message.q),
        position_variance=_diagonal(message.pose_covariance, (0, 6, 11)),
        velocity_variance=_diagonal(message.velocity_covariance, (0, 6, 11)),
        yaw_variance=_variance(message.pose_covariance[20]),
        quality=message.quality,
        reset_counter=message.reset_counter,
    )


def vision_position_estimate(message: Any, t_sample_ns: int) -> ExternalVision:
    """Return what the estimator gets of a VISION_POSITION_ESTIMATE: position and attitude, in NED."""
    half = (0.5 * message.roll, 0.5 * message.pitch, 0.5 * message.yaw)
    (cr, cp, cy), (sr, sp, sy) = (tuple(map(math.cos, half)), tuple(map(math.sin, half)))
    q = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    return ExternalVision(
        t_ns=t_sample_ns,
        frame=VisionFrame.NORTH,
        p_local=_finite(flipped(message.x, message.y, message.z)),
        v=None,
        v_in_body=False,
        q_local_body=_attitude(q),
        position_variance=_diagonal(message.covariance, (0, 6, 11)),
        velocity_variance=None,
        yaw_variance=_variance(message.covariance[20]),
        quality=0,
        reset_counter=message.reset_counter,
    )


def offboard_setpoint(message: Any) -> OffboardSetpoint | None:
    """Return what SET_POSITION_TARGET_LOCAL_NED commands, None if it is refused.

    Only LOCAL_NED and BODY_NED are taken. In BODY_NED a position is ignored, velocities turn with the
    heading, and one ignored velocity component means all are.
    """
    mask = message.type_mask
    if message.coordinate_frame not in (LOCAL_NED, BODY_NED):
        return None
    in_heading = message.coordinate_frame == BODY_NED
    p = None if in_heading or mask & _IGNORE_POSITION else flipped(message.x, message.y, message.z)
    v = None if mask & _IGNORE_VELOCITY else flipped(message.vx, message.vy, message.vz)
    p, v = _finite(p), _finite(v)
    if p is None and v is None:
        return None
    yaw = None if mask & _IGNORE_YAW or not math.isfinite(message.yaw) else -message.yaw
    rate = None if mask & _IGNORE_YAW_RATE or not math.isfinite(message.yaw_rate) else -message.yaw_rate
    return OffboardSetpoint(p, v, in_heading, yaw, rate)


def _velocity(message: Any) -> Vector | None:
    v = _finite((message.vx, message.vy, message.vz))
    if v is None or message.child_frame_id not in (LOCAL_NED, LOCAL_FRD, BODY_NED, BODY_FRD, LOCAL_FLU):
        return None
    return v if message.child_frame_id == LOCAL_FLU else flipped(*v)


def _attitude(q: Any) -> tuple[float, float, float, float] | None:
    """Return the attitude with z-up axes of one with z-down axes, None if its norm is not one."""
    w, x, y, z = (float(component) for component in q)
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(norm - 1.0) <= _QUATERNION_TOLERANCE:
        return None
    return (w / norm, x / norm, -y / norm, -z / norm)


def _finite(v: Vector | None) -> Vector | None:
    """Return a vector only if it is finite and within what single precision resolves to centimetres."""
    return v if v is not None and all(abs(component) <= _COMPONENT_MAX for component in v) else None


def _variance(value: float) -> float | None:
    return min(float(value), _VARIANCE_MAX) if value >= 0.0 else None


def _diagonal(covariance: Any, indices: tuple[int, int, int]) -> Vector | None:
    x, y, z = (_variance(covariance[index]) for index in indices)
    return None if x is None or y is None or z is None else (x, y, z)
