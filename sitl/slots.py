"""What the simulated scanner measured, between the sensor model and the protocol emulator."""

from dataclasses import dataclass

from companion.messages import ByteArray, FloatArray

SLOT_PERIOD_NS = 5_000
SLOTS_PER_PACKET = 96


@dataclass(frozen=True, slots=True, eq=False)
class PointSlots:
    """Consecutive measurement slots of one sensor.

    Attributes:
        first_slot: index of the first slot since power-on; slot n fires at n * 5 us of sensor time.
        points_lidar: (n, 3) metres, all zero where nothing returned.
        reflectivity: (n,) 0-150 diffuse, 151-255 retro-reflective.
        tags: (n,) the sensor's confidence bits.
    """

    first_slot: int
    points_lidar: FloatArray
    reflectivity: ByteArray
    tags: ByteArray


@dataclass(frozen=True, slots=True, eq=False)
class InertialSlot:
    """One inertial measurement as the sensor reports it.

    Attributes:
        t_sensor_ns: sensor time of the sample.
        gyro_imu: (3,) rad/s.
        accel_imu: (3,) m/s^2; the protocol carries it in units of g.
    """

    t_sensor_ns: int
    gyro_imu: FloatArray
    accel_imu: FloatArray
