"""The bounded line between control and disk: control never waits, bulk is refused first."""

import threading
from collections import deque
from dataclasses import dataclass

from companion.logs.channels import Channel

_BULK_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One message on its way to or from a log.

    Attributes:
        t_ns: time at which it was handled, as told to the log.
        sequence: counts the messages of its channel from 0, including those that were dropped.
    """

    channel: Channel
    t_ns: int
    sequence: int
    message: object


class LogQueue:
    """Entries wait here for the writer; any thread may offer, one thread takes.

    Attributes:
        dropped, dropped_bulk: entries refused because the queue was full, without and with bulk.
    """

    def __init__(self, bytes_max: int) -> None:
        """Hold about `bytes_max` bytes of messages; bulk may use half of it."""
        self.dropped = 0
        self.dropped_bulk = 0
        self._bytes_max = bytes_max
        self._bulk_bytes_max = int(bytes_max * _BULK_SHARE)
        self._entries: deque[tuple[LogEntry, int]] = deque()
        self._lock = threading.Lock()
        self._offered = 0
        self._drained = 0

    @property
    def waiting_bytes(self) -> int:
        """About how many bytes wait."""
        return self._offered - self._drained

    def offer(self, entry: LogEntry, size: int) -> bool:
        """Append an entry of about `size` bytes, or count it as dropped; never waits for the disk."""
        bulk = entry.channel.bulk
        with self._lock:
            if self.waiting_bytes + size > (self._bulk_bytes_max if bulk else self._bytes_max):
                if bulk:
                    self.dropped_bulk += 1
                else:
                    self.dropped += 1
                return False
            self._offered += size
            self._entries.append((entry, size))
            return True

    def take(self) -> LogEntry | None:
        """Remove the oldest entry; None if none waits."""
        if not self._entries:
            return None
        entry, size = self._entries.popleft()
        self._drained += size
        return entry
