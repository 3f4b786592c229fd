"""Receives a PX4 simulator's true motion on a UDP socket."""

import asyncio
from typing import Any

from companion.clock import Clock, SystemClock, ns_to_seconds, seconds_to_ns
from companion.errors import StartError
from sitl.px4_truth import Px4Truth

_POLL_NS = seconds_to_ns(0.02)


class TruthLink(asyncio.DatagramProtocol):
    """Feeds a `Px4Truth` with what arrives."""

    def __init__(self, truth: Px4Truth, clock: Clock) -> None:
        """Prepare; see `open`."""
        self._truth = truth
        self._clock = clock
        self._transport: asyncio.DatagramTransport | None = None

    async def open(self, address: tuple[str, int]) -> None:
        """Listen where the simulator sends to.

        Raises:
            StartError: if the address cannot be bound.
        """
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=address)
        except OSError as error:
            raise StartError(
                f"simulator's motion: cannot listen on {address[0]}:{address[1]}: {error.strerror}"
            ) from None

    def close(self) -> None:
        """Stop listening."""
        if self._transport is not None:
            self._transport.close()

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        """Take one datagram; anything that is no motion is skipped and counted."""
        self._truth.receive(data, self._clock.now_ns())

    async def wait(self, clock: SystemClock, timeout_ns: int, messages: int) -> None:
        """Wait until so many states have arrived.

        Raises:
            StartError: if they do not.
        """
        deadline_ns = clock.now_ns() + timeout_ns
        while self._truth.messages < messages:
            if clock.now_ns() > deadline_ns:
                raise StartError(
                    f"simulator's motion: {self._truth.messages} HIL_STATE_QUATERNION messages in "
                    f"{ns_to_seconds(timeout_ns):.0f} s; is PX4 running with its internal simulator?"
                )
            await clock.sleep(_POLL_NS)
