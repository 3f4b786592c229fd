"""What every recording offers, whatever its format: sensor events, and an account of the file."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from companion.clock import ns_to_seconds
from companion.errors import LogError
from companion.messages import ImuSample, LidarScan, SensorEvent


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """What one pass over a recording found.

    Attributes:
        kind: the format, such as "pcap" or "ROS 1 bag".
        sensor: address of the sensor, or names of the topics.
        duration_s: between the first and the last event, in time of arrival.
        lost: packets and samples that the sensor sent and the file does not hold, as far as it shows.
        complete: the file could be read to its end.
        skipped: what was left out and how often, by reason.
        notes: one sentence each: what was assumed, converted or is missing.
    """

    kind: str
    sensor: str
    duration_s: float
    scans: int
    points: int
    imu_samples: int
    lost: int
    complete: bool
    skipped: dict[str, int]
    notes: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the account as lines of text for people."""
        lines = [
            f"{self.kind}, {self.sensor}: {self.duration_s:.1f} s, {self.scans} scans, {self.points} points, "
            f"{self.imu_samples} inertial samples, {self.lost} lost"
        ]
        if self.skipped:
            lines.append("skipped: " + ", ".join(f"{count} {what}" for what, count in self.skipped.items()))
        return lines + list(self.notes)


class Recording(Protocol):
    """One recording of one sensor."""

    @property
    def kind(self) -> str:
        """The format, such as "pcap" or "ROS 1 bag"."""
        ...

    def events(self) -> Iterator[SensorEvent]:
        """Yield samples and scans in the order in which they arrived; every call starts from the beginning.

        A file that is cut or damaged ends there: see the summary.

        Raises:
            OSError: if reading the disk fails.
        """
        ...

    def summary(self) -> RecordingSummary:
        """Return what the last complete pass over the events found; makes one if there was none."""
        ...


class EventTally:
    """Counts the events of one pass.

    Attributes:
        scans, points, imu_samples: how many passed.
    """

    def __init__(self) -> None:
        """Start a pass."""
        self.scans = 0
        self.points = 0
        self.imu_samples = 0
        self._first_ns: int | None = None
        self._last_ns = 0

    def count(self, event: SensorEvent) -> None:
        """Take one event."""
        self._last_ns = event.t_ns
        if self._first_ns is None:
            self._first_ns = event.t_ns
        if isinstance(event, LidarScan):
            self.scans += 1
            self.points += len(event.points_lidar)
        elif isinstance(event, ImuSample):
            self.imu_samples += 1

    @property
    def duration_s(self) -> float:
        """Time between the first and the last event."""
        return 0.0 if self._first_ns is None else ns_to_seconds(self._last_ns - self._first_ns)


def damage(path: Path, offset: int, what: str) -> LogError:
    """Return the error for bytes that cannot be what they should be."""
    return LogError(f"{path}: byte {offset}: {what}")
