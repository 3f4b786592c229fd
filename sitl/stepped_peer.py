"""Somebody else's odometry, driven step by step: the same bytes, without its process."""

from companion.config import Profile
from companion.messages import Datagram
from sitl.odometry_peer import OdometryPeer
from sitl.stepped_companion import PerceptionQueue

ADDRESS = ("127.0.0.1", 57_000)
"""From which its messages come."""


class SteppedPeer:
    """Hears what the companion hears of the LiDAR and sends odometry."""

    def __init__(self, profile: Profile, start_ns: int, perception_latency_ns: int) -> None:
        """Start at `start_ns`; `perception_latency_ns` is what computing a scan takes."""
        self._peer = OdometryPeer(profile, start_ns)
        self._data_ports = (profile.lidar.host_ports.points, profile.lidar.host_ports.imu)
        self._queue = PerceptionQueue(self._peer, perception_latency_ns)

    def receive_datagram(self, datagram: Datagram) -> None:
        """Take a copy of one of the LiDAR's datagrams."""
        if datagram.destination[1] in self._data_ports:
            for event in self._peer.receive(datagram):
                self._queue.submit(event)

    def step(self, t_ns: int) -> list[bytes]:
        """Return the messages that are sent at `t_ns`."""
        return [data for update in self._queue.finished(t_ns) for data in self._peer.encode(update)]
