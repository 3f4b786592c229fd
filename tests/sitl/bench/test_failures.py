"""Each kind of failure in an emulated flight is reported in time; the clean flight is quiet."""

import copy
from dataclasses import dataclass

import numpy as np
import pytest

from companion.messages import ImuSample, LidarScan, OdometryStatus
from companion.perception.odometry.lio import LidarInertialOdometry
from sitl.bench import failures
from sitl.bench.courses import course
from sitl.bench.failure_catalogue import FAILURES, Moment, lose_packets
from sitl.bench.synthetic_flights import Flight, fly

_FAILED_S = 9.31  # while it turns
_SEED = 51


@dataclass
class _Scene:
    flight: Flight
    lio: LidarInertialOdometry
    moment: Moment


@pytest.fixture(scope="module")
def scene() -> _Scene:
    """An odometry that has flown up to the moment of failure without any report."""
    flight = fly(course("pillars", _SEED), 10.5, np.random.default_rng(_SEED))
    position = next(
        i + 1
        for i, event in enumerate(flight.events)
        if isinstance(event, ImuSample) and event.t_sensor_ns >= _FAILED_S * 1e9
    )
    lio = failures.odometry()
    for event in flight.events[:position]:
        lio.handle(event)
    return _Scene(flight, lio, failures.moment_at(flight, position))


@pytest.mark.parametrize("name", FAILURES)
def test_a_failure_is_reported_within_three_tenths_of_a_second(scene: _Scene, name: str) -> None:
    changed = FAILURES[name](scene.moment, np.random.default_rng(7))
    assert changed is not None
    report = failures.first_report(copy.deepcopy(scene.lio), changed)
    assert report is not None
    t_ns, entry = report
    assert (t_ns - scene.moment.before[-1].t_ns) * 1e-6 <= failures.IN_TIME_MS
    assert entry.reason
    assert entry.status in (OdometryStatus.DEGRADED, OdometryStatus.LOST)


def test_the_flight_without_failure_is_quiet(scene: _Scene) -> None:
    assert failures.first_report(copy.deepcopy(scene.lio), scene.moment.after) is None
    assert failures.false_alarm(scene.flight.events) == ""


def test_a_fifth_of_all_packets_may_be_lost_without_alarm(scene: _Scene) -> None:
    lossy = lose_packets(scene.flight.events, 0.2, 480_000, np.random.default_rng(3))
    samples = sum(isinstance(event, ImuSample) for event in lossy)
    assert samples / sum(isinstance(e, ImuSample) for e in scene.flight.events) == pytest.approx(
        0.8, abs=0.03
    )
    returns = [len(event.points_lidar) for event in lossy if isinstance(event, LidarScan)]
    whole = [len(event.points_lidar) for event in scene.flight.events if isinstance(event, LidarScan)]
    assert sum(returns) / sum(whole) == pytest.approx(0.8, abs=0.02)
    assert failures.false_alarm(lossy) == ""


def test_a_failure_changes_nothing_before_its_moment(scene: _Scene) -> None:
    for name, inject in FAILURES.items():
        changed = inject(scene.moment, np.random.default_rng(7))
        if changed is None:
            continue
        times = [event.t_ns for event in changed]
        assert times == sorted(times), name
        assert not times or times[0] > scene.moment.before[-1].t_ns, name


def test_rows_count_what_came_in_time() -> None:
    row = failures.row_of("x", [100.0, 300.0, 301.0, np.inf])
    assert (row.runs, row.reported, row.reported_percent) == (4, 2, 50.0)
    assert (row.delay_ms_median, row.delay_ms_max) == (300.0, 301.0)
    assert failures.row_of("x", [np.inf]).delay_ms_max is None


def test_flights_too_short_to_fail_in_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 8 s"):
        failures.measure_failures(1, 1, 5.0, lambda row: None)
