"""The UDP port at which another process's odometry arrives, with a thread that waits there."""

import asyncio
import errno
import selectors
import socket
import threading
from collections.abc import Callable

import structlog

from companion.clock import Clock
from companion.drivers.external_odometry import (
    MAX_DATAGRAM_SIZE,
    ExternalOdometryReceiver,
    ExternalOdometryStatistics,
)
from companion.drivers.external_odometry_settings import ExternalOdometrySettings
from companion.drivers.livox_endpoints import describe_error
from companion.errors import StartError
from companion.messages import SensorEvent

_MAX_NAMED_REASONS = 3
_FRESH_NS = 1_000_000_000

_log = structlog.get_logger(__name__)


class ExternalOdometryLink:
    """Receives the odometry of another process on this computer."""

    def __init__(
        self, settings: ExternalOdometrySettings, clock: Clock, on_event: Callable[[SensorEvent], None]
    ) -> None:
        """Prepare; nothing is opened before `start`.

        Args:
            settings: where to listen and what to accept.
            clock: stamps every reception.
            on_event: called with each accepted message, in the receiving thread; it must not block.
        """
        self._settings = settings
        self._clock = clock
        self._on_event = on_event
        self._receiver = ExternalOdometryReceiver(settings)
        self._socket: socket.socket | None = None
        self._waker: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._consumer_errors = 0

    @property
    def consumer_errors(self) -> int:
        """How often `on_event` raised; the link goes on."""
        return self._consumer_errors

    def statistics(self) -> ExternalOdometryStatistics:
        """Return a snapshot of all counters."""
        return self._receiver.statistics()

    async def start(self) -> None:
        """Open the port; the other process may begin at any time later.

        Raises:
            StartError: if the port is taken or may not be bound.
        """
        if self._socket is not None:
            raise StartError("the link to external odometry has been started already")
        ip, port = self._settings.bind_ip, self._settings.port
        endpoint = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            endpoint.bind((ip, port))
        except OSError as error:
            endpoint.close()
            hint = ": another program listens there" if error.errno == errno.EADDRINUSE else ""
            raise StartError(
                f"cannot bind UDP port {port} for external odometry on {ip}: {describe_error(error)}{hint}"
            ) from None
        endpoint.setblocking(False)
        self._socket = endpoint
        self._waker, wake_end = socket.socketpair()
        self._thread = threading.Thread(
            target=self._receive, args=(endpoint, wake_end), name="external-odometry", daemon=True
        )
        self._thread.start()
        _log.info("external odometry: listening", ip=ip, port=port)

    async def stop(self) -> None:
        """End the thread and close the port; may be called twice."""
        endpoint, self._socket = self._socket, None
        if endpoint is None or self._waker is None or self._thread is None:
            return
        self._waker.close()
        await asyncio.get_running_loop().run_in_executor(None, self._thread.join)
        self._waker = self._thread = None
        endpoint.close()

    def diagnosis(self) -> str:
        """Return one sentence on what arrives, or what does not and where to look."""
        found = self.statistics()
        where = f"{self._settings.bind_ip}:{self._settings.port}"
        reasons = sorted(found.refusals.items(), key=lambda item: (-item[1], item[0]))
        named = ", ".join(f"{reason} ({count})" for reason, count in reasons[:_MAX_NAMED_REASONS])
        if found.datagrams == 0:
            return f"nothing arrives at UDP {where}: does the other process run, and send there?"
        if found.t_accepted_ns is None:
            return f"of {found.datagrams} datagrams at UDP {where} none was accepted: {named}"
        silent_ns = self._clock.now_ns() - found.t_accepted_ns
        if silent_ns > _FRESH_NS:
            tail = f"; refused: {named}" if named else ""
            return f"nothing was accepted at UDP {where} for {silent_ns * 1e-9:.1f} s{tail}"
        return f"{found.accepted} messages accepted at UDP {where}, {found.refused} refused"

    def _receive(self, endpoint: socket.socket, wake_end: socket.socket) -> None:
        """Receive until the waker is closed; runs in its own thread."""
        # One byte more than a datagram may have, so that a larger one is told from the largest.
        buffer = bytearray(MAX_DATAGRAM_SIZE + 1)
        view = memoryview(buffer)
        with selectors.DefaultSelector() as selector, wake_end:
            selector.register(wake_end, selectors.EVENT_READ)
            selector.register(endpoint, selectors.EVENT_READ)
            while True:
                for key, _ in selector.select():
                    if key.fileobj is wake_end:
                        return
                    try:
                        size, source = endpoint.recvfrom_into(buffer)
                    except OSError:
                        continue
                    self._take(view[:size], source)

    def _take(self, payload: memoryview, source: tuple[str, int]) -> None:
        try:
            for event in self._receiver.receive(self._clock.now_ns(), source, payload):
                self._on_event(event)
        except Exception:
            # A consumer's mistake must not end reception; it is the consumer's to repair.
            self._consumer_errors += 1
            if self._consumer_errors == 1:
                _log.exception("external odometry: a consumer failed")
