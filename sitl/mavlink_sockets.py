"""The emulated autopilot on real UDP sockets."""

import asyncio
from functools import partial
from typing import Any

from pydantic import Field

from companion.clock import Clock, SystemClock, seconds_to_ns
from companion.settings import Settings
from sitl.mavlink_emulator import MavlinkEmulator, Outgoing, Peer

_DATAGRAM_MAX = 2048
_POLL_PERIOD_NS = seconds_to_ns(0.005)


class MavlinkSocketSettings(Settings):
    """Addresses of the two links."""

    companion_host: str = "127.0.0.1"
    """Where the companion listens."""
    companion_port: int = Field(14540, ge=1, le=65535)
    """Its UDP port."""
    companion_local_port: int = Field(14580, ge=0, le=65535)
    """Own port of that link, 0 for any."""
    ground_host: str = "127.0.0.1"
    """Where the ground station listens."""
    ground_port: int = Field(14550, ge=1, le=65535)
    """Its UDP port."""
    ground_local_port: int = Field(18570, ge=0, le=65535)
    """Own port of that link, 0 for any."""


class _Endpoint(asyncio.DatagramProtocol):
    """Hands datagrams of one link to the emulator and sends its answers."""

    def __init__(self, owner: "MavlinkSockets", peer: Peer) -> None:
        self._owner = owner
        self._peer = peer

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        """Take one datagram from the link's peer; from anybody else it is counted and dropped."""
        if len(data) > _DATAGRAM_MAX:
            self._owner.foreign_datagrams += 1
            return
        self._owner.received(data, (str(addr[0]), int(addr[1])), self._peer)

    def error_received(self, exc: Exception) -> None:
        """Ignore that nobody listens yet."""


class MavlinkSockets:
    """Runs one emulator on two UDP sockets.

    Attributes:
        foreign_datagrams: datagrams from unexpected senders or of excessive size.
    """

    def __init__(
        self, emulator: MavlinkEmulator, settings: MavlinkSocketSettings, clock: Clock | None = None
    ) -> None:
        """Bind nothing yet; times come from `clock`, the host's by default."""
        self._emulator = emulator
        self._clock = clock or SystemClock()
        self._settings = settings
        self._transports: dict[Peer, asyncio.DatagramTransport] = {}
        self._addresses = {
            Peer.COMPANION: (settings.companion_host, settings.companion_port),
            Peer.GROUND: (settings.ground_host, settings.ground_port),
        }
        self.foreign_datagrams = 0

    async def open(self) -> None:
        """Bind both sockets.

        Raises:
            OSError: if a local port is taken.
        """
        loop = asyncio.get_running_loop()
        local_ports = {
            Peer.COMPANION: self._settings.companion_local_port,
            Peer.GROUND: self._settings.ground_local_port,
        }
        for peer, (host, _) in self._addresses.items():
            local_host = "127.0.0.1" if host.startswith("127.") else "0.0.0.0"
            transport, _ = await loop.create_datagram_endpoint(
                partial(_Endpoint, self, peer), local_addr=(local_host, local_ports[peer])
            )
            self._transports[peer] = transport

    def close(self) -> None:
        """Close both sockets."""
        for transport in self._transports.values():
            transport.close()
        self._transports.clear()

    def received(self, data: bytes, address: tuple[str, int], peer: Peer) -> None:
        """Handle one datagram; only the configured host may speak, and answers go to its configured port."""
        if address[0] != self._addresses[peer][0]:
            self.foreign_datagrams += 1
            return
        self._send(self._emulator.receive(data, self._clock.now_ns(), peer))

    def poll(self) -> None:
        """Send what is due now."""
        self._send(self._emulator.poll(self._clock.now_ns()))

    async def run(self) -> None:
        """Send what is due every 5 ms until cancelled, then close."""
        clock = SystemClock()
        try:
            while True:
                self.poll()
                await clock.sleep(_POLL_PERIOD_NS)
        finally:
            self.close()

    def _send(self, outgoing: list[Outgoing]) -> None:
        for item in outgoing:
            transport = self._transports.get(item.peer)
            if transport is not None and not transport.is_closing():
                transport.sendto(item.payload, self._addresses[item.peer])
