"""What arrives: datagrams, MAVLink messages, samples, scans, and odometry of another process."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.messages.arrays import ByteArray, FloatArray, PointArray


class Datagram(NamedTuple):
    """One UDP datagram: what a socket received or is to send; a named tuple, for thousands come a second.

    `t_ns` is the host time of reception, or of sending as decided by the sender.
    """

    t_ns: int
    source: tuple[str, int]
    destination: tuple[str, int]
    payload: bytes


@dataclass(frozen=True, slots=True)
class MavlinkMessage:
    """One MAVLink message with its fields by name (arrays as lists, strings without NUL padding)."""

    name: str
    system_id: int
    component_id: int
    fields: dict[str, object]


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """One inertial measurement in the IMU frame.

    Attributes:
        gyro_imu: angular rate, shape (3,), rad/s.
        accel_imu: specific force, shape (3,), m/s^2 (about +9.81 on z at rest, upright).
    """

    t_ns: int
    t_sensor_ns: int
    gyro_imu: FloatArray
    accel_imu: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LidarScan:
    """The returns of one frame cut by sensor time; slots without return are already dropped.

    Attributes:
        t_ns: host reception time of the last packet.
        t_sensor_start_ns, t_sensor_end_ns: limits of the frame.
        clock_offset_ns: host time minus sensor time, as estimated now.
        points_lidar: shape (n, 3), metres, not de-skewed, in firing order.
        offsets_ns: shape (n,), int32, time of each point after `t_sensor_start_ns`.
        reflectivity: shape (n,), 0-150 diffuse, 151-255 retro-reflective.
        tags: shape (n,), the sensor's confidence bits.
        packets, packets_expected: completeness of the frame.
    """

    t_ns: int
    sequence: int
    t_sensor_start_ns: int
    t_sensor_end_ns: int
    clock_offset_ns: int
    points_lidar: PointArray
    offsets_ns: NDArray[np.int32]
    reflectivity: ByteArray
    tags: ByteArray
    packets: int
    packets_expected: int


@dataclass(frozen=True, slots=True, eq=False)
class ExternalOdometry:
    """Own motion as another process on this computer estimates it, checked and turned into our frames.

    Attributes:
        t_ns: host time of reception.
        t_source_ns: when the state was valid, on the sender's clock.
        clock_offset_ns: host time minus the sender's clock, as estimated now.
        on_lidar_clock: the sender's clock is the LiDAR's own, so `t_source_ns` is sensor time.
        session: grows by one whenever another sender, or the same one with another clock, begins.
        p_map, q_map_body: pose of the body in the sender's frame with z up, (3,) m and (4,) (w, x, y, z).
        v_map: velocity of the body origin, (3,) m/s; not a number when the sender states none.
        omega_body: angular rate, (3,) rad/s; not a number when the sender states none.
        covariance_pose: (6, 6); position in map (m^2), then rotation in body (rad^2).
        covariance_velocity: (3, 3) in map (m^2/s^2).
        quality: -1 failed, 0 not stated, else 1 to 100.
        reset_counter: the sender's own, 0 to 255.
    """

    t_ns: int
    t_source_ns: int
    clock_offset_ns: int
    on_lidar_clock: bool
    session: int
    p_map: FloatArray
    q_map_body: FloatArray
    v_map: FloatArray
    omega_body: FloatArray
    covariance_pose: FloatArray
    covariance_velocity: FloatArray
    quality: int
    reset_counter: int

    @property
    def t_valid_ns(self) -> int:
        """Host time at which the state was valid."""
        return self.t_source_ns + self.clock_offset_ns
