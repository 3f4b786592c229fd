"""The operator's ground station on a real UDP socket."""

import asyncio
from typing import Any

from companion.clock import Clock
from companion.errors import StartError
from sitl.operator import Operator

GROUND_ADDRESS = ("127.0.0.1", 14550)
"""Where autopilots look for a ground station."""


class GroundLink(asyncio.DatagramProtocol):
    """Carries the operator's bytes to and from the autopilot's ground link."""

    def __init__(self, operator: Operator, clock: Clock) -> None:
        """Prepare; see `open`."""
        self._operator = operator
        self._clock = clock
        self._transport: asyncio.DatagramTransport | None = None
        self._autopilot: tuple[str, int] | None = None

    async def open(self, address: tuple[str, int]) -> None:
        """Listen on a local address.

        Raises:
            StartError: if it cannot be bound.
        """
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=address)
        except OSError as error:
            raise StartError(
                f"ground station: cannot listen on {address[0]}:{address[1]}: {error.strerror}; "
                "is another ground station program running?"
            ) from None

    def close(self) -> None:
        """Stop listening."""
        if self._transport is not None:
            self._transport.close()

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        """Let the operator read; answers go to whoever spoke last."""
        self._autopilot = (str(addr[0]), int(addr[1]))
        self._operator.receive(data, self._clock.now_ns())

    def error_received(self, exc: Exception) -> None:
        """Ignore that nobody listens yet."""

    def poll(self) -> None:
        """Send what the operator has to say."""
        if self._transport is None or self._autopilot is None:
            return
        for data in self._operator.poll(self._clock.now_ns()):
            self._transport.sendto(data, self._autopilot)
