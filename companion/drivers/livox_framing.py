"""From datagrams of a Livox Mid-360 to inertial samples and scans cut by sensor time.

No sockets, no clock: each datagram carries its receive time. Nothing that arrives can make the receiver
raise or grow; whatever is wrong with a datagram is counted in `LivoxStatistics`.
"""

from dataclasses import dataclass

import numpy as np

from companion.drivers.livox_clock import ClockOffsetEstimator
from companion.drivers.livox_filter import PointFilter
from companion.drivers.livox_loss import Arrival, LossAccount
from companion.drivers.livox_packets import (
    IMU_PERIOD_NS,
    PACKET_PERIOD_NS,
    SLOT_PERIOD_NS,
    ChecksumError,
    DataType,
    DecodedPoints,
    PacketHeader,
    parse_header,
    parse_inertial,
)
from companion.drivers.livox_ring import PacketRing
from companion.drivers.livox_settings import LivoxSettings
from companion.errors import ProtocolError
from companion.messages import Datagram, ImuSample, LidarScan, SensorEvent


@dataclass(frozen=True, slots=True)
class LivoxStatistics:
    """What has been received since the start.

    Attributes:
        packets, imu_samples: accepted datagrams of either stream, without duplicates.
        lost, imu_lost: missing by counter or stamp.
        duplicates, reordered: of both streams.
        late: packets dropped because their frame (or a later sample) had already been handed out.
        overflowed: packets dropped because a frame had more than twice the packets it should have.
        crc_errors, malformed, wrong_source: datagrams dropped.
        jumps: discontinuities of stamps in either stream; clock_restarts: restarts of the sensor's clock.
        outages: gaps of more than half a second in the points.
        slots: point slots within emitted scans, of which no_return, too_near, too_far, low_confidence and
            self_masked were dropped and points were kept.
        time_type: the sensor's time source, -1 before the first packet.
        clock_offset_ns: host time minus sensor time.
        t_points_ns, t_imu_ns: host time of the last good packet, None before the first.
        kernel_drops: datagrams that the kernel dropped for want of buffer; known to the driver only.
    """

    packets: int = 0
    lost: int = 0
    imu_samples: int = 0
    imu_lost: int = 0
    duplicates: int = 0
    reordered: int = 0
    late: int = 0
    overflowed: int = 0
    crc_errors: int = 0
    malformed: int = 0
    wrong_source: int = 0
    jumps: int = 0
    clock_restarts: int = 0
    outages: int = 0
    scans: int = 0
    slots: int = 0
    no_return: int = 0
    too_near: int = 0
    too_far: int = 0
    low_confidence: int = 0
    self_masked: int = 0
    points: int = 0
    time_type: int = -1
    clock_offset_ns: int = 0
    clock_settled: bool = False
    t_points_ns: int | None = None
    t_imu_ns: int | None = None
    kernel_drops: int = 0


class LivoxReceiver:
    """Turns the two data streams of one sensor into events.

    A scan covers one period of sensor time, aligned to multiples of the period. It is handed out with
    the packet that ends it or, when that one is lost, with the first packet of a later frame.
    """

    def __init__(self, settings: LivoxSettings) -> None:
        """Allocate everything for `settings`."""
        self._point_source = (settings.lidar_ip, settings.lidar_ports.points)
        self._imu_source = (settings.lidar_ip, settings.lidar_ports.imu)
        self._period_ns = settings.frame_period_ms * 1_000_000
        self._ring = PacketRing(2 * (self._period_ns // PACKET_PERIOD_NS) + 16)
        self._filter = PointFilter(settings)
        self._clock = ClockOffsetEstimator()
        self._points = LossAccount(PACKET_PERIOD_NS)
        self._imu = LossAccount(IMU_PERIOD_NS)
        self._frame: int | None = None
        self._t_packet_ns = 0
        self._scans = 0
        self._crc_errors = 0
        self._malformed = 0
        self._wrong_source = 0
        self._late = 0
        self._overflowed = 0
        self._time_type = -1
        self._t_points_ns: int | None = None
        self._t_imu_ns: int | None = None

    def receive(self, datagram: Datagram) -> list[SensorEvent]:
        """Take one datagram and return the events that it completes; never raises."""
        return self.receive_payload(datagram.t_ns, datagram.source, datagram.payload)

    def receive_payload(
        self, t_ns: int, source: tuple[str, int], payload: bytes | memoryview
    ) -> list[SensorEvent]:
        """Take one datagram's parts, like `receive`; the payload is copied, so a buffer may be reused."""
        is_points = source == self._point_source
        if not is_points and source != self._imu_source:
            self._wrong_source += 1
            return []
        try:
            header = parse_header(payload)
            if is_points == (header.data_type == DataType.IMU):
                raise ProtocolError("data type and port disagree")
            if is_points:
                return self._receive_points(t_ns, header, payload)
            return self._receive_imu(t_ns, header, payload)
        except ChecksumError:
            self._crc_errors += 1
        except ProtocolError:
            self._malformed += 1
        return []

    @property
    def t_points_ns(self) -> int | None:
        """Host time of the last good point packet, None before the first."""
        return self._t_points_ns

    @property
    def t_imu_ns(self) -> int | None:
        """Host time of the last good inertial packet, None before the first."""
        return self._t_imu_ns

    def statistics(self) -> LivoxStatistics:
        """Return a snapshot of all counters; may be called from another thread."""
        points, imu, counts = self._points, self._imu, self._filter.counts
        return LivoxStatistics(
            packets=points.received,
            lost=points.lost,
            imu_samples=imu.received,
            imu_lost=imu.lost,
            duplicates=points.duplicates + imu.duplicates,
            reordered=points.reordered + imu.reordered,
            late=self._late,
            overflowed=self._overflowed,
            crc_errors=self._crc_errors,
            malformed=self._malformed,
            wrong_source=self._wrong_source,
            jumps=points.jumps + imu.jumps,
            clock_restarts=self._clock.restarts,
            outages=points.outages,
            scans=self._scans,
            slots=counts.slots,
            no_return=counts.no_return,
            too_near=counts.too_near,
            too_far=counts.too_far,
            low_confidence=counts.low_confidence,
            self_masked=counts.self_masked,
            points=counts.points,
            time_type=self._time_type,
            clock_offset_ns=self._clock.offset_ns,
            clock_settled=self._clock.settled,
            t_points_ns=self._t_points_ns,
            t_imu_ns=self._t_imu_ns,
        )

    def _observe(self, account: LossAccount, t_ns: int, header: PacketHeader) -> Arrival:
        """Account for a packet in one stream and in the clock that both streams share."""
        t_sent_ns = header.t_sensor_ns + header.span_ns
        self._clock.update(t_ns, t_sent_ns)
        lateness_ns = t_ns - t_sent_ns - self._clock.offset_ns
        arrival = account.observe(header.counter, header.t_sensor_ns, self._clock.restarts, lateness_ns)
        if arrival is Arrival.JUMP:
            self._clock.declare_restart(t_ns, t_sent_ns)
            account.epoch = self._clock.restarts
        return arrival

    def _receive_imu(self, t_ns: int, header: PacketHeader, payload: bytes | memoryview) -> list[SensorEvent]:
        gx, gy, gz, ax, ay, az = parse_inertial(payload)
        self._t_imu_ns = t_ns
        arrival = self._observe(self._imu, t_ns, header)
        if arrival is Arrival.DUPLICATE:
            return []
        if arrival is Arrival.LATE:
            self._late += 1
            return []
        return [ImuSample(t_ns, header.t_sensor_ns, np.array([gx, gy, gz]), np.array([ax, ay, az]))]

    def _receive_points(
        self, t_ns: int, header: PacketHeader, payload: bytes | memoryview
    ) -> list[SensorEvent]:
        self._t_points_ns = t_ns
        self._time_type = header.time_type
        arrival = self._observe(self._points, t_ns, header)
        if arrival is Arrival.DUPLICATE:
            return []
        events: list[SensorEvent] = []
        frame = header.t_sensor_ns // self._period_ns
        t_last_ns = header.t_sensor_ns + header.span_ns
        if self._frame is None:
            self._frame = frame
        elif arrival is Arrival.JUMP or frame > self._frame:
            events += self._close(self._frame)
            self._frame = frame
        elif t_last_ns < self._frame * self._period_ns:
            self._late += 1
            return []
        if not self._ring.add(header, payload):
            self._overflowed += 1
            return events
        self._t_packet_ns = t_ns
        t_end_ns = (self._frame + 1) * self._period_ns
        if t_last_ns + _slot_period_ns(header) >= t_end_ns:
            events += self._close(self._frame)
            self._frame += 1
            if t_last_ns >= t_end_ns:
                self._ring.add(header, payload)
        return events

    def _close(self, frame: int) -> list[SensorEvent]:
        """Decode the packets held into the scan number `frame`, and forget them."""
        if not len(self._ring):
            return []
        start_ns = frame * self._period_ns
        points = self._kept(start_ns)
        packets, expected = len(self._ring), self._expected_packets(start_ns)
        self._ring.clear()
        self._scans += 1
        return [
            LidarScan(
                t_ns=self._t_packet_ns,
                sequence=self._scans - 1,
                t_sensor_start_ns=start_ns,
                t_sensor_end_ns=start_ns + self._period_ns,
                clock_offset_ns=self._clock.offset_ns,
                points_lidar=points.points_lidar,
                offsets_ns=points.t_ns.astype(np.int32, copy=False),
                reflectivity=points.reflectivity,
                tags=points.tags,
                packets=packets,
                packets_expected=expected,
            )
        ]

    def _kept(self, start_ns: int) -> DecodedPoints:
        """Return the slots of the packets held that become points of the scan, by time after its start."""
        rows = self._ring.usual_rows
        if rows is not None:
            points = self._filter.keep_usual(rows, start_ns, self._period_ns)
        else:
            decoded = self._ring.decode(start_ns)
            inside = (decoded.t_ns >= 0) & (decoded.t_ns < self._period_ns)
            points = decoded.chosen(self._filter.keep(decoded, inside))
        if np.any(points.t_ns[1:] < points.t_ns[:-1]):
            points = points.chosen(np.argsort(points.t_ns, kind="stable"))
        return points

    def _expected_packets(self, start_ns: int) -> int:
        """Return how many packets with the phase and length of the first one touch the frame."""
        first = self._ring.first
        period_ns = first.slots * _slot_period_ns(first)
        before = (first.t_sensor_ns + first.span_ns - start_ns) // period_ns
        after = (start_ns + self._period_ns - 1 - first.t_sensor_ns) // period_ns
        return before + after + 1


def _slot_period_ns(header: PacketHeader) -> int:
    """Return the time from one slot of a packet to the next."""
    if header.slots < 2 or header.span_ns == 0:
        return SLOT_PERIOD_NS
    return max(1, header.span_ns // (header.slots - 1))
