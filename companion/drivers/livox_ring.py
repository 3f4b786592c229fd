"""Raw point packets of the frame being received, in memory allocated once."""

import numpy as np

from companion.drivers.livox_packets import (
    MAX_PACKET_SIZE,
    MAX_SLOTS_PER_PACKET,
    DataType,
    DecodedPoints,
    PacketHeader,
    decode_points,
)
from companion.messages import ByteArray


class PacketRing:
    """Rows for the packets of one frame; decoding happens once, when the frame is complete."""

    def __init__(self, capacity: int) -> None:
        """Allocate `capacity` rows of one packet each."""
        self._rows = np.zeros((capacity, MAX_PACKET_SIZE), dtype=np.uint8)
        self._views = [row.data for row in self._rows]
        self._headers: list[PacketHeader] = []
        self._sorted = True

    def __len__(self) -> int:
        """Return the number of packets held."""
        return len(self._headers)

    @property
    def first(self) -> PacketHeader:
        """Header of the packet added first."""
        return self._headers[0]

    def add(self, header: PacketHeader, payload: bytes | memoryview) -> bool:
        """Copy a checked packet into the next row; return False if all rows are taken."""
        index = len(self._headers)
        if index == len(self._views):
            return False
        self._views[index][: header.length] = payload
        if index and header.t_sensor_ns < self._headers[-1].t_sensor_ns:
            self._sorted = False
        self._headers.append(header)
        return True

    @property
    def usual_rows(self) -> ByteArray | None:
        """All packets (n, MAX_PACKET_SIZE) if full, of 32 bit coordinates and in order; else None."""
        usual = (DataType.CARTESIAN_32, MAX_SLOTS_PER_PACKET)
        if not self._sorted or any((header.data_type, header.slots) != usual for header in self._headers):
            return None
        return self._rows[: len(self._headers)]

    def clear(self) -> None:
        """Forget all packets."""
        self._headers.clear()
        self._sorted = True

    def decode(self, base_ns: int) -> DecodedPoints:
        """Return all slots in the order of their packets' stamps, times counted from `base_ns`.

        Packets of one shape next to each other are decoded together, which is one run for a whole
        frame unless the sensor was told another format in between.

        Raises:
            ValueError: if there is no packet.
        """
        rows = self._rows[: len(self._headers)]
        headers = self._headers
        if not self._sorted:
            order = sorted(range(len(headers)), key=lambda index: headers[index].t_sensor_ns)
            rows = rows[order]
            headers = [headers[index] for index in order]
        runs: list[DecodedPoints] = []
        start = 0
        for end in range(1, len(headers) + 1):
            shape = (headers[start].data_type, headers[start].slots)
            if end == len(headers) or (headers[end].data_type, headers[end].slots) != shape:
                runs.append(decode_points(rows[start:end, : headers[start].length], base_ns))
                start = end
        if len(runs) == 1:
            return runs[0]
        return DecodedPoints(
            np.concatenate([run.points_lidar for run in runs]),
            np.concatenate([run.reflectivity for run in runs]),
            np.concatenate([run.tags for run in runs]),
            np.concatenate([run.t_ns for run in runs]),
        )
