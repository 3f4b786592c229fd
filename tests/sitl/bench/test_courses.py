import itertools

import numpy as np
import pytest

from companion.messages import ImuSample, LidarScan
from sitl.bench.courses import COURSES, course
from sitl.bench.synthetic_flights import SCAN_NS, fly, stream


@pytest.mark.parametrize("name", COURSES)
def test_equal_seeds_give_equal_worlds_and_other_seeds_others(name: str) -> None:
    one, same, other = course(name, 1), course(name, 1), course(name, 2)
    np.testing.assert_array_equal(one.world.rows, same.world.rows)
    assert one.world.rows.shape != other.world.rows.shape or not np.array_equal(
        one.world.rows, other.world.rows
    )


@pytest.mark.parametrize("name", COURSES)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_stands_in_the_way_of_the_planned_rounds(name: str, seed: int) -> None:
    wanted = course(name, seed)
    path = wanted.path_world()
    assert wanted.world.obstacles().clearance(path).min() >= 0.7
    on_ground = np.array([[wanted.half_axes_m[0], 0.0, 0.1]])
    assert wanted.world.clearance(on_ground)[0] == pytest.approx(0.1)


@pytest.mark.parametrize("name", COURSES)
def test_flights_as_flown_touch_nothing(name: str) -> None:
    wanted = course(name, 1)
    flown = [step.truth for step in stream(wanted, 9.0, np.random.default_rng(1))]
    p_world = np.array([truth.p_world for truth in flown])
    speeds = np.linalg.norm([truth.v_world for truth in flown], axis=1)
    assert wanted.world.obstacles().clearance(p_world).min() > 0.4
    assert p_world[-500:, 2].min() > 1.0
    assert np.median(speeds[-500:]) > 0.9 * wanted.speed


def test_the_aggressive_course_is_flown_at_three_metres_a_second_and_ninety_degrees_a_second() -> None:
    flown = [step.truth for step in stream(course("aggressive", 2), 12.0, np.random.default_rng(1))][-1000:]
    assert np.percentile(np.linalg.norm([truth.v_world for truth in flown], axis=1), 10) > 3.0
    assert np.degrees(np.mean([truth.omega_body[2] for truth in flown])) > 75.0
    assert np.ptp([truth.p_world[2] for truth in flown]) > 1.5


def test_streaming_equals_collecting() -> None:
    wanted = course("open_field", 3)
    whole = fly(wanted, 3.0, np.random.default_rng(5))
    steps = list(stream(wanted, 3.0, np.random.default_rng(5)))
    assert [step.t_sensor_ns for step in steps] == whole.t_sensor_ns.tolist()
    events = [event for step in steps for event in step.events]
    assert len(events) == len(whole.events)
    for ours, theirs in zip(events, whole.events, strict=True):
        if isinstance(ours, LidarScan) and isinstance(theirs, LidarScan):
            np.testing.assert_array_equal(ours.points_lidar, theirs.points_lidar)
        else:
            assert isinstance(ours, ImuSample)
            assert isinstance(theirs, ImuSample)
            np.testing.assert_array_equal(ours.accel_imu, theirs.accel_imu)
    np.testing.assert_array_equal([step.truth.p_world for step in steps], whole.p_world)


def test_events_come_in_order_with_a_scan_every_tenth_of_a_second() -> None:
    steps = itertools.islice(stream(course("indoor", 1), 100.0, np.random.default_rng(1)), 101)
    events = [event for step in steps for event in step.events]  # taken from a flight far from over
    assert all(after.t_ns >= before.t_ns for before, after in itertools.pairwise(events))
    scans = [event for event in events if isinstance(event, LidarScan)]
    assert [scan.t_sensor_end_ns for scan in scans] == [SCAN_NS * (index + 1) for index in range(5)]
    assert sum(isinstance(event, ImuSample) for event in events) == 100
