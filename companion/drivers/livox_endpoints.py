"""UDP sockets of the Livox driver: which local address, bind with clear errors, buffers, kernel drops."""

import errno
import fcntl
import os
import socket
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import structlog

from companion.drivers.livox_protocol import BROADCAST_IP
from companion.drivers.livox_settings import LivoxSettings
from companion.errors import StartError

_SIOCGIFADDR = 0x8915
_UDP_TABLE = Path("/proc/net/udp")
# These pass by themselves while a network link comes up.
LINK_ERRORS = frozenset({errno.EADDRNOTAVAIL, errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN})

_log = structlog.get_logger(__name__)


class LinkNotReadyError(StartError):
    """The host has no usable address towards the sensor yet; trying again later may help."""


@dataclass(slots=True)
class Endpoints:
    """Open sockets of one driver.

    Attributes:
        points, imu: read by the receiving thread.
        command: sends and receives commands.
        listeners: further sockets for discovery and state; discovery is among them if it could be bound.
        discovery: sends searches; the command socket when its own port is taken.
        receive_buffer_bytes: size that the kernel granted for points.
    """

    host_ip: str
    points: socket.socket
    imu: socket.socket
    command: socket.socket
    discovery: socket.socket
    listeners: list[socket.socket] = field(default_factory=list)
    receive_buffer_bytes: int = 0

    def close(self) -> None:
        """Close all sockets."""
        for endpoint in {self.points, self.imu, self.command, self.discovery, *self.listeners}:
            endpoint.close()


def resolve_host_ip(settings: LivoxSettings) -> str:
    """Return the configured own address, or the one from which the kernel routes to the sensor.

    Raises:
        LinkNotReadyError: if there is no route to the sensor.
        StartError: if the sensor's address is an address of this host.
    """
    host_ip = settings.host_ip
    if host_ip == "auto":
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect((settings.lidar_ip, settings.lidar_ports.discovery))
            except OSError as error:
                raise LinkNotReadyError(
                    f"no route to the LiDAR at {settings.lidar_ip}: {describe_error(error)}; "
                    f"local addresses are {local_addresses()}"
                ) from None
            host_ip = str(probe.getsockname()[0])
    if host_ip == settings.lidar_ip:
        raise StartError(f"the LiDAR's address {settings.lidar_ip} is an address of this computer itself")
    return host_ip


def open_endpoints(settings: LivoxSettings, host_ip: str) -> Endpoints:
    """Bind all sockets.

    Raises:
        LinkNotReadyError: if `host_ip` is not an address of this host (yet).
        StartError: if a port is taken or may not be bound.
    """
    ports = settings.host_ports
    opened: list[socket.socket] = []
    try:
        for name, port in (
            ("points", ports.points),
            ("IMU", ports.imu),
            ("commands", ports.command),
            ("state", ports.state),
        ):
            opened.append(_bind(name, host_ip, port))
    except StartError:
        for endpoint in opened:
            endpoint.close()
        raise
    points, imu, command, state = opened
    command.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    listeners = [state]
    discovery = _bind_optional(host_ip, ports.discovery) or command
    if discovery is not command:
        discovery.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        listeners.append(discovery)
    if settings.broadcast_search:
        # Sensors in another subnet answer and push by broadcast: heard for the diagnosis only.
        heard = (_bind_optional(BROADCAST_IP, port) for port in (ports.discovery, ports.state))
        listeners += [listener for listener in heard if listener is not None]
    for endpoint in (command, *listeners):
        endpoint.setblocking(False)
    granted = _enlarge(points, settings.receive_buffer_bytes)
    _enlarge(imu, settings.receive_buffer_bytes // 8)
    return Endpoints(host_ip, points, imu, command, discovery, listeners, granted)


def kernel_drops(endpoints: Iterable[socket.socket]) -> int:
    """Return how many datagrams the kernel dropped for want of room in these sockets (0 if unknown)."""
    try:
        inodes = {str(os.fstat(endpoint.fileno()).st_ino) for endpoint in endpoints}
        rows = _UDP_TABLE.read_text().splitlines()[1:]
    except (OSError, ValueError):
        return 0
    columns = (row.split() for row in rows)
    return sum(int(row[-1]) for row in columns if len(row) >= 13 and row[9] in inodes)


def local_addresses() -> str:
    """Return the host's IPv4 addresses with their interfaces, for messages."""
    found: list[str] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            try:
                answer = fcntl.ioctl(probe.fileno(), _SIOCGIFADDR, request)
            except OSError:
                continue
            found.append(f"{socket.inet_ntoa(answer[20:24])} ({name})")
    return ", ".join(found) or "none"


def describe_error(error: OSError) -> str:
    """Return an operating system error in words, with its name and number."""
    number = error.errno or 0
    name = errno.errorcode.get(number, "unknown")
    return f"{os.strerror(number) if number else error} (errno {number} {name})"


def _bind(name: str, ip: str, port: int) -> socket.socket:
    endpoint = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        endpoint.bind((ip, port))
    except OSError as error:
        endpoint.close()
        kind = LinkNotReadyError if error.errno in LINK_ERRORS else StartError
        raise kind(
            f"cannot bind UDP port {port} for {name} on {ip}: {describe_error(error)}; "
            f"local addresses are {local_addresses()}"
        ) from None
    return endpoint


def _bind_optional(ip: str, port: int) -> socket.socket | None:
    endpoint = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        endpoint.bind((ip, port))
    except OSError as error:
        endpoint.close()
        _log.info("livox: optional port not bound", ip=ip, port=port, reason=describe_error(error))
        return None
    return endpoint


def _enlarge(endpoint: socket.socket, wanted_bytes: int) -> int:
    """Ask for a receive buffer and return the size granted, as the kernel counts it for data."""
    endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted_bytes)
    # Linux reports twice what it was asked for, to account for its own overhead.
    granted = endpoint.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
    if granted < wanted_bytes:
        _log.warning(
            "livox: receive buffer capped; raise net.core.rmem_max",
            wanted_bytes=wanted_bytes,
            granted_bytes=granted,
        )
    return granted
