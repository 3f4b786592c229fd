"""Data packets as the emulated Mid-360 sends them: measurement slots in, bytes out."""

import struct
import zlib
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from companion.drivers.livox_packets import (
    ANGLE_UNIT_RAD,
    HEADER_DTYPE,
    HEADER_SIZE,
    LENGTH_UNITS_M,
    POINT_DTYPES,
    STANDARD_GRAVITY_M_S2,
    TIME_INTERVAL_UNIT_NS,
    DataType,
)
from companion.messages import ByteArray, FloatArray
from sitl.array_layout import laid_out
from sitl.livox_kernels import write_cartesian
from sitl.slots import SLOT_PERIOD_NS, SLOTS_PER_PACKET, InertialSlot, PointSlots

TIME_INTERVAL = (SLOTS_PER_PACKET - 1) * SLOT_PERIOD_NS // TIME_INTERVAL_UNIT_NS
_CHECKED_FROM = 28
_HEAD = struct.Struct("<BHHHHBBB12xI")
_VALUES = struct.Struct("<6f")
_PACKET_DTYPES = {
    kind: np.dtype([("header", HEADER_DTYPE), ("points", points, (SLOTS_PER_PACKET,))])
    for kind, points in POINT_DTYPES.items()
}
_FULL_TURN = 36_000


def encode_points(
    slots: PointSlots, data_type: DataType, counter: int, time_type: int, clock_error_ns: int = 0
) -> list[bytes]:
    """Return the packets of a whole number of packets' slots.

    Args:
        slots: a multiple of 96 consecutive slots.
        data_type: one of the three point formats.
        counter: the packet counter of the first packet.
        time_type: the sensor's time source.
        clock_error_ns: added to every stamp.

    Raises:
        ValueError: if the number of slots is not a multiple of 96.
    """
    total = len(slots.points_lidar)
    if total % SLOTS_PER_PACKET:
        raise ValueError(f"{total} slots do not fill packets of {SLOTS_PER_PACKET}")
    n = total // SLOTS_PER_PACKET
    size = _PACKET_DTYPES[data_type].itemsize
    first_ns = slots.first_slot * SLOT_PERIOD_NS + clock_error_ns
    packets = np.zeros((n, size), np.uint8)
    fields = packets.view(_PACKET_DTYPES[data_type])[:, 0]
    head = _header(data_type, time_type)
    if data_type is DataType.CARTESIAN_32:
        write_cartesian(
            laid_out(slots.points_lidar), laid_out(slots.reflectivity, np.uint8),
            laid_out(slots.tags, np.uint8), head, counter, first_ns, SLOTS_PER_PACKET * SLOT_PERIOD_NS,
            LENGTH_UNITS_M[data_type], packets,
        )  # fmt: skip
    else:
        steps = np.arange(n, dtype=np.int64)
        packets[:, :HEADER_SIZE] = head
        fields["header"]["udp_cnt"] = (counter + steps) & 0xFFFF
        fields["header"]["timestamp"] = first_ns + steps * (SLOTS_PER_PACKET * SLOT_PERIOD_NS)
        points = fields["points"]
        _fill(points, slots.points_lidar.reshape(n, SLOTS_PER_PACKET, 3), data_type)
        points["reflectivity"] = slots.reflectivity.reshape(n, SLOTS_PER_PACKET)
        points["tag"] = slots.tags.reshape(n, SLOTS_PER_PACKET)
    checked = packets.reshape(-1).data
    starts = range(0, n * size, size)
    fields["header"]["crc32"] = [zlib.crc32(checked[at + _CHECKED_FROM : at + size]) for at in starts]
    content = packets.tobytes()
    return [content[at : at + size] for at in starts]


@lru_cache(maxsize=16)
def _header(data_type: DataType, time_type: int) -> ByteArray:
    """Return what the packets of one format begin with; all but counter, stamp and checksum."""
    header = np.zeros(1, HEADER_DTYPE)
    header["length"] = _PACKET_DTYPES[data_type].itemsize
    header["time_interval"] = TIME_INTERVAL
    header["dot_num"] = SLOTS_PER_PACKET
    header["data_type"] = data_type
    header["time_type"] = time_type
    return header.view(np.uint8)


def encode_inertial(slot: InertialSlot, counter: int, time_type: int, clock_error_ns: int = 0) -> bytes:
    """Return the packet of one inertial sample; the specific force leaves in units of g."""
    values = _VALUES.pack(*slot.gyro_imu.tolist(), *(slot.accel_imu / STANDARD_GRAVITY_M_S2).tolist())
    checked = struct.pack("<Q", (slot.t_sensor_ns + clock_error_ns) % (1 << 64)) + values
    head = _HEAD.pack(
        0, HEADER_SIZE + len(values), 0, 1, counter & 0xFFFF, 0, DataType.IMU, time_type, zlib.crc32(checked)
    )
    return head + checked


def _fill(points: NDArray[np.void], points_lidar: FloatArray, data_type: DataType) -> None:
    """Write coordinates (..., 3) in metres into raw points of one format."""
    unit_m = LENGTH_UNITS_M[data_type]
    if data_type is not DataType.SPHERICAL:
        limits = np.iinfo(points["xyz"].dtype)
        points["xyz"] = np.clip(np.rint(points_lidar / unit_m), limits.min, limits.max)
        return
    depth_m = np.linalg.norm(points_lidar, axis=-1)
    returned = depth_m > 0.0
    cosine = np.divide(points_lidar[..., 2], depth_m, out=np.ones_like(depth_m), where=returned)
    theta = np.arccos(np.clip(cosine, -1.0, 1.0)) * returned
    phi = np.arctan2(points_lidar[..., 1], points_lidar[..., 0]) * returned
    points["depth"] = np.rint(depth_m / unit_m)
    points["theta"] = np.rint(theta / ANGLE_UNIT_RAD)
    points["phi"] = np.rint(phi / ANGLE_UNIT_RAD) % _FULL_TURN
