"""Points in pieces of any length, cut again into the scans that the driver would have cut."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from companion.clock import seconds_to_ns
from companion.drivers.livox_filter import PointFilter
from companion.drivers.livox_packets import PACKET_PERIOD_NS, SLOT_PERIOD_NS, DecodedPoints
from companion.drivers.livox_settings import LivoxSettings
from companion.messages import LidarScan
from companion.recordings.ros_messages import RosPoints

# A step back by more than this is a clock that jumped, not a message that came late.
_JUMP_NS = seconds_to_ns(0.5)


class ScanCutter:
    """Collects points by the period of sensor time in which they lie.

    Attributes:
        late: points dropped because their scan had already been handed out.
        overflowed: points dropped because a scan had more than twice the slots it should have.
        jumps: steps of the sensor's clock backwards.
    """

    def __init__(self, settings: LivoxSettings) -> None:
        """Cut as `settings` say."""
        self.late = 0
        self.overflowed = 0
        self.jumps = 0
        self._period_ns = settings.frame_period_ms * 1_000_000
        self._points_max = 2 * self._period_ns // SLOT_PERIOD_NS
        self._filter = PointFilter(settings)
        self._frame: int | None = None
        self._pieces: list[RosPoints] = []
        self._held = 0
        self._t_arrival_ns = 0
        self._scans = 0

    def add(self, t_ns: int, points: RosPoints, clock_offset_ns: int) -> list[LidarScan]:
        """Take one message's points and return the scans that they complete.

        Args:
            t_ns: when the message arrived.
            points: in any order of time.
            clock_offset_ns: host time minus the clock of the points.
        """
        if not len(points.t_ns):
            return []
        order = np.argsort(points.t_ns, kind="stable")
        frames = points.t_ns[order] // self._period_ns
        if self._frame is not None and (self._frame - int(frames[-1])) * self._period_ns > _JUMP_NS:
            self.jumps += 1
            self._frame, self._pieces, self._held = None, [], 0
        scans: list[LidarScan] = []
        bounds = [0, *(np.flatnonzero(np.diff(frames)) + 1).tolist(), len(frames)]
        for start, end in pairwise(bounds):
            frame = int(frames[start])
            if self._frame is not None and frame < self._frame:
                self.late += end - start
                continue
            if self._frame is not None and frame > self._frame:
                scans += self._close(clock_offset_ns)
            self._frame = frame
            self._t_arrival_ns = t_ns
            self._hold(points, order[start:end])
        t_last_ns = int(points.t_ns[order[-1]])
        if self._frame is not None and t_last_ns + SLOT_PERIOD_NS >= (self._frame + 1) * self._period_ns:
            scans += self._close(clock_offset_ns)
            self._frame += 1
        return scans

    def _hold(self, points: RosPoints, chosen: NDArray[np.intp]) -> None:
        room = self._points_max - self._held
        self.overflowed += max(0, len(chosen) - room)
        chosen = chosen[:room]
        self._held += len(chosen)
        self._pieces.append(
            RosPoints(
                points.t_ns[chosen],
                points.points_lidar[chosen],
                points.reflectivity[chosen],
                points.tags[chosen],
            )
        )

    def _close(self, clock_offset_ns: int) -> list[LidarScan]:
        pieces, self._pieces, self._held = self._pieces, [], 0
        if not pieces or self._frame is None:
            return []
        start_ns = self._frame * self._period_ns
        decoded = DecodedPoints(
            np.concatenate([piece.points_lidar for piece in pieces]),
            np.concatenate([piece.reflectivity for piece in pieces]),
            np.concatenate([piece.tags for piece in pieces]),
            np.concatenate([piece.t_ns for piece in pieces]) - start_ns,
        )
        with np.errstate(over="ignore", invalid="ignore"):
            kept = self._filter.keep(decoded, np.ones(len(decoded.t_ns), dtype=bool))
        offsets_ns = decoded.t_ns[kept].astype(np.int32)
        order = np.argsort(offsets_ns, kind="stable")
        kept, offsets_ns = kept[order], offsets_ns[order]
        self._scans += 1
        return [
            LidarScan(
                t_ns=self._t_arrival_ns,
                sequence=self._scans - 1,
                t_sensor_start_ns=start_ns,
                t_sensor_end_ns=start_ns + self._period_ns,
                clock_offset_ns=clock_offset_ns,
                points_lidar=decoded.points_lidar[kept],
                offsets_ns=offsets_ns,
                reflectivity=decoded.reflectivity[kept],
                tags=decoded.tags[kept],
                # Messages do not tell packets: each period of one that holds a point counts.
                packets=len(np.unique(decoded.t_ns // PACKET_PERIOD_NS)),
                packets_expected=-(-self._period_ns // PACKET_PERIOD_NS),
            )
        ]
