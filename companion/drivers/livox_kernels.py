"""Hot loop of the Mid-360's receiver: packets as they usually come, to the points that are kept."""

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inlined
from companion.messages import ByteArray, PointArray

# Places in the counts of `keep_cartesian`; each slot is counted once.
INSIDE = 0
NO_RETURN = 1
TOO_NEAR = 2
TOO_FAR = 3
LOW_CONFIDENCE = 4
N_COUNTS = 5


@inlined
def _coordinate(packets: ByteArray, n: int, at: int) -> int:
    """Return a signed 32 bit integer, little-endian."""
    low = np.int32(packets[n, at]) | np.int32(packets[n, at + 1]) << np.int32(8)
    high = np.int32(packets[n, at + 2]) | np.int32(packets[n, at + 3]) << np.int32(8)
    return int(np.int32(low | high << np.int32(16)))


@compiled(
    "int64(uint8[:, ::1], int64, int64, int64, int64, int64, float64, float64, float64, boolean[::1],"
    " float32[:, ::1], int32[::1], uint8[::1], uint8[::1], int64[::1])"
)
def keep_cartesian(
    packets: ByteArray,
    header_size: int,
    slots: int,
    interval_unit_ns: int,
    base_ns: int,
    period_ns: int,
    unit_m: float,
    min_squared: float,
    max_squared: float,
    tag_is_kept: NDArray[np.bool_],
    points_lidar: PointArray,
    offsets_ns: NDArray[np.int32],
    reflectivity: ByteArray,
    tags: ByteArray,
    counts: NDArray[np.int64],
) -> int:
    """Decode checked packets of 32 bit Cartesian coordinates, and drop slots as `PointFilter` does.

    Args:
        packets: (n, size) their bytes, all with the same number of slots.
        header_size: bytes before the first slot.
        slots: in each packet.
        interval_unit_ns: unit of the time from the first to the last slot.
        base_ns: sensor time from which offsets count.
        period_ns: slots at `base_ns` or later by less than this are inside.
        unit_m: length that counts as one.
        min_squared: least squared distance, m^2.
        max_squared: largest squared distance, m^2.
        tag_is_kept: (256,) whether a slot with this tag is kept.
        points_lidar: (>= n * slots, 3) receives the points kept, metres.
        offsets_ns: (>= n * slots,) receives their times after `base_ns`.
        reflectivity: (>= n * slots,) receives what they reflect.
        tags: (>= n * slots,) receives their tags.
        counts: (N_COUNTS,) receives what became of the slots.

    Returns:
        The number of points kept.
    """
    counts[:] = 0
    unit, near, far = np.float32(unit_m), np.float32(min_squared), np.float32(max_squared)
    kept, last_span_ns = 0, np.int64(-1)
    after_ns = np.empty(slots, np.int64)
    for n in range(packets.shape[0]):
        span_ns = (np.int64(packets[n, 3]) | np.int64(packets[n, 4]) << 8) * interval_unit_ns
        stamp_ns = np.int64(0)
        for byte in range(8):
            stamp_ns |= np.int64(packets[n, 28 + byte]) << (8 * byte)
        if span_ns != last_span_ns:
            last_span_ns = span_ns
            for slot in range(slots):
                after_ns[slot] = slot * span_ns // max(slots - 1, 1)
        for slot in range(slots):
            t_ns = stamp_ns - base_ns + after_ns[slot]
            if t_ns < 0 or t_ns >= period_ns:
                continue
            counts[INSIDE] += 1
            at = header_size + 14 * slot
            x = np.float32(_coordinate(packets, n, at)) * unit
            y = np.float32(_coordinate(packets, n, at + 4)) * unit
            z = np.float32(_coordinate(packets, n, at + 8)) * unit
            squared = x * x + y * y + z * z
            if not squared > np.float32(0.0):
                counts[NO_RETURN] += 1
            elif squared < near:
                counts[TOO_NEAR] += 1
            elif squared > far:
                counts[TOO_FAR] += 1
            elif not tag_is_kept[packets[n, at + 13]]:
                counts[LOW_CONFIDENCE] += 1
            else:
                points_lidar[kept, 0], points_lidar[kept, 1], points_lidar[kept, 2] = x, y, z
                offsets_ns[kept] = t_ns
                reflectivity[kept], tags[kept] = packets[n, at + 12], packets[n, at + 13]
                kept += 1
    return kept
