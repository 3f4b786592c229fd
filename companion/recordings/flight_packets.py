"""Our own flight logs as a source of datagrams: what the LiDAR sent in flight."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import cast

from companion.logs.channels import LIDAR_PACKETS
from companion.logs.reader import FlightRecording
from companion.messages import Datagram


class FlightPackets:
    """The raw packets in a flight log, finished or not.

    Attributes:
        kind: "flight log".
        skipped: what the last pass could not decode.
        notes: what the last pass has to say about the file.
    """

    def __init__(self, path: Path) -> None:
        """Prepare to read `path`.

        Raises:
            LogError: if it is no flight log.
        """
        self.kind = "flight log"
        self.skipped: Counter[str] = Counter()
        self.notes: list[str] = []
        self._recording = FlightRecording(path)

    def datagrams(self) -> Iterator[Datagram]:
        """Yield the LiDAR's datagrams from the beginning.

        Raises:
            LogError: if reading the disk fails.
        """
        self.skipped, self.notes = Counter(), []
        for entry in self._recording.messages(LIDAR_PACKETS):
            yield from cast(tuple[Datagram, ...], entry.message)
        integrity = self._recording.integrity()
        if integrity.undecodable:
            self.skipped["messages that cannot be decoded"] = integrity.undecodable
        missing = integrity.missing.get(LIDAR_PACKETS.topic, 0)
        if missing:
            self.notes.append(f"{missing} batches of LiDAR packets were never written to the log")
        if not integrity.complete:
            self.notes.append(f"the log is incomplete: {integrity.bytes_lost} bytes could not be used")
