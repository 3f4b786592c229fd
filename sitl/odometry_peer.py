"""Somebody else's odometry process: hears a copy of the LiDAR's packets, sends MAVLink ODOMETRY.

It knows nothing but those packets: the motion that it sends is estimated, by a LiDAR-inertial odometry of its
own, on a clock of its own.
"""

import selectors
import signal
import socket
from collections.abc import Sequence
from types import FrameType

import structlog

from companion.clock import SystemClock, seconds_to_ns
from companion.config import Profile
from companion.drivers.livox_framing import LivoxReceiver
from companion.drivers.mavlink_codec import MavlinkEncoder
from companion.drivers.px4_messages import external_odometry
from companion.messages import (
    Datagram,
    MavlinkMessage,
    Odometry,
    OdometryStatus,
    PerceptionUpdate,
    SensorEvent,
)
from companion.perception.odometry.lio import LidarInertialOdometry

SYSTEM_ID = 1
COMPONENT_ID = 197  # MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
RATE_HZ = 50.0
"""How often it sends."""
BOOT_LEAD_NS = seconds_to_ns(1234.5)
"""What its clock shows when it starts, so that no other clock shows the same."""

_log = structlog.get_logger(__name__)

_MAX_DATAGRAM_SIZE = 2048
_FAILED_QUALITY = -1
_RATE_NOISE = 0.02
_RECEIVE_BUFFER_BYTES = 4 * 1024 * 1024


class OdometryPeer:
    """The process without its sockets."""

    def __init__(self, profile: Profile, start_ns: int) -> None:
        """Start at host time `start_ns` with the mount and the LiDAR of a vehicle's profile."""
        vehicle = profile.vehicle
        self._receiver = LivoxReceiver(profile.lidar)
        settings = profile.odometry.model_copy(update={"output_hz": RATE_HZ})
        self._odometry = LidarInertialOdometry(settings, vehicle.T_body_lidar, vehicle.T_lidar_imu)
        self._encoder = MavlinkEncoder()
        self._epoch_ns = start_ns - BOOT_LEAD_NS

    def receive(self, datagram: Datagram) -> list[SensorEvent]:
        """Take one of the LiDAR's data packets; return the events that it completes."""
        return self._receiver.receive(datagram)

    def perceive(self, event: SensorEvent) -> Sequence[PerceptionUpdate]:
        """Estimate; the heavy part."""
        return self._odometry.handle(event)

    def encode(self, update: PerceptionUpdate) -> list[bytes]:
        """Return the bytes to send for an estimate: none before the first, a failure when it is lost."""
        if not isinstance(update, Odometry) or update.status is OdometryStatus.INITIALISING:
            return []
        fields = external_odometry(update, (update.t_ns - self._epoch_ns) // 1000, _RATE_NOISE)
        if fields is None:
            return []
        if update.status is OdometryStatus.LOST:
            fields["quality"] = _FAILED_QUALITY
        return [self._encoder.encode(MavlinkMessage("ODOMETRY", SYSTEM_ID, COMPONENT_ID, fields))]


def serve(profile: Profile, points_port: int, imu_port: int, to: tuple[str, int], clock: SystemClock) -> int:
    """Listen for copies of the LiDAR's packets and send odometry until SIGTERM or SIGINT.

    Args:
        profile: the vehicle's.
        points_port: UDP port for copies of point packets, on the host address of the profile.
        imu_port: the same for inertial packets.
        to: where ODOMETRY goes.
        clock: the host's time.

    Returns:
        The number of messages sent.

    Raises:
        OSError: if a port is taken.
    """
    peer = OdometryPeer(profile, clock.now_ns())
    wake_end, waker = socket.socketpair()
    waker.setblocking(False)

    def end(number: int, frame: FrameType | None) -> None:
        waker.send(b"x")

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    host_ip = "127.0.0.1" if profile.lidar.host_ip == "auto" else profile.lidar.host_ip
    sent = 0
    with (
        selectors.DefaultSelector() as selector,
        wake_end,
        waker,
        _listening(host_ip, points_port) as points,
        _listening(host_ip, imu_port) as imu,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outlet,
    ):
        for endpoint in (wake_end, points, imu):
            selector.register(endpoint, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                ready = key.fileobj
                assert isinstance(ready, socket.socket)
                if ready is wake_end:
                    _log.info("odometry peer: stopped", sent=sent)
                    return sent
                payload, source = ready.recvfrom(_MAX_DATAGRAM_SIZE)
                destination = ready.getsockname()
                for event in peer.receive(Datagram(clock.now_ns(), source, destination, payload)):
                    for update in peer.perceive(event):
                        for data in peer.encode(update):
                            outlet.sendto(data, to)
                            sent += 1


def _listening(ip: str, port: int) -> socket.socket:
    endpoint = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
    try:
        endpoint.bind((ip, port))
    except OSError:
        endpoint.close()
        raise
    return endpoint
