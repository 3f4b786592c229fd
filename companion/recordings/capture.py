"""Network captures as a source of datagrams."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from companion.messages import Datagram
from companion.recordings.capture_frames import pcap_frames, pcapng_frames
from companion.recordings.link_layers import Skip, datagram_of


class CaptureSource:
    """A PCAP or PCAPNG file.

    Attributes:
        kind: "pcap" or "pcapng".
        skipped: frames of the last pass that held no datagram, by reason.
        notes: empty.
    """

    def __init__(self, path: Path, *, new_generation: bool) -> None:
        """Prepare to read `path`, which is a PCAPNG file if `new_generation`."""
        self.kind = "pcapng" if new_generation else "pcap"
        self.skipped: Counter[str] = Counter()
        self.notes: list[str] = []
        self._path = path
        self._frames = pcapng_frames if new_generation else pcap_frames

    def datagrams(self) -> Iterator[Datagram]:
        """Yield all UDP datagrams from the beginning.

        Raises:
            LogError: where the file is cut or damaged, after everything before that was yielded.
            OSError: if reading the disk fails.
        """
        self.skipped = Counter()
        for frame in self._frames(self._path):
            found = datagram_of(frame)
            if isinstance(found, Skip):
                self.skipped[found.value] += 1
            else:
                yield found
