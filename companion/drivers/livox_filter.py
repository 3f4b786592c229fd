"""Which slots of a scan become points: everything that is dropped is dropped here, and counted."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.drivers import livox_kernels as kernels
from companion.drivers.livox_packets import (
    HEADER_SIZE,
    LENGTH_UNITS_M,
    MAX_SLOTS_PER_PACKET,
    TIME_INTERVAL_UNIT_NS,
    DataType,
    DecodedPoints,
)
from companion.drivers.livox_settings import LivoxSettings, TagPolicy
from companion.messages import ByteArray, PointArray

LOW_CONFIDENCE = 2
_TAG_FIELD_SHIFTS = (0, 2, 4)


@dataclass(slots=True)
class FilterCounts:
    """How many slots there were and what became of them; each is counted once."""

    slots: int = 0
    no_return: int = 0
    too_near: int = 0
    too_far: int = 0
    low_confidence: int = 0
    self_masked: int = 0
    points: int = 0


class PointFilter:
    """Drops slots without return, out of range, of low confidence, and on the vehicle itself."""

    def __init__(self, settings: LivoxSettings) -> None:
        """Prepare tables for `settings`."""
        self.counts = FilterCounts()
        self._min_squared = np.float32(settings.min_range_m**2)
        self._max_squared = np.float32(settings.max_range_m**2)
        self._tag_is_kept = kept_tags(settings.tag_policy)
        self._keeps_all_tags = bool(self._tag_is_kept.all())
        boxes = [
            ((box.x_min_m, box.y_min_m, box.z_min_m), (box.x_max_m, box.y_max_m, box.z_max_m))
            for box in settings.self_mask
        ]
        self._boxes = np.array(boxes, dtype=np.float32).reshape(-1, 2, 3)
        farthest = np.abs(self._boxes).max(axis=1, initial=0.0)
        self._reach_squared = np.float32((farthest**2).sum(axis=-1).max(initial=0.0) * 1.001)

    def keep(self, decoded: DecodedPoints, inside: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return the indices of the slots that become points, in order.

        Args:
            decoded: slots of a scan.
            inside: (n,) which of them lie within the scan's time.
        """
        counts = self.counts
        points = decoded.points_lidar
        squared = np.einsum("ij,ij->i", points, points)
        total = int(np.count_nonzero(inside))
        returned = inside & (squared > 0.0)
        n_returned = int(np.count_nonzero(returned))
        far_enough = returned & (squared >= self._min_squared)
        n_far_enough = int(np.count_nonzero(far_enough))
        indices = np.flatnonzero(far_enough & (squared <= self._max_squared))
        counts.slots += total
        counts.no_return += total - n_returned
        counts.too_near += n_returned - n_far_enough
        counts.too_far += n_far_enough - indices.size
        if not self._keeps_all_tags:
            n_before = indices.size
            indices = indices[self._tag_is_kept[decoded.tags[indices]]]
            counts.low_confidence += n_before - indices.size
        if self._boxes.size:
            n_before = indices.size
            indices = self._outside_boxes(points, squared, indices)
            counts.self_masked += n_before - indices.size
        counts.points += indices.size
        return indices

    def keep_usual(self, packets: ByteArray, base_ns: int, period_ns: int) -> DecodedPoints:
        """Decode the slots that become points, as `decode_points` and `keep` do but in one go.

        Args:
            packets: (n, MAX_PACKET_SIZE) checked packets, each of 96 slots of 32 bit coordinates.
            base_ns: sensor time from which slot times count.
            period_ns: slots of a scan lie within this time of it.
        """
        counts, most = self.counts, len(packets) * MAX_SLOTS_PER_PACKET
        points, t_ns = np.empty((most, 3), np.float32), np.empty(most, np.int32)
        reflectivity, tags = np.empty(most, np.uint8), np.empty(most, np.uint8)
        became = np.empty(kernels.N_COUNTS, np.int64)
        n = kernels.keep_cartesian(
            packets, HEADER_SIZE, MAX_SLOTS_PER_PACKET, TIME_INTERVAL_UNIT_NS, base_ns, period_ns,
            LENGTH_UNITS_M[DataType.CARTESIAN_32], float(self._min_squared), float(self._max_squared),
            self._tag_is_kept, points, t_ns, reflectivity, tags, became,
        )  # fmt: skip
        counts.slots += int(became[kernels.INSIDE])
        counts.no_return += int(became[kernels.NO_RETURN])
        counts.too_near += int(became[kernels.TOO_NEAR])
        counts.too_far += int(became[kernels.TOO_FAR])
        counts.low_confidence += int(became[kernels.LOW_CONFIDENCE])
        kept: slice | NDArray[np.intp] = slice(n)
        if self._boxes.size:
            squared = np.einsum("ij,ij->i", points[:n], points[:n])
            kept = self._outside_boxes(points, squared, np.arange(n))
            counts.self_masked += n - kept.size
            n = kept.size
        counts.points += n
        return DecodedPoints(points, reflectivity, tags, t_ns).chosen(kept)

    def _outside_boxes(
        self, points: PointArray, squared: NDArray[np.float32], indices: NDArray[np.intp]
    ) -> NDArray[np.intp]:
        near = np.flatnonzero(squared[indices] <= self._reach_squared)
        candidates = points[indices[near]]
        masked = np.zeros(near.size, dtype=bool)
        for lowest, highest in self._boxes:
            masked |= np.all((candidates >= lowest) & (candidates <= highest), axis=1)
        return np.delete(indices, near[masked])


def kept_tags(policy: TagPolicy) -> NDArray[np.bool_]:
    """Return for each of the 256 tag bytes whether a point with it is kept.

    Bits 0-1, 2-3 and 4-5 rate the confidence against glue between objects, against rain, fog or dust,
    and otherwise: 0 high, 1 medium, 2 low, 3 reserved.
    """
    tags = np.arange(256)
    fields = np.stack([tags >> shift & 3 for shift in _TAG_FIELD_SHIFTS])
    if policy == "all":
        return np.ones(256, dtype=bool)
    allowed = LOW_CONFIDENCE if policy == "not_low" else 1
    return np.asarray((fields < allowed).all(axis=0))
