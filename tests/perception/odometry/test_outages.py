"""Flights whose sensors fall silent for a while: bridged, found again, or refused; never wrong and sure."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from companion.messages import FloatArray, ImuSample, LidarScan, Odometry, OdometryStatus
from tests.perception.odometry.conftest import SMALL, Outcome, errors, run
from tests.perception.odometry.simulated_flight import SimulatedFlight, loop_trajectory, room

Events = list[ImuSample | LidarScan]
START_NS = 4_030_000_000
_SETTINGS = SMALL.model_copy(update={"output_hz": 50.0})


@pytest.fixture(scope="module")
def flight() -> SimulatedFlight:
    trajectory = loop_trajectory(14.0, speed=2.0, size_m=(5.0, 3.2), height_m=1.8)
    return SimulatedFlight(room(), trajectory, seed=8)


@pytest.fixture(scope="module")
def events(flight: SimulatedFlight) -> Events:
    return list(flight.events())


def _without(
    events: Events, silent_s: float, gone: Callable[[ImuSample | LidarScan], bool], end_s: float
) -> Events:
    """Leave out what `gone` names during the silence, and everything after `end_s`."""
    kept: Events = []
    for event in events:
        t_ns = event.t_sensor_ns if isinstance(event, ImuSample) else event.t_sensor_end_ns
        silent = START_NS < t_ns <= START_NS + silent_s * 1e9
        if t_ns < end_s * 1e9 and not (silent and gone(event)):
            kept.append(event)
    return kept


def _is_scan(event: ImuSample | LidarScan) -> bool:
    return isinstance(event, LidarScan)


def _is_sample(event: ImuSample | LidarScan) -> bool:
    return isinstance(event, ImuSample)


def _off_m(flight: SimulatedFlight, odometry: list[Odometry]) -> FloatArray:
    p, _, p_true, _ = errors(flight, odometry)
    return np.asarray(np.linalg.norm(p - p_true, axis=1))


def _sure(outcome: Outcome, since_s: float) -> list[Odometry]:
    return [
        entry
        for entry in outcome.odometry
        if entry.status is OdometryStatus.TRACKING and entry.t_sensor_ns > since_s * 1e9
    ]


def test_two_seconds_without_scans_are_found_out_of_within_centimetres(
    flight: SimulatedFlight, events: Events
) -> None:
    outcome = run(_without(events, 2.0, _is_scan, 8.5), _SETTINGS)
    statuses = [entry.status for entry in outcome.odometry]
    assert OdometryStatus.LOST not in statuses
    blind = [e for e in outcome.odometry if START_NS + 400_000_000 < e.t_sensor_ns < START_NS + 2_000_000_000]
    assert all(entry.status is OdometryStatus.DEGRADED for entry in blind)
    back = _sure(outcome, START_NS * 1e-9 + 2.0)
    assert back[0].t_sensor_ns < START_NS + 4_000_000_000
    assert float(_off_m(flight, back).max()) < 0.1


def test_after_a_loss_the_place_is_found_again_by_way_of_degraded_with_a_new_reset_counter(
    flight: SimulatedFlight, events: Events
) -> None:
    settings = _SETTINGS.model_copy(update={"lost_after_s": 1.5})
    outcome = run(_without(events, 2.0, _is_scan, 8.5), settings)
    statuses = [entry.status for entry in outcome.tracked]
    lost = statuses.index(OdometryStatus.LOST)
    found = next(i for i in range(lost, len(statuses)) if statuses[i] is not OdometryStatus.LOST)
    assert statuses[found] is OdometryStatus.DEGRADED
    assert outcome.tracked[found].reason == "place found again after an outage"
    assert statuses[-1] is OdometryStatus.TRACKING
    assert {entry.reset_counter for entry in outcome.tracked[:found]} == {0}
    assert {entry.reset_counter for entry in outcome.tracked[found:]} == {1}
    assert float(_off_m(flight, outcome.tracked[found:]).max()) < 0.15


def test_six_seconds_without_scans_never_end_in_a_wrong_and_sure_pose(
    flight: SimulatedFlight, events: Events
) -> None:
    outcome = run(_without(events, 6.0, _is_scan, 14.0), _SETTINGS)
    lost = [entry for entry in outcome.odometry if entry.status is OdometryStatus.LOST]
    assert lost[0].t_sensor_ns < START_NS + 4_200_000_000
    sure = _sure(outcome, START_NS * 1e-9 + 6.0)
    if sure:
        assert float(_off_m(flight, sure).max()) < 0.3
        assert sure[-1].reset_counter == 1
    else:
        assert outcome.odometry[-1].status in (OdometryStatus.LOST, OdometryStatus.INITIALISING)
        assert outcome.odometry[-1].reason


def test_an_outage_too_uncertain_to_search_ends_as_lost(events: Events) -> None:
    # Saturated meanwhile, the IMU leaves a region too large for a search, long before `lost_after_s`.
    shaken: Events = []
    for event in _without(events, 1.3, _is_scan, 6.0):
        if isinstance(event, ImuSample) and START_NS < event.t_sensor_ns <= START_NS + 50_000_000:
            sign = 1.0 if len(shaken) % 2 else -1.0
            event = replace(event, accel_imu=np.array([78.5 * sign, event.accel_imu[1], event.accel_imu[2]]))
        shaken.append(event)
    outcome = run(shaken, _SETTINGS)
    ended = next(entry for entry in outcome.odometry if entry.reset_counter == 1)
    assert ended.status is OdometryStatus.LOST
    assert ended.quality == 0
    assert ended.reason == "the place could be too far away to be searched"
    assert START_NS + 1_300_000_000 < ended.t_sensor_ns < START_NS + 1_600_000_000


def test_when_the_imu_falls_silent_the_scans_tell(flight: SimulatedFlight, events: Events) -> None:
    outcome = run(_without(events, 3.0, _is_sample, 6.0), _SETTINGS)
    after = [entry for entry in outcome.odometry if entry.t_sensor_ns > START_NS]
    assert after[0].t_ns <= START_NS + 5_000_000_000 + 200_000_000
    assert after[0].status is OdometryStatus.DEGRADED
    assert after[0].reason.startswith("IMU silent for 0.")
    assert after[0].quality <= 10
    # It is the prediction that is told, and how little it knows.
    assert float(_off_m(flight, after[:1])[0]) < 0.2
    lost = next(entry for entry in after if entry.status is OdometryStatus.LOST)
    assert lost.t_sensor_ns <= START_NS + 800_000_000
    assert lost.reset_counter == 1
    times = [entry.t_ns for entry in outcome.odometry]
    assert times == sorted(times)


def test_a_short_silence_of_the_imu_is_told_and_bridged(flight: SimulatedFlight, events: Events) -> None:
    outcome = run(_without(events, 0.3, _is_sample, 6.0), _SETTINGS)
    assert any(entry.reason.startswith("IMU silent") for entry in outcome.odometry)
    assert outcome.odometry[-1].status is OdometryStatus.TRACKING
    assert outcome.odometry[-1].reset_counter <= 1
    assert float(_off_m(flight, outcome.odometry[-20:]).max()) < 0.1
    times = [entry.t_ns for entry in outcome.odometry]
    assert times == sorted(times)


def test_covering_the_laser_is_told_at_the_next_scan(events: Events) -> None:
    def cover(event: ImuSample | LidarScan) -> ImuSample | LidarScan:
        if isinstance(event, LidarScan) and event.t_sensor_end_ns > START_NS:
            kept = slice(0, 10)
            return LidarScan(
                event.t_ns,
                event.sequence,
                event.t_sensor_start_ns,
                event.t_sensor_end_ns,
                event.clock_offset_ns,
                event.points_lidar[kept],
                event.offsets_ns[kept],
                event.reflectivity[kept],
                event.tags[kept],
                event.packets,
                event.packets_expected,
            )
        return event

    outcome = run([cover(event) for event in _without(events, 0.0, _is_scan, 4.6)], _SETTINGS)
    told = next(entry for entry in outcome.odometry if entry.reason == "LiDAR sees nothing: 10 returns")
    assert told.t_sensor_ns < START_NS + 150_000_000
