"""The emulated Mid-360 on real UDP sockets, in real time.

One thread answers commands, pushes the state and sends queued packets when their time has come. Slots
may therefore be produced in batches, ahead of time; the wire still sees one packet every 480 us.
"""

import heapq
import selectors
import socket
import threading
from collections.abc import Iterable, Mapping

import structlog

from companion.clock import SystemClock, seconds_to_ns
from companion.drivers.livox_protocol import BROADCAST_IP
from companion.messages import Datagram
from sitl.livox_emulator import LivoxEmulator
from sitl.network import Network
from sitl.slots import InertialSlot, PointSlots

MAX_DATAGRAM_SIZE = 2048
MAX_QUEUED = 100_000
_SENDING_PERIOD_S = 0.001
_IDLE_PERIOD_S = 0.02
# After a packet more are expected, perhaps late ones that are due at once.
_BUSY_NS = seconds_to_ns(0.2)

_log = structlog.get_logger(__name__)


class LivoxSockets:
    """Carries one emulator's datagrams; its methods may be called from any thread."""

    def __init__(
        self,
        emulator: LivoxEmulator,
        clock: SystemClock,
        hears_broadcast: bool = True,
        network: Network | None = None,
        mirrored_ports: Mapping[int, int] | None = None,
    ) -> None:
        """Prepare; nothing is opened before `start`.

        Args:
            emulator: the sensor; from now on only to be used through this object.
            clock: host time, the same that the emulator's power-on refers to.
            hears_broadcast: also answer searches sent to 255.255.255.255.
            network: what happens to points and inertial samples on their way; nothing by default.
            mirrored_ports: what is sent to one of these ports also goes to another one of the same host, as
                from a switch that mirrors a port.
        """
        self._mirrored_ports = dict(mirrored_ports or {})
        self._network = network
        self._emulator = emulator
        self._clock = clock
        self._hears_broadcast = hears_broadcast
        self._lock = threading.Lock()
        self._queue: list[tuple[int, int, Datagram]] = []
        self._queued = 0
        self._sockets: dict[int, socket.socket] = {}
        self._listeners: list[socket.socket] = []
        self._selector: selectors.DefaultSelector | None = None
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self.sent = 0
        self.send_errors = 0

    def start(self) -> None:
        """Bind all ports of the sensor and start the thread.

        Raises:
            OSError: if a port cannot be bound.
        """
        settings = self._emulator.settings
        ports = settings.ports
        selector = selectors.DefaultSelector()
        try:
            for port in (ports.discovery, ports.command, ports.state, ports.points, ports.imu, ports.log):
                endpoint = self._open(settings.lidar_ip, port)
                self._sockets[port] = endpoint
                selector.register(endpoint, selectors.EVENT_READ, (settings.lidar_ip, port))
            if self._hears_broadcast:
                endpoint = self._open(BROADCAST_IP, ports.discovery)
                selector.register(endpoint, selectors.EVENT_READ, (BROADCAST_IP, ports.discovery))
        except OSError:
            self._close()
            selector.close()
            raise
        self._selector = selector
        self._stopping.clear()
        self._thread = threading.Thread(
            target=self._serve, args=(selector,), name="livox-emulator", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close all sockets; may be called twice."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self._selector is not None:
            self._selector.close()
            self._selector = None
        self._close()
        with self._lock:
            self._queue.clear()

    def points(self, slots: PointSlots) -> int:
        """Queue the packets that these slots complete, each for its own time; return how many."""
        with self._lock:
            return self._enqueue(self._carried(self._emulator.points(slots)))

    def inertial(self, slot: InertialSlot) -> int:
        """Queue the packet of one inertial sample for its own time; return how many, 0 or 1."""
        with self._lock:
            return self._enqueue(self._carried(self._emulator.inertial(slot)))

    def send(self, datagrams: Iterable[Datagram]) -> int:
        """Queue datagrams from the sensor's ports, each for its own time; return how many."""
        with self._lock:
            return self._enqueue(datagrams)

    def power_cycle(self, boot_host_ns: int) -> None:
        """Power the sensor off, dropping what is queued, and on again at host time `boot_host_ns`."""
        with self._lock:
            self._queue.clear()
            self._emulator.power_cycle(boot_host_ns)

    def _carried(self, datagrams: list[Datagram]) -> list[Datagram]:
        if self._network is None:
            return datagrams
        return [copy for datagram in datagrams for copy in self._network.carry(datagram)]

    def _enqueue(self, datagrams: Iterable[Datagram]) -> int:
        count = 0
        for datagram in datagrams:
            if len(self._queue) >= MAX_QUEUED:
                raise OverflowError(f"more than {MAX_QUEUED} datagrams wait to be sent")
            self._queued += 1
            count += 1
            heapq.heappush(self._queue, (datagram.t_ns, self._queued, datagram))
        return count

    def _serve(self, selector: selectors.DefaultSelector) -> None:
        busy_until_ns = 0
        while not self._stopping.is_set():
            busy = self._clock.now_ns() < busy_until_ns
            ready = selector.select(_SENDING_PERIOD_S if busy else _IDLE_PERIOD_S)
            for key, _ in ready:
                if isinstance(key.fileobj, socket.socket):
                    self._receive(key.fileobj, key.data)
            t_ns = self._clock.now_ns()
            with self._lock:
                due = self._emulator.poll(t_ns)
                while self._queue and self._queue[0][0] <= t_ns:
                    due.append(heapq.heappop(self._queue)[2])
                if due or self._queue:
                    busy_until_ns = t_ns + _BUSY_NS
            for datagram in due:
                self._send_now(datagram)

    def _receive(self, endpoint: socket.socket, destination: tuple[str, int]) -> None:
        try:
            payload, source = endpoint.recvfrom(MAX_DATAGRAM_SIZE)
        except OSError:
            return
        with self._lock:
            answers = self._emulator.receive(Datagram(self._clock.now_ns(), source, destination, payload))
        for answer in answers:
            self._send_now(answer)

    def _send_now(self, datagram: Datagram) -> None:
        try:
            endpoint, (host, port) = self._sockets[datagram.source[1]], datagram.destination
            endpoint.sendto(datagram.payload, (host, port))
            if port in self._mirrored_ports:
                endpoint.sendto(datagram.payload, (host, self._mirrored_ports[port]))
        except OSError as error:
            self.send_errors += 1
            if self.send_errors == 1:
                _log.warning("emulated livox: cannot send", to=datagram.destination[0], reason=str(error))
        else:
            self.sent += 1

    def _open(self, ip: str, port: int) -> socket.socket:
        endpoint = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._listeners.append(endpoint)
        endpoint.setblocking(False)
        endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        endpoint.bind((ip, port))
        return endpoint

    def _close(self) -> None:
        for endpoint in self._listeners:
            endpoint.close()
        self._listeners.clear()
        self._sockets.clear()
