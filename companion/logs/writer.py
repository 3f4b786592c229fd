"""Records a flight: control hands messages over and never waits for the disk."""

import threading
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import structlog
from pydantic import Field

from companion.clock import Clock, SystemClock
from companion.logs import channels
from companion.logs.channels import Channel
from companion.logs.log_file import FLUSH_PERIOD_NS, LogFile, LogState
from companion.logs.log_queue import LogEntry, LogQueue
from companion.logs.metadata import FlightMetadata
from companion.logs.records import CloudView, Statistics
from companion.logs.views import CloudSampler, OdometrySampler, Recordable, views_of
from companion.messages import Datagram, Odometry, RegisteredScan
from companion.settings import Settings

_MIB = 1024 * 1024
_SMALL_MESSAGE_BYTES = 1024
_WAKE_PERIOD_S = 0.02
_CLOSE_PATIENCE_S = 10.0
_DATAGRAMS_PER_BATCH_MAX = 512

_log = structlog.get_logger(__name__)


class LogSettings(Settings):
    """What is recorded, and how much memory and disk it may take."""

    raw_lidar: bool = True
    """Record every LiDAR datagram (about 3 MB/s), from which everything else can be computed again."""
    clouds: bool = True
    """Record thinned registered clouds for viewing and reports."""
    imu: bool = False
    """Record decoded IMU samples; the raw LiDAR datagrams already contain them."""
    mavlink: bool = True
    """Record every MAVLink message sent and received; a log without them cannot be replayed."""
    surroundings: bool = True
    """Record neighbours and obstacle grid as a follower's law was given them (about 10 kB/s)."""
    odometry_hz: float | None = Field(default=None, gt=0.0, le=1000.0)
    """Largest number of recorded odometry estimates per second, where all are too much; a change of their
    status is always recorded. A log that leaves some out cannot be replayed."""
    cloud_points: int = Field(default=2000, ge=100, le=20_000)
    """Largest number of points in a recorded cloud."""
    cloud_rate_hz: float = Field(default=5.0, gt=0.0, le=20.0)
    """Largest number of recorded clouds per second."""
    batch_ms: float = Field(default=20.0, ge=1.0, le=100.0)
    """Raw datagrams of this span are stored as one message."""
    chunk_kib: int = Field(default=64, ge=16, le=1024)
    """Size of a compressed chunk before compression."""
    compression_level: int = Field(default=1, ge=1, le=9)
    """Zstandard level; higher is smaller and slower."""
    queue_mib: int = Field(default=32, ge=1, le=512)
    """Memory for messages that wait for the disk; bulk data may use half of it."""
    disk_reserve_mib: int = Field(default=512, ge=0, le=1_000_000)
    """Below this free space bulk data is no longer recorded."""


@dataclass(frozen=True, slots=True)
class LogStatus:
    """How the recording goes.

    Attributes:
        state: whether messages reach the disk.
        reason: why they do not, or why some are left out; empty if all is well.
        written: messages in the file.
        bytes_on_disk: size of the file.
        waiting_bytes: about how much waits for the disk.
        dropped_bulk: raw data and clouds left out because the disk was slow or nearly full.
        dropped: other messages left out because the disk was slow.
        refused: messages that came after the recording had failed or ended.
        unencodable: messages that did not fit their channel.
    """

    state: LogState
    reason: str
    written: int
    bytes_on_disk: int
    waiting_bytes: int
    dropped_bulk: int
    dropped: int
    refused: int
    unencodable: int

    def statistics(self, t_ns: int) -> Statistics:
        """Return the counters as a log message."""
        names = ("written", "bytes_on_disk", "waiting_bytes", "dropped_bulk", "dropped", "refused")
        values: dict[str, int | float] = {name: getattr(self, name) for name in names}
        return Statistics(t_ns, "log", values | {"unencodable": self.unencodable})


class FlightLog:
    """The log of one flight.

    Threaded, for real flights: messages wait in a bounded queue for one writer thread; the file is
    brought to the disk every second of host time. Otherwise, for lockstep: messages are written at once
    and flushed by their own time, so equal messages give equal bytes.

    A disk that is full, read-only or missing ends the recording, not the flight: see `status`.
    Any thread may record. Messages handed over must not be changed afterwards.
    """

    def __init__(
        self,
        path: Path,
        settings: LogSettings,
        metadata: FlightMetadata,
        *,
        threaded: bool,
        clock: Clock | None = None,
    ) -> None:
        """Create ``<path>.open``, to be renamed to ``<path>`` by `close`.

        Args:
            path: name of the log, ending in ``.mcap``; an existing file is never overwritten.
            settings: what to record.
            metadata: what is true of the whole flight.
            threaded: write from a thread of its own.
            clock: when the writer thread syncs; the host's clock if not given.
        """
        self._settings = settings
        self._clock = clock or SystemClock()
        self._off = {
            channel.topic
            for channel, on in (
                (channels.LIDAR_PACKETS, settings.raw_lidar),
                (channels.CLOUD, settings.clouds),
                (channels.IMU, settings.imu),
                (channels.MAVLINK_RX, settings.mavlink),
                (channels.MAVLINK_TX, settings.mavlink),
                (channels.GIVEN, settings.surroundings),
                (channels.GRID, settings.surroundings),
            )
            if not on
        }
        self._sequences: defaultdict[str, int] = defaultdict(int)
        # Datagrams come from the LiDAR's thread, events from the one that decides.
        self._lock = threading.RLock()
        self._batch: list[Datagram] = []
        self._batch_span_ns = round(settings.batch_ms * 1e6)
        self._clouds = CloudSampler(settings.cloud_rate_hz, settings.cloud_points)
        self._odometry = OdometrySampler(settings.odometry_hz)
        self._flushed_ns: int | None = None
        self._disk_low = False
        self._unencodable = 0
        self._path = path
        self._queue = LogQueue(settings.queue_mib * _MIB)
        self._file = LogFile(
            path,
            metadata,
            chunk_bytes=settings.chunk_kib * 1024,
            compression_level=settings.compression_level,
            durable=threaded,
        )
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        if threaded:
            self._thread = threading.Thread(target=self._run, name="flight-log", daemon=True)
            self._thread.start()

    @property
    def path(self) -> Path:
        """Name of the log once it is closed."""
        return self._path

    def record(self, message: Recordable | Datagram, t_ns: int) -> None:
        """Record a message on the channels where its kind belongs.

        Control events are to be recorded in the order in which they are handled. A MAVLink message has
        a direction: use `write` with its channel.

        Args:
            message: a control event, an output, a datagram of the LiDAR, statistics.
            t_ns: host time at which it is handled.

        Raises:
            TypeError: if there is no channel for this kind of message.
        """
        if isinstance(message, Datagram):
            self._add_to_batch(message, t_ns)
            return
        if isinstance(message, Odometry) and not self._odometry.takes(message, t_ns):
            return
        for channel, view in views_of(message):
            self.write(channel, view, t_ns)
        if isinstance(message, RegisteredScan) and channels.CLOUD.topic not in self._off:
            cloud = self._clouds.take(message, t_ns)
            if cloud is not None:
                self.write(channels.CLOUD, cloud, t_ns)

    def write(self, channel: Channel, message: object, t_ns: int) -> None:
        """Record a message on one channel.

        Args:
            channel: where; channels that the settings leave out are skipped.
            message: of the channel's message type.
            t_ns: host time at which it is handled.

        Raises:
            TypeError, ValueError, AttributeError: if it does not fit the channel (a threaded log counts
                such messages instead).
        """
        if channel.topic in self._off and not channel.journal:
            return
        with self._lock:
            if channel.journal:
                # Raw data that came before an event stands before it in the file.
                self._end_batch(t_ns)
            if channel.topic not in self._off:
                self._hand_over(channel, message, t_ns)

    def status(self) -> LogStatus:
        """Return how the recording goes."""
        reason = self._file.reason
        if not reason and self._disk_low:
            reason = "disk nearly full: raw data and clouds are left out"
        return LogStatus(
            self._file.state,
            reason,
            self._file.written,
            self._file.size,
            self._queue.waiting_bytes,
            self._queue.dropped_bulk,
            self._queue.dropped,
            self._file.refused,
            self._unencodable,
        )

    def close(self) -> None:
        """Write what waits, complete the file and rename it; safe to call twice."""
        with self._lock:
            if self._batch:
                self._end_batch(self._batch[-1].t_ns)
        if self._thread is None:
            self._file.close()
            return
        self._stop.set()
        self._thread.join(_CLOSE_PATIENCE_S)
        if self._thread.is_alive():
            _log.error("the disk does not answer; the log stays unfinished")

    def _add_to_batch(self, datagram: Datagram, t_ns: int) -> None:
        if channels.LIDAR_PACKETS.topic in self._off:
            return
        with self._lock:
            self._batch.append(datagram)
            span_ns = t_ns - self._batch[0].t_ns
            if span_ns >= self._batch_span_ns or len(self._batch) >= _DATAGRAMS_PER_BATCH_MAX:
                self._end_batch(t_ns)

    def _end_batch(self, t_ns: int) -> None:
        if self._batch:
            batch, self._batch = tuple(self._batch), []
            self._hand_over(channels.LIDAR_PACKETS, batch, t_ns)

    def _hand_over(self, channel: Channel, message: object, t_ns: int) -> None:
        sequence = self._sequences[channel.topic]
        self._sequences[channel.topic] = sequence + 1
        entry = LogEntry(channel, t_ns, sequence, message)
        if self._thread is not None:
            if self._disk_low and channel.bulk:
                self._queue.dropped_bulk += 1
            else:
                self._queue.offer(entry, _size_of(message))
            return
        self._file.append(entry)
        if self._flushed_ns is None:
            self._flushed_ns = t_ns
        elif t_ns - self._flushed_ns >= FLUSH_PERIOD_NS:
            self._flushed_ns = t_ns
            self._file.sync()

    def _run(self) -> None:
        synced_ns = self._clock.now_ns()
        while True:
            stopping = self._stop.wait(_WAKE_PERIOD_S)
            while (entry := self._queue.take()) is not None:
                self._append(entry)
            now_ns = self._clock.now_ns()
            if now_ns - synced_ns >= FLUSH_PERIOD_NS:
                synced_ns = now_ns
                self._file.sync()
                free = self._file.free_bytes
                self._disk_low = free is not None and free < self._settings.disk_reserve_mib * _MIB
            if stopping:
                self._file.close()
                return

    def _append(self, entry: LogEntry) -> None:
        try:
            self._file.append(entry)
        except Exception as error:
            # One message that does not fit must not end the recording of all others.
            if self._unencodable == 0:
                _log.error("a message does not fit its channel", topic=entry.channel.topic, error=repr(error))
            self._unencodable += 1


def _size_of(message: object) -> int:
    if isinstance(message, tuple):
        return sum(len(datagram.payload) for datagram in message)
    if isinstance(message, CloudView):
        return int(np.asarray(message.points_map).nbytes)
    return _SMALL_MESSAGE_BYTES
