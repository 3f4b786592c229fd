"""What a replayed flight hands its records to: comparisons with the recorded ones, and a new log."""

from collections.abc import Callable, Hashable, Iterable
from typing import Protocol

from companion.logs import channels
from companion.logs.channels import Channel
from companion.logs.reader import EncodedEntry
from companion.logs.records import FrameSummary, ScanMark
from companion.logs.views import CloudSampler, Recordable, views_of
from companion.logs.writer import LogSettings
from companion.messages import (
    Datagram,
    ExternalOdometry,
    ImuSample,
    MavlinkMessage,
    NeighbourTracks,
    Odometry,
    RegisteredScan,
)
from companion.replay.comparison import (
    ChannelResult,
    Comparison,
    Ends,
    NamedComparison,
    OnDifferent,
    SentComparison,
)

PERCEPTION = (
    channels.LIDAR_FRAMES,
    channels.IMU,
    channels.ODOMETRY,
    channels.NEIGHBOURS,
    channels.SCAN,
    channels.CLOUD,
)
DECISIONS = (
    channels.VEHICLE,
    channels.AUTHORISATION,
    channels.SETPOINT,
    channels.MODE_REQUEST,
    channels.STATE,
    channels.PLAN,
    channels.GIVEN,
    channels.GRID,
    channels.LOG,
)


def made_topics(*, decisions: bool) -> frozenset[str]:
    """Return the topics that a replay makes anew, with or without decisions.

    Among them are views of what is compared already: they belong into a new log and need no comparison.
    """
    decided = (*DECISIONS, channels.PATH, channels.MAVLINK_TX) if decisions else ()
    return frozenset(channel.topic for channel in (*PERCEPTION, channels.POSE, *decided))


class Output(Protocol):
    """Takes the messages of a new log."""

    def write(self, channel: Channel, message: object, t_ns: int) -> None:
        """Take one message, handled at host time `t_ns`."""
        ...


class ReplayRecorder:
    """Takes the records of a replayed flight, as the flight log does in flight."""

    def __init__(
        self,
        settings: LogSettings,
        *,
        decisions: bool,
        on_odometry: OnDifferent | None = None,
        output: Output | None = None,
    ) -> None:
        """Prepare.

        Args:
            settings: what the replayed flight would log.
            decisions: compare decisions too, not perception alone.
            on_odometry: told of every pair of odometry estimates that differ.
            output: takes all records of a new log.
        """
        self.sent = SentComparison(channels.MAVLINK_TX) if decisions else None
        compared = PERCEPTION + (DECISIONS if decisions else ())
        switches = (
            (channels.CLOUD.topic, settings.clouds),
            (channels.IMU.topic, settings.imu),
            (channels.GIVEN.topic, settings.surroundings),
            (channels.GRID.topic, settings.surroundings),
        )
        self._off = {topic for topic, on in switches if not on}
        self._named: dict[str, Comparison] = {
            channel.topic: NamedComparison(
                channel,
                _NAMES.get(channel.topic),
                on_odometry if channel is channels.ODOMETRY else None,
            )
            for channel in compared
        }
        if self.sent is not None:
            self._named[channels.MAVLINK_TX.topic] = self.sent
        self._made = made_topics(decisions=decisions)
        self._clouds = CloudSampler(settings.cloud_rate_hz, settings.cloud_points)
        self._output = output

    def compare(self, entry: EncodedEntry) -> None:
        """Take one message of the recorded flight, if its channel is compared."""
        comparison = self._named.get(entry.channel.topic)
        if comparison is not None:
            comparison.take_recorded(entry)

    def record(self, message: Recordable | Datagram, t_ns: int) -> None:
        """Take a message of the replayed flight, handled at host time `t_ns`."""
        if isinstance(message, Datagram | ExternalOdometry):
            return
        for channel, view in views_of(message):
            self.write(channel, view, t_ns)
        if isinstance(message, RegisteredScan) and channels.CLOUD.topic not in self._off:
            cloud = self._clouds.take(message, t_ns)
            if cloud is not None:
                self.write(channels.CLOUD, cloud, t_ns)

    def write(self, channel: Channel, message: object, t_ns: int) -> None:
        """Take a message of the replayed flight on one channel; what it was fed with is left out."""
        if channel.topic in self._off or channel.topic not in self._made:
            return
        comparison = self._named.get(channel.topic)
        if comparison is not None:
            comparison.take_replayed(message, t_ns)
        if self._output is not None:
            self._output.write(channel, message, t_ns)

    def decided(self, messages: Iterable[MavlinkMessage], t_ns: int) -> None:
        """Take what the replayed flight sends to the autopilot."""
        for message in messages:
            if self.sent is not None:
                self.sent.take_replayed(message, t_ns)
            if self._output is not None:
                self._output.write(channels.MAVLINK_TX, message, t_ns)

    def results(self, ends_of: Callable[[Channel], Ends]) -> list[ChannelResult]:
        """Return how every channel came out that holds anything.

        Args:
            ends_of: where the recording of a channel ends.
        """
        found = [
            comparison.finish(ends_of(channels.BY_TOPIC[topic])) for topic, comparison in self._named.items()
        ]
        return [result for result in found if result.equal or result.cut_off or not result.agrees]


def _stamp(message: object) -> Hashable:
    assert isinstance(message, ImuSample | Odometry)
    return message.t_sensor_ns


def _number(message: object) -> Hashable:
    assert isinstance(message, FrameSummary | ScanMark | NeighbourTracks)
    return message.sequence


_NAMES: dict[str, Callable[[object], Hashable]] = {
    channels.LIDAR_FRAMES.topic: _number,
    channels.IMU.topic: _stamp,
    channels.ODOMETRY.topic: _stamp,
    channels.NEIGHBOURS.topic: _number,
    channels.SCAN.topic: _number,
}
