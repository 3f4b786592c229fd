"""Own motion, and scans placed by it."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from companion.messages.arrays import ByteArray, FloatArray, PointArray


class OdometryStatus(IntEnum):
    """Health of the own-motion estimate."""

    INITIALISING = 0
    TRACKING = 1
    DEGRADED = 2
    LOST = 3


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Own motion at one instant.

    Attributes:
        t_ns: host time at which the state is valid (sensor time plus clock offset).
        p_map, q_map_body: pose of the body, (3,) m and (4,) unit quaternion (w, x, y, z).
        v_map: velocity of the body origin, (3,) m/s.
        omega_body: angular rate, (3,) rad/s.
        covariance_pose: (6, 6); position in map (m^2), then rotation in body (rad^2).
        covariance_velocity: (3, 3) in map (m^2/s^2).
        quality: 0 (do not use) to 100.
        reset_counter: grows by one whenever the map frame jumps.
        reason: why the status is not TRACKING; empty otherwise.
    """

    t_ns: int
    t_sensor_ns: int
    p_map: FloatArray
    q_map_body: FloatArray
    v_map: FloatArray
    omega_body: FloatArray
    covariance_pose: FloatArray
    covariance_velocity: FloatArray
    quality: int
    reset_counter: int
    status: OdometryStatus
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredScan:
    """One scan moved into the map by the odometry.

    Attributes:
        t_ns: host reception time of the scan's last packet.
        sequence: the scan's sequence number.
        points_map: (n, 3) de-skewed points, metres.
        reflectivity: (n,) as in `LidarScan`.
        odometry: pose at the scan's end.
        ages_ns: (n,) how long before the scan's end each point was measured; what moves by itself was
            elsewhere then.
    """

    t_ns: int
    sequence: int
    points_map: PointArray
    reflectivity: ByteArray
    odometry: Odometry
    ages_ns: NDArray[np.int32]
