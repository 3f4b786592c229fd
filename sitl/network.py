"""A cable that loses, doubles and delays datagrams."""

import heapq

from numpy.random import Generator
from pydantic import Field

from companion.clock import seconds_to_ns
from companion.messages import Datagram
from companion.settings import Settings


class NetworkSettings(Settings):
    """Faults of the link between the LiDAR and its host."""

    loss: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of datagrams that never arrive."""

    duplication: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of datagrams that arrive twice."""

    latency_ms: float = Field(default=0.2, ge=0.0, le=1000.0)
    """Least time on the way."""

    jitter_ms: float = Field(default=0.1, ge=0.0, le=1000.0)
    """Largest further time on the way; datagrams may overtake each other."""

    outage_at_s: float | None = Field(default=None, ge=0.0)
    """Start of a complete silence, in seconds after power-on; none by default."""

    outage_s: float = Field(default=0.3, ge=0.0)
    """Length of that silence."""


_CHANCES = 4096
_PER_DATAGRAM = 4


class Network:
    """Delivers datagrams late, twice or never; deterministic for a given generator."""

    def __init__(self, settings: NetworkSettings, rng: Generator, start_ns: int) -> None:
        """Begin empty; `start_ns` is the moment of power-on."""
        self._settings = settings
        self._rng = rng
        self._chances: list[list[float]] = []
        self._waiting: list[tuple[int, int, Datagram]] = []
        self._count = 0
        self._outage_ns = (0, 0)
        if settings.outage_at_s is not None:
            begin_ns = start_ns + seconds_to_ns(settings.outage_at_s)
            self._outage_ns = (begin_ns, begin_ns + seconds_to_ns(settings.outage_s))

    def carry(self, datagram: Datagram) -> list[Datagram]:
        """Return what becomes of one datagram sent at its `t_ns`: none, one or two, stamped with arrival."""
        t_ns, settings = datagram.t_ns, self._settings
        if self._outage_ns[0] <= t_ns < self._outage_ns[1]:
            return []
        if not self._chances:
            self._chances = self._rng.random((_CHANCES, _PER_DATAGRAM)).tolist()
        fate_loss, fate_twice, *waits = self._chances.pop()
        if fate_loss < settings.loss:
            return []
        source, destination, payload = datagram.source, datagram.destination, datagram.payload
        latency_ms, jitter_ms = settings.latency_ms, settings.jitter_ms
        first = Datagram(t_ns + int(1e6 * (latency_ms + waits[0] * jitter_ms)), source, destination, payload)
        if fate_twice >= settings.duplication:
            return [first]
        again = Datagram(t_ns + int(1e6 * (latency_ms + waits[1] * jitter_ms)), source, destination, payload)
        return [first, again]

    def send(self, datagram: Datagram) -> None:
        """Put one datagram on the wire at its `t_ns`."""
        for copy in self.carry(datagram):
            self._count += 1
            heapq.heappush(self._waiting, (copy.t_ns, self._count, copy))

    def deliver(self, t_ns: int) -> list[Datagram]:
        """Return what has arrived by `t_ns`, in the order of arrival."""
        arrived: list[Datagram] = []
        while self._waiting and self._waiting[0][0] <= t_ns:
            arrived.append(heapq.heappop(self._waiting)[2])
        return arrived
