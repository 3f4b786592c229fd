"""NED/ENU and FRD/FLU: the only place where axes swap and signs flip.

The map frame has z up; its yaw is wherever the odometry started. PX4's local frame on external vision
in MAV_FRAME_LOCAL_FRD is the same frame with y and z reversed, so map (FLU) to local (FRD) is a sign
flip. ENU to NED is only for quantities that are truly aligned with north.
"""

import numpy as np
from numpy.typing import ArrayLike

from companion.geometry import rotation
from companion.geometry.rotation import FloatArray

_FLIP_YZ: FloatArray = np.array([1.0, -1.0, -1.0])
_FLIP_Q_YZ: FloatArray = np.array([1.0, 1.0, -1.0, -1.0])
_FLIPS = {3 * k: np.outer(np.tile(_FLIP_YZ, k), np.tile(_FLIP_YZ, k)) for k in (1, 2)}
_SQRT_HALF = np.sqrt(0.5)
# Half a turn about the axis between north and east: x and y swap, z changes sign.
_Q_NED_ENU = np.array([0.0, _SQRT_HALF, _SQRT_HALF, 0.0])
_Q_FLU_FRD = np.array([0.0, 1.0, 0.0, 0.0])


def flu_from_frd(v_frd: ArrayLike) -> FloatArray:
    """Return vectors (..., 3) in forward-left-up of vectors in forward-right-down, and the reverse."""
    return np.multiply(np.asarray(v_frd, dtype=np.float64), _FLIP_YZ)


frd_from_flu = flu_from_frd


def enu_from_ned(v_ned: ArrayLike) -> FloatArray:
    """Return vectors (..., 3) in east-north-up of vectors in north-east-down, and the reverse."""
    vector = np.asarray(v_ned, dtype=np.float64)
    return np.stack([vector[..., 1], vector[..., 0], -vector[..., 2]], axis=-1)


ned_from_enu = enu_from_ned


def q_frd_from_flu(q_flu: ArrayLike) -> FloatArray:
    """Return q_localfrd_bodyfrd (..., 4) of q_map_body, where both frames turn from FLU to FRD."""
    return rotation.normalize(np.multiply(np.asarray(q_flu, dtype=np.float64), _FLIP_Q_YZ))


q_flu_from_frd = q_frd_from_flu


def q_ned_frd_from_enu_flu(q_enu_flu: ArrayLike) -> FloatArray:
    """Return the attitude (..., 4) of an FRD body in NED of the attitude of an FLU body in ENU."""
    return rotation.normalize(rotation.multiply(rotation.multiply(_Q_NED_ENU, q_enu_flu), _Q_FLU_FRD))


def q_enu_flu_from_ned_frd(q_ned_frd: ArrayLike) -> FloatArray:
    """Return the attitude (..., 4) of an FLU body in ENU of the attitude of an FRD body in NED."""
    return rotation.normalize(rotation.multiply(rotation.multiply(_Q_NED_ENU, q_ned_frd), _Q_FLU_FRD))


def covariance_frd_from_flu(covariance_flu: ArrayLike) -> FloatArray:
    """Return covariances (..., 3k, 3k), k = 1 or 2, of FRD vectors of covariances of stacked FLU vectors."""
    covariance = np.asarray(covariance_flu, dtype=np.float64)
    return np.multiply(covariance, _FLIPS[covariance.shape[-1]])
