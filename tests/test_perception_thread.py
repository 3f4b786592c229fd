"""The perception thread keeps what it can and counts what it cannot."""

import threading
from collections.abc import Sequence

import numpy as np

from companion.messages import ImuSample, LidarScan, PerceptionUpdate, SensorEvent
from companion.perception_thread import PerceptionThread
from companion.pipeline import Estimator, Pipeline
from companion.safety.settings import SafetySettings
from tests.hold_role import HoldRole
from tests.pipeline_rig import NoTracker


class GatedEstimator:
    """Waits for a gate before each event and remembers what it saw."""

    def __init__(self) -> None:
        self.gate = threading.Event()
        self.entered = threading.Event()
        self.seen: list[SensorEvent] = []

    def handle(self, event: SensorEvent) -> list[PerceptionUpdate]:
        self.entered.set()
        self.gate.wait(5.0)
        self.seen.append(event)
        return []


def thread_with(estimator: Estimator, failures: list[Exception]) -> PerceptionThread:
    pipeline = Pipeline(
        estimator=estimator,
        tracker=NoTracker(),
        role=HoldRole(),
        safety=SafetySettings(),
        authorisation_sources=(),
    )

    def deliver(updates: Sequence[PerceptionUpdate]) -> None:
        raise AssertionError("nothing to deliver")

    return PerceptionThread(pipeline, deliver, lambda: None, failures.append)


def imu(t_ns: int) -> ImuSample:
    return ImuSample(t_ns, t_ns, np.zeros(3), np.zeros(3))


def scan(sequence: int) -> LidarScan:
    return LidarScan(
        t_ns=sequence,
        sequence=sequence,
        t_sensor_start_ns=0,
        t_sensor_end_ns=1,
        clock_offset_ns=0,
        points_lidar=np.zeros((0, 3), np.float32),
        offsets_ns=np.zeros(0, np.int32),
        reflectivity=np.zeros(0, np.uint8),
        tags=np.zeros(0, np.uint8),
        packets=0,
        packets_expected=0,
    )


def test_when_perception_is_late_scans_are_dropped_but_no_imu_sample() -> None:
    estimator = GatedEstimator()
    thread = thread_with(estimator, [])
    thread.start()
    thread.submit(imu(0))
    assert estimator.entered.wait(5.0)
    places = []
    told: list[tuple[int, int | None]] = []
    for index in range(10):
        places.append(thread.submit(scan(index)))
        places.append(thread.submit(imu(index + 1), lambda event, place: told.append((event.t_ns, place))))
    assert [place for _, place in told] == places[1::2]
    assert places == [1, 2, 3, 4, 5, 6, *(place for index in range(7) for place in (None, 7 + index))]
    estimator.gate.set()
    thread.stop()
    assert thread.dropped == 7
    assert sum(isinstance(event, ImuSample) for event in estimator.seen) == 11
    assert [event.sequence for event in estimator.seen if isinstance(event, LidarScan)] == [0, 1, 2]


def test_the_queue_is_bounded() -> None:
    estimator = GatedEstimator()
    thread = thread_with(estimator, [])
    thread.start()
    for index in range(1000):
        thread.submit(imu(index))
    estimator.gate.set()
    thread.stop()
    assert len(estimator.seen) <= 401
    assert thread.dropped == 1000 - len(estimator.seen)


class FailingEstimator:
    """Breaks on the first event."""

    def handle(self, event: SensorEvent) -> list[PerceptionUpdate]:
        raise ZeroDivisionError("broken")


def test_a_failure_in_the_thread_is_told_and_not_swallowed() -> None:
    failures: list[Exception] = []
    thread = thread_with(FailingEstimator(), failures)
    thread.start()
    thread.submit(imu(0))
    thread.stop()
    assert [type(failure) for failure in failures] == [ZeroDivisionError]
