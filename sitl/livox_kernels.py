"""Hot loop of the emulated Mid-360's stream: measured slots as bytes on the wire."""

import numpy as np

from companion.compiled import compiled
from companion.messages import ByteArray, FloatArray

_LOWEST, _HIGHEST = -(2.0**31), 2.0**31 - 1.0


@compiled("void(float64[:, ::1], uint8[::1], uint8[::1], int64, float64, uint8[:, ::1])")
def write_cartesian(
    points_lidar: FloatArray,
    reflectivity: ByteArray,
    tags: ByteArray,
    header_size: int,
    unit_m: float,
    packets: ByteArray,
) -> None:
    """Write slots into packets as three 32 bit integers, reflectivity and tag each, little-endian.

    Args:
        points_lidar: (n * k, 3) metres.
        reflectivity: (n * k,).
        tags: (n * k,).
        header_size: bytes before the first slot of a packet.
        unit_m: length that counts as one.
        packets: (n, header_size + 14 * k) out; headers stay as they are.
    """
    slots = (packets.shape[1] - header_size) // 14
    for i in range(points_lidar.shape[0]):
        packet, at = packets[i // slots], header_size + 14 * (i % slots)
        for axis in range(3):
            units = min(max(np.rint(points_lidar[i, axis] / unit_m), _LOWEST), _HIGHEST)
            number = np.int64(units)
            for byte in range(4):
                packet[at + 4 * axis + byte] = (number >> (8 * byte)) & 0xFF
        packet[at + 12], packet[at + 13] = reflectivity[i], tags[i]
