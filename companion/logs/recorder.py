"""What the flight hands its records to: a log on the disk, or a replay that compares them."""

from typing import Protocol

from companion.logs.channels import Channel
from companion.logs.views import Recordable
from companion.messages import Datagram


class Recorder(Protocol):
    """Takes what is to be kept of a flight."""

    def record(self, message: Recordable | Datagram, t_ns: int) -> None:
        """Keep a message, handled at host time `t_ns`, on the channels where its kind belongs."""
        ...

    def write(self, channel: Channel, message: object, t_ns: int) -> None:
        """Keep a message, handled at host time `t_ns`, on one channel."""
        ...
