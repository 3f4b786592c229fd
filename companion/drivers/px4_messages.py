"""Messages to PX4: our frames turned into its frames, checked to be finite in float32.

On external vision in MAV_FRAME_LOCAL_FRD the autopilot's local frame *is* the map with y and z
reversed, so LOCAL_NED in a setpoint means the map too; nothing here knows north.
"""

import math

import numpy as np

from companion.drivers.px4_modes import AUTOPILOT_INVALID, TYPE_ONBOARD_CONTROLLER
from companion.geometry import frames, rotation
from companion.geometry.rotation import FloatArray
from companion.messages import Odometry, Setpoint, StatusText

AUTOPILOT_COMPONENT = 1
MAX_TEXT = 50
_PREFIX = "CMP: "

_FRAME_LOCAL_NED = 1
_FRAME_BODY_FRD = 12
_FRAME_LOCAL_FRD = 20
# LIDAR (7) is dropped and MOCAP (6) is routed where the filter does not look.
_ESTIMATOR_VIO = 3
# Ignore position, acceleration and yaw; use velocity and yaw rate.
_VELOCITY_AND_YAW_RATE = 0x5C7
# No velocity, rate or distance of a small vehicle comes near this.
_LARGEST = 1e6
_UPPER_TRIANGLE = np.ravel_multi_index(np.triu_indices(6), (6, 6))
_IDENTITY = np.eye(6)
_MIN_COS_PITCH = 0.1


def heartbeat(system_status: int) -> dict[str, object]:
    """Return the fields of a HEARTBEAT of an onboard computer in a MAV_STATE."""
    return {
        "type": TYPE_ONBOARD_CONTROLLER,
        "autopilot": AUTOPILOT_INVALID,
        "base_mode": 0,
        "custom_mode": 0,
        "system_status": system_status,
        "mavlink_version": 3,
    }


def status_text(status: StatusText) -> dict[str, object]:
    """Return the fields of a STATUSTEXT: prefixed, ASCII, cut to 50 characters."""
    body = status.text.removeprefix(_PREFIX).encode("ascii", "replace").decode("ascii")
    body = "".join(character if character.isprintable() else " " for character in body)
    return {
        "severity": int(status.severity),
        "text": (_PREFIX + body)[:MAX_TEXT],
        "id": 0,
        "chunk_seq": 0,
    }


def velocity_setpoint(setpoint: Setpoint, system_id: int, time_boot_ms: int) -> dict[str, object] | None:
    """Return the fields of SET_POSITION_TARGET_LOCAL_NED, or None if a number is not usable.

    Args:
        setpoint: velocity in the map (z up) and yaw rate counter-clockwise from above.
        system_id: the autopilot's.
        time_boot_ms: the autopilot's time.
    """
    v_frd = frames.frd_from_flu(setpoint.v_map)
    # Down is the third axis of FRD, so a turn to the left is a negative rate.
    yaw_rate = -float(setpoint.yaw_rate)
    if v_frd.shape != (3,) or not _usable(v_frd) or not abs(yaw_rate) <= _LARGEST:
        return None
    vx, vy, vz = v_frd.tolist()
    return {
        "time_boot_ms": time_boot_ms & 0xFFFFFFFF,
        "target_system": system_id,
        "target_component": AUTOPILOT_COMPONENT,
        "coordinate_frame": _FRAME_LOCAL_NED,
        "type_mask": _VELOCITY_AND_YAW_RATE,
        "x": 0.0,
        "y": 0.0,
        "z": 0.0,
        "vx": vx,
        "vy": vy,
        "vz": vz,
        "afx": 0.0,
        "afy": 0.0,
        "afz": 0.0,
        "yaw": 0.0,
        "yaw_rate": yaw_rate,
    }


def external_odometry(odometry: Odometry, time_usec: int, rate_noise: float) -> dict[str, object] | None:
    """Return the fields of ODOMETRY, or None if a number is not usable.

    Args:
        odometry: pose and velocity in the map.
        time_usec: the autopilot's time at which the state is valid.
        rate_noise: standard deviation of the angular rates, rad/s.
    """
    numbers = (
        odometry.p_map,
        odometry.q_map_body,
        odometry.v_map,
        odometry.omega_body,
        odometry.covariance_pose,
        odometry.covariance_velocity,
    )
    norm = math.hypot(*odometry.q_map_body.tolist())
    if not all(_usable(number) for number in numbers) or not 0.5 < norm < 2.0:
        return None
    q_map_body = rotation.normalize(odometry.q_map_body)
    # The limit on the norm is 1e-5; rounding each component to float32 moves it by 1e-7.
    q_frd = frames.q_frd_from_flu(q_map_body).astype(np.float32)
    v_body_flu = rotation.rotate(rotation.conjugate(q_map_body), odometry.v_map)
    x, y, z = frames.frd_from_flu(odometry.p_map).tolist()
    vx, vy, vz = frames.frd_from_flu(v_body_flu).tolist()
    rollspeed, pitchspeed, yawspeed = frames.frd_from_flu(odometry.omega_body).tolist()
    return {
        "time_usec": time_usec,
        "frame_id": _FRAME_LOCAL_FRD,
        "child_frame_id": _FRAME_BODY_FRD,
        "x": x,
        "y": y,
        "z": z,
        "q": q_frd.tolist(),
        "vx": vx,
        "vy": vy,
        "vz": vz,
        "rollspeed": rollspeed,
        "pitchspeed": pitchspeed,
        "yawspeed": yawspeed,
        "pose_covariance": _upper(pose_covariance_frd(odometry.covariance_pose, q_map_body)),
        "velocity_covariance": _upper(
            velocity_covariance_frd(odometry.covariance_velocity, q_map_body, rate_noise)
        ),
        "reset_counter": odometry.reset_counter & 0xFF,
        "estimator_type": _ESTIMATOR_VIO,
        "quality": min(max(int(odometry.quality), 0), 100),
    }


def pose_covariance_frd(covariance_pose: FloatArray, q_map_body: FloatArray) -> FloatArray:
    """Return the covariance (6, 6) of (x, y, z, roll, pitch, yaw) in FRD.

    Source: rates of the Euler angles from body rates, Diebel, "Representing attitude", 2006, eq. 76.

    Args:
        covariance_pose: (6, 6), position in the map, then rotation in the body.
        q_map_body: attitude, unit quaternion.
    """
    covariance = frames.covariance_frd_from_flu(covariance_pose)
    w, x, y, z = frames.q_frd_from_flu(q_map_body).tolist()
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    sin_pitch = min(max(2.0 * (w * y - z * x), -1.0), 1.0)
    # Roll and yaw cannot be told apart at the poles; a flying multicopter stays far from them.
    cos_pitch = max(math.sqrt(1.0 - sin_pitch * sin_pitch), _MIN_COS_PITCH)
    sin_roll, cos_roll = math.sin(roll), math.cos(roll)
    jacobian = _IDENTITY.copy()
    jacobian[3:, 3:] = [
        [1.0, sin_roll * sin_pitch / cos_pitch, cos_roll * sin_pitch / cos_pitch],
        [0.0, cos_roll, -sin_roll],
        [0.0, sin_roll / cos_pitch, cos_roll / cos_pitch],
    ]
    return np.asarray(jacobian @ covariance @ jacobian.T)


def velocity_covariance_frd(
    covariance_velocity: FloatArray, q_map_body: FloatArray, rate_noise: float
) -> FloatArray:
    """Return the covariance (6, 6) of (vx, vy, vz, roll, pitch, yaw rate) in the FRD body.

    Args:
        covariance_velocity: (3, 3) in the map.
        q_map_body: attitude, unit quaternion.
        rate_noise: standard deviation of the angular rates, rad/s.
    """
    R_body_map = rotation.to_matrix(q_map_body).T
    covariance = np.zeros((6, 6))
    covariance[3, 3] = covariance[4, 4] = covariance[5, 5] = rate_noise * rate_noise
    covariance[:3, :3] = frames.covariance_frd_from_flu(R_body_map @ covariance_velocity @ R_body_map.T)
    return covariance


def _upper(covariance: FloatArray) -> list[float]:
    triangle: list[float] = covariance.take(_UPPER_TRIANGLE).tolist()
    return triangle


def _usable(values: FloatArray) -> bool:
    # Not a number fails the comparison as well; the greatest of several numbers is it if one of them is.
    return bool(np.abs(values).max() <= _LARGEST)
