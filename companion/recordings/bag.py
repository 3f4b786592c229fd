"""ROS bags of a Mid-360: CustomMsg or PointCloud2 for the points, Imu for the inertial samples."""

from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from posixpath import dirname

import numpy as np

from companion.clock import ns_to_seconds
from companion.drivers.livox_clock import ClockOffsetEstimator
from companion.drivers.livox_packets import STANDARD_GRAVITY_M_S2
from companion.drivers.livox_settings import LivoxSettings
from companion.errors import LogError
from companion.messages import ImuSample, SensorEvent
from companion.recordings.bag_container import BagContainer, BagMessage, BagTopic
from companion.recordings.bag_settings import BagSettings
from companion.recordings.recording import EventTally, RecordingSummary
from companion.recordings.ros_messages import (
    CUSTOM_DIGEST,
    STAMPS_AGREE_NS,
    RosPoints,
    decode_cloud,
    decode_custom,
    decode_inertial,
)
from companion.recordings.scan_cutter import ScanCutter

CUSTOM_TYPES = (
    "livox_ros_driver2/msg/CustomMsg",
    "livox_ros_driver/msg/CustomMsg",
    "livox_interfaces/msg/CustomMsg",
)
CLOUD_TYPES = ("sensor_msgs/msg/PointCloud2",)
INERTIAL_TYPES = ("sensor_msgs/msg/Imu",)
JUDGED_SAMPLES = 400
"""Inertial messages whose median tells the unit of acceleration: two seconds."""
JUDGED_CLOUDS = 50
"""Messages with points of which one has to be usable."""

_G_RANGE = (0.5, 2.0)
_SI_RANGE = (0.5 * STANDARD_GRAVITY_M_S2, 2.0 * STANDARD_GRAVITY_M_S2)


class BagRecording:
    """The messages of one sensor in a bag."""

    def __init__(
        self, path: Path, container: BagContainer, lidar: LivoxSettings, settings: BagSettings
    ) -> None:
        """Find the topics and the unit of acceleration.

        Raises:
            LogError: if there are no points, several topics could be meant, or the unit cannot be told.
        """
        self._path = path
        self._container = container
        self._lidar = lidar
        self._notes: list[str] = []
        self._points = self._points_topic(settings.points_topic)
        self._inertial = self._inertial_topic(settings.imu_topic)
        self._require_points()
        self._unit_m_s2 = self._acceleration_unit(settings)
        self._summary: RecordingSummary | None = None

    @property
    def kind(self) -> str:
        """The bag's generation."""
        return self._container.kind

    def events(self) -> Iterator[SensorEvent]:
        """Yield samples and scans in the order in which they were recorded.

        Raises:
            OSError: if reading the disk fails.
        """
        run = _Pass(self._lidar, self._unit_m_s2, cdr=self._container.cdr, has_imu=self._inertial is not None)
        tally = EventTally()
        names = [topic.name for topic in (self._points, self._inertial) if topic is not None]
        ending = ""
        try:
            for message in self._container.messages(*names):
                for event in run.take(message, points=message.topic.name == self._points.name):
                    tally.count(event)
                    yield event
        except LogError as error:
            ending = f"the recording ends early: {error}"
        notes = [*self._notes, *run.notes()] + ([ending] if ending else [])
        if not tally.imu_samples:
            notes.append("the recording has no inertial samples: scans only")
        self._summary = RecordingSummary(
            kind=self.kind,
            sensor=" and ".join(names),
            duration_s=tally.duration_s,
            scans=tally.scans,
            points=tally.points,
            imu_samples=tally.imu_samples,
            lost=0,
            complete=not ending,
            skipped=run.skipped(),
            notes=tuple(notes),
        )

    def summary(self) -> RecordingSummary:
        """Return what the last complete pass over the events found; makes one if there was none."""
        if self._summary is None:
            for _ in self.events():
                pass
        assert self._summary is not None
        return self._summary

    def _points_topic(self, wanted: str) -> BagTopic:
        found = self._of_types(CUSTOM_TYPES)
        clouds = self._of_types(CLOUD_TYPES)
        if wanted:
            topic = self._named(wanted, found + clouds, "points")
        elif candidates := found or clouds:
            topic = self._only(candidates, "points", "points_topic")
        else:
            types = sorted({topic.message_type for topic in self._container.topics})
            raise LogError(
                f"{self._path}: no topic with CustomMsg or PointCloud2; the bag holds "
                f"{', '.join(types) or 'no topics at all'}"
            )
        if topic.message_type in CUSTOM_TYPES and not self._container.cdr and topic.digest != CUSTOM_DIGEST:
            raise LogError(f"{self._path}: {topic.name} has another definition of CustomMsg ({topic.digest})")
        return topic

    def _inertial_topic(self, wanted: str) -> BagTopic | None:
        found = self._of_types(INERTIAL_TYPES)
        if wanted:
            return self._named(wanted, found, "inertial samples")
        # A flight controller's IMU is often recorded too; the sensor's own has its name space.
        own = [topic for topic in found if dirname(topic.name) == dirname(self._points.name)]
        if len(found) > 1 and len(own) == 1:
            others = ", ".join(topic.name for topic in found if topic is not own[0])
            self._notes.append(f"inertial samples are taken from {own[0].name}, not from {others}")
            return own[0]
        return self._only(found, "inertial samples", "imu_topic") if found else None

    def _of_types(self, types: tuple[str, ...]) -> list[BagTopic]:
        return [topic for topic in self._container.topics if topic.message_type in types]

    def _named(self, wanted: str, found: list[BagTopic], what: str) -> BagTopic:
        for topic in found:
            if topic.name == wanted:
                return topic
        names = ", ".join(topic.name for topic in found) or "none"
        raise LogError(f"{self._path}: no topic {wanted} with {what}; there is {names}")

    def _only(self, found: list[BagTopic], what: str, key: str) -> BagTopic:
        if len({topic.name for topic in found}) > 1:
            names = ", ".join(topic.name for topic in found)
            raise LogError(f"{self._path}: several topics with {what}: {names}; choose one with {key}")
        return found[0]

    def _require_points(self) -> None:
        """Look whether the first messages with points can be used at all."""
        reason = "no messages"
        for message in islice(self._container.messages(self._points.name), JUDGED_CLOUDS):
            reason = _unusable(message, cdr=self._container.cdr)
            if not reason:
                return
        raise LogError(f"{self._path}: {self._points.name} cannot be used: {reason}")

    def _acceleration_unit(self, settings: BagSettings) -> float:
        """Return the unit of the file's accelerations in m/s^2: g or 1."""
        if self._inertial is None:
            return 1.0
        if settings.acceleration_unit != "auto":
            return STANDARD_GRAVITY_M_S2 if settings.acceleration_unit == "g" else 1.0
        norms = list(islice(self._accelerations(self._inertial.name), JUDGED_SAMPLES))
        if not norms:
            return 1.0
        median = float(np.median(norms))
        if _G_RANGE[0] <= median <= _G_RANGE[1]:
            self._notes.append(
                f"accelerations are in g (median {median:.3f} at the start), converted to m/s^2"
            )
            return STANDARD_GRAVITY_M_S2
        if _SI_RANGE[0] <= median <= _SI_RANGE[1]:
            self._notes.append(f"accelerations are in m/s^2 (median {median:.2f} at the start)")
            return 1.0
        raise LogError(
            f"{self._path}: accelerations of {median:.3g} on {self._inertial.name} are neither 1 g nor "
            "9.81 m/s^2; say which with acceleration_unit"
        )

    def _accelerations(self, topic: str) -> Iterator[float]:
        try:
            for message in self._container.messages(topic):
                try:
                    inertial = decode_inertial(message.data, cdr=self._container.cdr)
                except ValueError:
                    continue
                yield float(np.linalg.norm(inertial.accel))
        except LogError:
            # The events will end there too, and say so.
            return


class _Pass:
    """Turns messages into events, from the beginning of a bag to its end."""

    def __init__(self, lidar: LivoxSettings, unit_m_s2: float, *, cdr: bool, has_imu: bool) -> None:
        self._cutter = ScanCutter(lidar)
        self._clock = ClockOffsetEstimator()
        self._unit_m_s2 = unit_m_s2
        self._cdr = cdr
        self._has_imu = has_imu
        self._skipped: Counter[str] = Counter()
        self._worst_ns = 0
        self._last_imu_ns: int | None = None

    def take(self, message: BagMessage, *, points: bool) -> list[SensorEvent]:
        """Return the events that a message completes; what cannot be decoded is counted by its reason."""
        try:
            return self._scans(message) if points else self._sample(message)
        except ValueError as error:
            self._skipped[f"messages: {error}"] += 1
            return []

    def skipped(self) -> dict[str, int]:
        """Return what was left out, by reason."""
        total = self._skipped + Counter(
            {
                "late points": self._cutter.late,
                "points too many for their scan": self._cutter.overflowed,
                "steps of the clock backwards": self._cutter.jumps,
            }
        )
        return {what: count for what, count in sorted(total.items()) if count}

    def notes(self) -> list[str]:
        """Return what was noticed on the way."""
        if abs(self._worst_ns) <= STAMPS_AGREE_NS:
            return []
        apart = ns_to_seconds(self._worst_ns)
        return [f"time base and header stamp are {apart:.3f} s apart: the header's clock was used"]

    def _scans(self, message: BagMessage) -> list[SensorEvent]:
        points = _decode_points(message, cdr=self._cdr)
        if abs(points.disagreement_ns) > abs(self._worst_ns):
            self._worst_ns = points.disagreement_ns
        if not self._has_imu and len(points.t_ns):
            self._clock.update(message.t_ns, int(points.t_ns.max()))
        return list(self._cutter.add(message.t_ns, points, self._clock.offset_ns))

    def _sample(self, message: BagMessage) -> list[SensorEvent]:
        inertial = decode_inertial(message.data, cdr=self._cdr)
        # Small inertial messages wait least on their way: they tell the clocks' offset best.
        self._clock.update(message.t_ns, inertial.t_ns)
        if inertial.t_ns == self._last_imu_ns:
            raise ValueError("an inertial message with the stamp of the one before")
        self._last_imu_ns = inertial.t_ns
        return [ImuSample(message.t_ns, inertial.t_ns, inertial.gyro_imu, inertial.accel * self._unit_m_s2)]


def _decode_points(message: BagMessage, *, cdr: bool) -> RosPoints:
    decode = decode_cloud if message.topic.message_type in CLOUD_TYPES else decode_custom
    return decode(message.data, cdr=cdr)


def _unusable(message: BagMessage, *, cdr: bool) -> str:
    """Return what is wrong with a message that should hold points; empty if nothing is."""
    try:
        return "" if len(_decode_points(message, cdr=cdr).t_ns) else "messages without points"
    except ValueError as error:
        return str(error)
