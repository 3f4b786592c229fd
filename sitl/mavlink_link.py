"""One MAVLink link of the emulated autopilot: what comes in, what is due, what waits to go out."""

from collections import deque
from collections.abc import Mapping
from typing import Any

from sitl.mavlink_frames import Frame, FrameCutter, FrameEncoder
from sitl.mavlink_schedule import StreamSchedule
from sitl.mavlink_timesync import Timesync

_OUTBOX_MAX = 512
_ROUTES_MAX = 32
_DATAGRAM_MAX = 1400
_ENCODERS: dict[str, FrameEncoder] = {}


class Link:
    """State of one link.

    Attributes:
        cutter: incoming frames and their statistics.
        timesync: the peer's clock.
        schedule: streams of this link.
        routes: (system, component) pairs heard on this link.
        dropped: frames that did not fit the outbox.
    """

    def __init__(self, rates_hz: Mapping[str, float], system_id: int, component_id: int) -> None:
        """Open with default stream rates, speaking as `system_id` and `component_id`."""
        self.cutter = FrameCutter()
        self.timesync = Timesync()
        self.schedule = StreamSchedule(rates_hz)
        self.routes: set[tuple[int, int]] = set()
        self.dropped = 0
        self._ids = (system_id, component_id)
        self._sequence = 0
        self._outbox: deque[bytes] = deque()

    def learn(self, frame: Frame) -> None:
        """Remember that a component is reached through this link."""
        if len(self.routes) < _ROUTES_MAX:
            self.routes.add((frame.system_id, frame.component_id))

    def reaches(self, system_id: int, component_id: int) -> bool:
        """Return whether a target lives behind this link; 0 stands for all of a kind."""
        return any(
            system_id in (0, system) and component_id in (0, component) for system, component in self.routes
        )

    def send(self, name: str, values: tuple[Any, ...]) -> None:
        """Queue one own message with its fields in the order of their definition."""
        encoder = _ENCODERS.get(name)
        if encoder is None:
            encoder = _ENCODERS[name] = FrameEncoder(name)
        self._queue(encoder.frame(self._sequence, *self._ids, values))
        self._sequence = (self._sequence + 1) & 0xFF

    def forward(self, raw: bytes) -> None:
        """Queue somebody else's frame unchanged."""
        self._queue(raw)

    @property
    def waits(self) -> bool:
        """Whether anything is queued."""
        return bool(self._outbox)

    def drain(self) -> list[bytes]:
        """Return everything queued, joined into datagrams of at most 1400 bytes."""
        datagrams: list[bytes] = []
        parts: list[bytes] = []
        size = 0
        for frame in self._outbox:
            if parts and size + len(frame) > _DATAGRAM_MAX:
                datagrams.append(b"".join(parts))
                parts, size = [], 0
            parts.append(frame)
            size += len(frame)
        if parts:
            datagrams.append(b"".join(parts))
        self._outbox.clear()
        return datagrams

    def _queue(self, frame: bytes) -> None:
        if len(self._outbox) >= _OUTBOX_MAX:
            self.dropped += 1
            return
        self._outbox.append(frame)
