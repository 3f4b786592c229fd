"""Hot loop of the emulated Mid-360's stream: measured slots as bytes on the wire."""

import numpy as np

from companion.compiled import compiled
from companion.messages import ByteArray, FloatArray

COUNTER_AT = 7
STAMP_AT = 28
"""Where the header of a packet has its counter (16 bits) and its stamp (64 bits)."""

_LOWEST, _HIGHEST = -(2.0**31), 2.0**31 - 1.0


@compiled(
    "void(float64[:, ::1], uint8[::1], uint8[::1], uint8[::1], int64, int64, int64, float64, uint8[:, ::1])"
)
def write_cartesian(
    points_lidar: FloatArray,
    reflectivity: ByteArray,
    tags: ByteArray,
    header: ByteArray,
    counter: int,
    first_ns: int,
    period_ns: int,
    unit_m: float,
    packets: ByteArray,
) -> None:
    """Write slots into packets as three 32 bit integers, reflectivity and tag each, little-endian.

    Args:
        points_lidar: (n * k, 3) metres.
        reflectivity: (n * k,).
        tags: (n * k,).
        header: (h,) what all packets begin with; counter and stamp are written over it.
        counter: of the first packet.
        first_ns: stamp of the first packet.
        period_ns: from one stamp to the next.
        unit_m: length that counts as one.
        packets: (n, h + 14 * k) out; checksums are left to others.
    """
    header_size = header.shape[0]
    slots = (packets.shape[1] - header_size) // 14
    for n in range(packets.shape[0]):
        for at in range(header_size):
            packets[n, at] = header[at]
        for byte in range(2):
            packets[n, COUNTER_AT + byte] = ((counter + n) >> (8 * byte)) & 0xFF
        stamp_ns = first_ns + n * period_ns
        for byte in range(8):
            packets[n, STAMP_AT + byte] = (stamp_ns >> (8 * byte)) & 0xFF
    for i in range(points_lidar.shape[0]):
        packet, at = packets[i // slots], header_size + 14 * (i % slots)
        for axis in range(3):
            units = min(max(np.rint(points_lidar[i, axis] / unit_m), _LOWEST), _HIGHEST)
            number = np.int64(units)
            for byte in range(4):
                packet[at + 4 * axis + byte] = (number >> (8 * byte)) & 0xFF
        packet[at + 12], packet[at + 13] = reflectivity[i], tags[i]
