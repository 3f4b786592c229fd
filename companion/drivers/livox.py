"""Livox Mid-360 on real sockets: one thread receives the data, the event loop holds the conversation."""

import asyncio
import selectors
import socket
import threading
from collections.abc import Callable
from dataclasses import replace

import structlog

from companion.clock import Clock, seconds_to_ns
from companion.drivers.livox_endpoints import (
    Endpoints,
    LinkNotReadyError,
    describe_error,
    kernel_drops,
    open_endpoints,
    resolve_host_ip,
)
from companion.drivers.livox_framing import LivoxReceiver, LivoxStatistics
from companion.drivers.livox_handshake import LivoxHandshake
from companion.drivers.livox_health import LidarInfo
from companion.drivers.livox_protocol import BROADCAST_IP
from companion.drivers.livox_settings import LivoxSettings
from companion.drivers.livox_stage import Stage
from companion.errors import StartError
from companion.messages import Datagram, SensorEvent

__all__ = ["LivoxDriver", "LivoxSettings", "LivoxStatistics", "Stage"]

POLL_PERIOD_S = 0.05
LINK_RETRY_S = 0.5
MAX_DATAGRAM_SIZE = 2048
MAX_DATAGRAMS_PER_WAKE = 64

_log = structlog.get_logger(__name__)


class LivoxDriver:
    """Receives points and inertial samples of one sensor and keeps it streaming."""

    def __init__(
        self,
        settings: LivoxSettings,
        clock: Clock,
        on_event: Callable[[SensorEvent], None],
        on_raw: Callable[[Datagram], None] | None = None,
    ) -> None:
        """Prepare; nothing is opened before `start`.

        Args:
            settings: of the sensor.
            clock: stamps every reception.
            on_event: called with each sample and scan, in the receiving thread; it must not block.
            on_raw: called with each datagram of either data port before it is judged, in the receiving
                thread.
        """
        self._settings = settings
        self._clock = clock
        self._on_event = on_event
        self._on_raw = on_raw
        self._receiver = LivoxReceiver(settings)
        self._handshake: LivoxHandshake | None = None
        self._endpoints: Endpoints | None = None
        self._thread: threading.Thread | None = None
        self._waker: socket.socket | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._streaming: asyncio.Event | None = None
        self._drops = 0
        self._consumer_errors = 0

    @property
    def stage(self) -> Stage:
        """Where the conversation with the sensor stands."""
        return Stage.SEARCHING if self._handshake is None else self._handshake.stage

    @property
    def info(self) -> LidarInfo:
        """What the sensor last said about itself."""
        return LidarInfo() if self._handshake is None else self._handshake.info

    @property
    def reruns(self) -> int:
        """How often the conversation had to start again after silence."""
        return 0 if self._handshake is None else self._handshake.reruns

    @property
    def receive_buffer_bytes(self) -> int:
        """Size of the kernel's buffer for points, 0 before the start."""
        return 0 if self._endpoints is None else self._endpoints.receive_buffer_bytes

    @property
    def consumer_errors(self) -> int:
        """How often `on_event` or `on_raw` raised; the driver goes on."""
        return self._consumer_errors

    def diagnosis(self) -> str:
        """Return one sentence on where the conversation stands and what to check."""
        return "not started" if self._handshake is None else self._handshake.diagnosis()

    def statistics(self) -> LivoxStatistics:
        """Return a snapshot of all counters."""
        if self._endpoints is not None:
            self._drops = kernel_drops((self._endpoints.points, self._endpoints.imu))
        return replace(self._receiver.statistics(), kernel_drops=self._drops)

    async def start(self, timeout_s: float) -> None:
        """Open the sockets, configure the sensor and return once points and samples arrive.

        Raises:
            StartError: after `timeout_s` seconds; the text names the stage that failed.
        """
        if self._endpoints is not None:
            raise StartError("the LiDAR driver has been started already")
        deadline_ns = self._clock.now_ns() + seconds_to_ns(timeout_s)
        self._endpoints = endpoints = await self._open(deadline_ns)
        self._handshake = LivoxHandshake(self._settings, endpoints.host_ip)
        self._streaming = asyncio.Event()
        self._waker, wake_end = socket.socketpair()
        self._thread = threading.Thread(
            target=self._receive_data, args=(endpoints, wake_end), name="livox", daemon=True
        )
        self._thread.start()
        loop = asyncio.get_running_loop()
        for endpoint in {endpoints.command, *endpoints.listeners}:
            loop.add_reader(endpoint, self._receive_control, endpoint)
        self._poll()
        remaining_s = (deadline_ns - self._clock.now_ns()) * 1e-9
        try:
            await asyncio.wait_for(self._streaming.wait(), max(remaining_s, 0.0))
        except (TimeoutError, asyncio.TimeoutError):
            sentence = self._handshake.diagnosis()
            await self.stop()
            raise StartError(sentence) from None
        except asyncio.CancelledError:
            await self.stop()
            raise
        _log.info("livox: streaming", lidar_ip=self._settings.lidar_ip, serial=self.info.serial)

    async def stop(self) -> None:
        """End the thread and close the sockets; may be called twice."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        endpoints, self._endpoints = self._endpoints, None
        if endpoints is None:
            return
        self._drops = kernel_drops((endpoints.points, endpoints.imu))
        loop = asyncio.get_running_loop()
        for endpoint in {endpoints.command, *endpoints.listeners}:
            loop.remove_reader(endpoint)
        if self._waker is not None and self._thread is not None:
            self._waker.close()
            await loop.run_in_executor(None, self._thread.join)
            self._waker = self._thread = None
        endpoints.close()

    async def _open(self, deadline_ns: int) -> Endpoints:
        """Return bound sockets, waiting for the network link if need be."""
        while True:
            try:
                return open_endpoints(self._settings, resolve_host_ip(self._settings))
            except LinkNotReadyError:
                if self._clock.now_ns() + seconds_to_ns(LINK_RETRY_S) >= deadline_ns:
                    raise
            await self._pause(LINK_RETRY_S)

    async def _pause(self, duration_s: float) -> None:
        loop = asyncio.get_running_loop()
        elapsed = loop.create_future()
        handle = loop.call_later(duration_s, elapsed.set_result, None)
        try:
            await elapsed
        finally:
            handle.cancel()

    def _poll(self) -> None:
        """Drive the conversation; runs on the event loop every 50 ms."""
        if self._handshake is None or self._streaming is None or self._endpoints is None:
            return
        self._handshake.observe_data(self._receiver.t_points_ns, self._receiver.t_imu_ns)
        before = self._handshake.stage
        self._send(self._handshake.poll(self._clock.now_ns()))
        after = self._handshake.stage
        if after is Stage.STREAMING:
            self._streaming.set()
        elif before is Stage.STREAMING:
            _log.warning("livox: silent, handshake runs again", lidar_ip=self._settings.lidar_ip)
        self._timer = asyncio.get_running_loop().call_later(POLL_PERIOD_S, self._poll)

    def _receive_control(self, endpoint: socket.socket) -> None:
        """Take what has arrived on a command, discovery or state socket."""
        if self._handshake is None:
            return
        for _ in range(MAX_DATAGRAMS_PER_WAKE):
            try:
                payload, source = endpoint.recvfrom(MAX_DATAGRAM_SIZE)
            except OSError:
                return
            t_ns = self._clock.now_ns()
            self._send(self._handshake.receive(Datagram(t_ns, source, endpoint.getsockname(), payload)))

    def _send(self, datagrams: list[Datagram]) -> None:
        if self._endpoints is None or self._handshake is None:
            return
        discovery_port = self._settings.host_ports.discovery
        for datagram in datagrams:
            is_search = datagram.source[1] == discovery_port
            endpoint = self._endpoints.discovery if is_search else self._endpoints.command
            try:
                endpoint.sendto(datagram.payload, datagram.destination)
            except OSError as error:
                # A broadcast without a default route fails, and need not succeed.
                if datagram.destination[0] != BROADCAST_IP:
                    self._handshake.observe_send_error(describe_error(error))
            else:
                if datagram.destination[0] != BROADCAST_IP:
                    self._handshake.observe_send_error("")

    def _receive_data(self, endpoints: Endpoints, wake_end: socket.socket) -> None:
        """Receive until the waker is closed; runs in its own thread."""
        buffer = bytearray(MAX_DATAGRAM_SIZE)
        view = memoryview(buffer)
        local = {endpoint: endpoint.getsockname() for endpoint in (endpoints.points, endpoints.imu)}
        with selectors.DefaultSelector() as selector, wake_end:
            selector.register(wake_end, selectors.EVENT_READ)
            for endpoint in local:
                endpoint.setblocking(False)
                selector.register(endpoint, selectors.EVENT_READ)
            while True:
                for key, _ in selector.select():
                    ready = key.fileobj
                    if ready is wake_end or not isinstance(ready, socket.socket):
                        return
                    try:
                        size, source = ready.recvfrom_into(buffer)
                    except OSError:
                        continue
                    self._take(view[:size], source, local[ready])

    def _take(self, payload: memoryview, source: tuple[str, int], destination: tuple[str, int]) -> None:
        t_ns = self._clock.now_ns()
        try:
            if self._on_raw is not None:
                self._on_raw(Datagram(t_ns, source, destination, bytes(payload)))
            for event in self._receiver.receive_payload(t_ns, source, payload):
                self._on_event(event)
        except Exception:
            # A consumer's mistake must not end reception; it is the consumer's to repair.
            self._consumer_errors += 1
            if self._consumer_errors == 1:
                _log.exception("livox: a consumer of sensor events failed")
