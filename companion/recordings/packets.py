"""Recordings that hold the sensor's own datagrams: they pass through the receiver that flies."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from companion.drivers.livox_framing import LivoxReceiver, LivoxStatistics
from companion.drivers.livox_settings import LivoxSettings
from companion.errors import LogError
from companion.messages import Datagram, SensorEvent
from companion.recordings.recording import EventTally, RecordingSummary

SURVEYED_DATAGRAMS = 5_000
"""Data packets read to learn which sensors a recording holds: two seconds of one sensor."""

_NO_IMU = "the recording has no inertial samples: scans only"
_DROPPED = {
    "duplicates": "duplicates",
    "late": "late packets",
    "crc_errors": "packets with a wrong checksum",
    "malformed": "malformed packets",
    "overflowed": "packets too many for their scan",
}


class PacketSource(Protocol):
    """A file with datagrams in it.

    Attributes:
        kind: the format's name.
        skipped: what the last pass left out, by reason.
        notes: what the last pass has to say about the file, one sentence each.
    """

    kind: str
    skipped: Counter[str]
    notes: list[str]

    def datagrams(self) -> Iterator[Datagram]:
        """Yield all UDP datagrams from the beginning; `skipped` and `notes` start anew.

        Raises:
            LogError: where the file is cut or damaged, after everything before that was yielded.
            OSError: if reading the disk fails.
        """
        ...


class PacketRecording:
    """The datagrams of one sensor in a file."""

    def __init__(self, path: Path, source: PacketSource, lidar: LivoxSettings) -> None:
        """Find out which sensor to read.

        Raises:
            LogError: if there is no sensor's data, or several sensors and none is the configured one.
            OSError: if reading the disk fails.
        """
        self._path = path
        self._source = source
        self._data_ports = (lidar.lidar_ports.points, lidar.lidar_ports.imu)
        self._lidar_ip = self._chosen(lidar.lidar_ip)
        self._settings = lidar.model_copy(update={"lidar_ip": self._lidar_ip})
        self._summary: RecordingSummary | None = None

    @property
    def kind(self) -> str:
        """The format."""
        return self._source.kind

    @property
    def lidar_ip(self) -> str:
        """Address of the sensor that is read."""
        return self._lidar_ip

    def datagrams(self) -> Iterator[Datagram]:
        """Yield the sensor's data packets as they arrived, from the beginning.

        Raises:
            LogError: where the file is cut or damaged, after everything before that was yielded.
            OSError: if reading the disk fails.
        """
        for datagram in self._source.datagrams():
            if datagram.source[0] == self._lidar_ip and datagram.source[1] in self._data_ports:
                yield datagram

    def events(self) -> Iterator[SensorEvent]:
        """Yield samples and scans in the order in which they arrived.

        Raises:
            OSError: if reading the disk fails.
        """
        receiver = LivoxReceiver(self._settings)
        tally = EventTally()
        skipped: Counter[str] = Counter()
        ending = ""
        try:
            for datagram in self._source.datagrams():
                ip, port = datagram.source
                if port not in self._data_ports:
                    skipped["other packets"] += 1
                elif ip != self._lidar_ip:
                    skipped[f"packets of the sensor {ip}"] += 1
                else:
                    for event in receiver.receive(datagram):
                        tally.count(event)
                        yield event
        except LogError as error:
            ending = f"the recording ends early: {error}"
        self._summary = self._account(receiver.statistics(), tally, skipped, ending)

    def summary(self) -> RecordingSummary:
        """Return what the last complete pass over the events found; makes one if there was none."""
        if self._summary is None:
            for _ in self.events():
                pass
        assert self._summary is not None
        return self._summary

    def _chosen(self, lidar_ip: str) -> str:
        """Return the configured sensor's address if the file holds it, otherwise the only one's."""
        found: Counter[str] = Counter()
        others = 0
        try:
            for datagram in self._source.datagrams():
                if datagram.source[1] not in self._data_ports:
                    others += 1
                    continue
                found[datagram.source[0]] += 1
                if found.total() >= SURVEYED_DATAGRAMS:
                    break
        except LogError:
            # What precedes the damage is worth reading; the events will end there too.
            if not found:
                raise
        if not found:
            points, imu = self._data_ports
            raise LogError(
                f"{self._path}: no data of a Mid-360: {others} packets, none of them from port {points} "
                f"or {imu}"
            )
        if lidar_ip in found or len(found) == 1:
            return lidar_ip if lidar_ip in found else next(iter(found))
        raise LogError(
            f"{self._path}: holds the sensors {', '.join(sorted(found))}, but not lidar_ip {lidar_ip}: "
            "set it to one of them"
        )

    def _account(
        self, statistics: LivoxStatistics, tally: EventTally, skipped: Counter[str], ending: str
    ) -> RecordingSummary:
        total = self._source.skipped + skipped
        for field, words in _DROPPED.items():
            total[words] += getattr(statistics, field)
        notes = list(self._source.notes)
        if not tally.imu_samples:
            notes.append(_NO_IMU)
        if ending:
            notes.append(ending)
        return RecordingSummary(
            kind=self.kind,
            sensor=self._lidar_ip,
            duration_s=tally.duration_s,
            scans=tally.scans,
            points=tally.points,
            imu_samples=tally.imu_samples,
            lost=statistics.lost + statistics.imu_lost,
            complete=not ending,
            skipped={what: count for what, count in sorted(total.items()) if count},
            notes=tuple(notes),
        )
