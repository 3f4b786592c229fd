import dataclasses

import numpy as np
import pytest

from companion.geometry import rotation, trajectory_error
from companion.messages import ImuSample, LidarScan, OdometryStatus
from companion.perception.odometry.settings import OdometrySettings
from tests.perception.odometry.conftest import SMALL, Outcome, errors, run
from tests.perception.odometry.simulated_flight import (
    CLOCK_OFFSET_NS,
    SCAN_NS,
    T_BODY_LIDAR,
    T_LIDAR_IMU,
    SensorErrors,
    SimulatedFlight,
    Trajectory,
    hover_trajectory,
    loop_trajectory,
    open_field,
    pillar_field,
    room,
)

Events = list[ImuSample | LidarScan]


def _shifted(event: ImuSample | LidarScan, shift_ns: int) -> ImuSample | LidarScan:
    """Return the event as a sensor would stamp it after its clock moved by `shift_ns`."""
    if isinstance(event, ImuSample):
        return dataclasses.replace(event, t_sensor_ns=event.t_sensor_ns + shift_ns)
    return dataclasses.replace(
        event,
        t_sensor_start_ns=event.t_sensor_start_ns + shift_ns,
        t_sensor_end_ns=event.t_sensor_end_ns + shift_ns,
        clock_offset_ns=event.clock_offset_ns - shift_ns,
    )


def _time_ns(event: ImuSample | LidarScan) -> int:
    return event.t_sensor_ns if isinstance(event, ImuSample) else event.t_sensor_end_ns


def test_a_flight_between_pillars_is_tracked_within_a_centimetre(
    field_flight: SimulatedFlight, field_outcome: Outcome
) -> None:
    poses = errors(field_flight, [scan.odometry for scan in field_outcome.scans])
    ape = trajectory_error.absolute_error(*poses)
    assert ape.rmse_m < 0.005
    assert ape.rotation_rmse_deg < 0.06
    assert trajectory_error.drift_percent(*poses) < 0.4  # tilt at the start weighs most on 14 m


def test_a_flight_through_a_hall_is_tracked_within_a_centimetre(
    room_flight: SimulatedFlight, room_events: Events
) -> None:
    outcome = run(room_events)
    poses = errors(room_flight, [scan.odometry for scan in outcome.scans])
    assert trajectory_error.absolute_error(*poses).rmse_m < 0.01
    assert all(entry.quality > 80 for entry in outcome.tracked)


def test_a_map_that_leans_from_the_start_never_turns(
    room_flight: SimulatedFlight, room_events: Events
) -> None:
    outcome = run(room_events)
    _, q, _, q_true = errors(room_flight, [scan.odometry for scan in outcome.scans])
    lean_deg = np.degrees(rotation.log(rotation.multiply(q, rotation.conjugate(q_true)))[:, :2])
    assert float(np.linalg.norm(lean_deg[:5].mean(axis=0))) > 0.1  # the biases stand for 0.15 degrees
    assert float(np.linalg.norm(lean_deg - lean_deg[:5].mean(axis=0), axis=1).max()) < 0.08


def test_points_lean_with_the_pose(room_flight: SimulatedFlight, room_events: Events) -> None:
    scan = run(room_events).scans[-1]
    _, q, _, q_true = errors(room_flight, [scan.odometry])
    up_map = rotation.rotate(rotation.multiply(q[0], rotation.conjugate(q_true[0])), [0.0, 0.0, 1.0])
    # The ground lies 0.2 m below the start, over the whole hall.
    ground, slope = scan.points_map.astype(np.float64), np.array([0.0, 0.0, -0.2])
    for reach_m in (0.1, 0.05, 0.03):
        basis = np.column_stack([ground[:, :2], np.ones(len(ground))])
        near = np.abs(ground[:, 2] - basis @ slope) < reach_m
        slope = np.linalg.lstsq(basis[near], ground[near, 2], rcond=None)[0]
    assert float(np.degrees(np.linalg.norm(slope[:2] + up_map[:2]))) < 0.1
    assert abs(float(slope[2]) + 0.2) < 0.02


def test_the_map_starts_where_the_body_rests_with_its_heading(field_outcome: Outcome) -> None:
    first = field_outcome.tracked[0]
    np.testing.assert_allclose(first.p_map, 0.0, atol=0.01)
    assert abs(float(rotation.yaw_of(first.q_map_body))) < np.radians(0.2)


def test_odometry_comes_at_the_output_rate_in_order_of_time(field_outcome: Outcome) -> None:
    times = np.array([entry.t_sensor_ns for entry in field_outcome.tracked])
    assert np.all(np.diff(times)[1:] == 5_000_000)
    assert all(entry.t_ns == entry.t_sensor_ns + CLOCK_OFFSET_NS for entry in field_outcome.tracked)


def test_odometry_slower_than_the_imu_is_possible(field_events: Events) -> None:
    outcome = run(field_events[:500], SMALL.model_copy(update={"output_hz": 50.0}))
    times = np.array([entry.t_sensor_ns for entry in outcome.tracked])
    assert len(times) > 50
    assert np.all(np.diff(times)[1:] == 20_000_000)


def test_forward_propagated_poses_and_velocities_follow_the_truth(
    field_flight: SimulatedFlight, field_outcome: Outcome
) -> None:
    p, q, p_true, q_true = errors(field_flight, field_outcome.tracked)
    ape = trajectory_error.absolute_error(p, q, p_true, q_true)
    assert ape.rmse_m < 0.012
    assert ape.max_m < 0.04
    _, _, v_true = field_flight.truth(np.array([entry.t_sensor_ns for entry in field_outcome.tracked]))
    v = np.array([entry.v_map for entry in field_outcome.tracked])
    assert float(np.sqrt(np.mean(np.sum((v - v_true) ** 2, axis=1)))) < 0.03


def test_outputs_do_not_jump_when_a_scan_corrects_them(field_outcome: Outcome) -> None:
    p = np.array([entry.p_map for entry in field_outcome.tracked])
    v = np.array([entry.v_map for entry in field_outcome.tracked])
    predicted = p[:-1] + 0.0025 * (v[:-1] + v[1:])
    assert float(np.linalg.norm(p[1:] - predicted, axis=1).max()) < 0.01


def test_every_scan_after_the_start_is_registered_once_and_lies_on_the_world(
    field_flight: SimulatedFlight, field_outcome: Outcome
) -> None:
    sequences = [scan.sequence for scan in field_outcome.scans]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
    last = field_outcome.scans[-1]
    assert last.points_map.dtype == np.float32
    assert len(last.points_map) == len(last.reflectivity)
    # The body started ground_clearance_m above the plane.
    ground = last.points_map[last.points_map[:, 2] < 0.3]
    assert len(ground) > 200
    assert abs(float(np.median(ground[:, 2])) + 0.2) < 0.05


def test_the_published_covariance_covers_the_error(
    field_flight: SimulatedFlight, field_outcome: Outcome
) -> None:
    p, q, p_true, q_true = errors(field_flight, field_outcome.tracked)
    turn = rotation.log(rotation.multiply(rotation.conjugate(q_true), q))
    nees = []
    for i, entry in enumerate(field_outcome.tracked):
        error = p[i] - p_true[i]
        nees.append(
            (
                error @ np.linalg.solve(entry.covariance_pose[:3, :3], error),
                turn[i] @ np.linalg.solve(entry.covariance_pose[3:, 3:], turn[i]),
            )
        )
    assert np.all(np.mean(nees, axis=0) < 6.0)
    assert np.all(np.percentile(nees, 95, axis=0) < 12.0)


def test_gravity_in_the_map_is_estimated_within_its_uncertainty(
    field_flight: SimulatedFlight, field_outcome: Outcome
) -> None:
    state = field_outcome.lio.state
    assert state is not None
    _, q_true, _ = field_flight.truth(np.array([state.t_ns]))
    q_body_imu = (T_BODY_LIDAR @ T_LIDAR_IMU).q
    down_imu = rotation.rotate(
        rotation.conjugate(rotation.multiply(q_true[0], q_body_imu)), [0.0, 0.0, -9.80665]
    )
    g_true = state.R_map_imu @ down_imu
    error = (state.g_map - g_true)[:2]
    assert float(error @ np.linalg.solve(state.covariance[15:17, 15:17], error)) < 14.0


def test_equal_events_give_equal_bytes(field_events: Events) -> None:
    def digest(outcome: Outcome) -> bytes:
        parts = [entry.p_map.tobytes() + entry.covariance_pose.tobytes() for entry in outcome.odometry]
        return b"".join(parts) + b"".join(scan.points_map.tobytes() for scan in outcome.scans)

    assert digest(run(field_events[:700])) == digest(run(field_events[:700]))


def test_a_fifth_of_all_packets_may_be_missing() -> None:
    flight = SimulatedFlight(
        pillar_field(np.random.default_rng(3)),
        loop_trajectory(7.0),
        seed=5,
        errors=SensorErrors(missing_packets=0.2),
    )
    outcome = run(list(flight.events()))
    ape = trajectory_error.absolute_error(*errors(flight, [scan.odometry for scan in outcome.scans]))
    assert ape.rmse_m < 0.015
    assert outcome.tracked[-1].reset_counter == 0


def test_an_outage_of_a_third_of_a_second_is_bridged_and_shows_in_the_quality() -> None:
    flight = SimulatedFlight(
        pillar_field(np.random.default_rng(3)),
        loop_trajectory(7.5),
        seed=6,
        errors=SensorErrors(outages_s=((5.0, 5.35),)),
    )
    outcome = run(list(flight.events()))
    p, _, p_true, _ = errors(flight, outcome.tracked)
    after = np.array([entry.t_sensor_ns for entry in outcome.tracked]) > 6_000_000_000
    assert float(np.linalg.norm(p - p_true, axis=1)[after].max()) < 0.06
    blind = [entry for entry in outcome.tracked if 5.35e9 <= entry.t_sensor_ns < 5.45e9]
    assert min(entry.quality for entry in blind) < 60
    assert all(entry.reset_counter == 0 for entry in outcome.tracked)


def test_without_scans_the_quality_falls_until_the_odometry_is_lost_and_then_given_up(
    field_events: Events,
) -> None:
    settings = SMALL.model_copy(update={"lost_after_s": 1.5, "search_s": 0.5})
    events = [e for e in field_events if isinstance(e, ImuSample) or e.t_sensor_end_ns < 4_000_000_000]
    outcome = run(events, settings)
    statuses = [entry.status for entry in outcome.odometry if entry.t_sensor_ns > 3_900_000_000]
    assert statuses[0] is OdometryStatus.TRACKING
    assert OdometryStatus.DEGRADED in statuses
    search = [entry for entry in outcome.odometry if entry.status is OdometryStatus.LOST]
    lost = search[-1]
    assert all(entry.quality == 0 and "no scan matched" in entry.reason for entry in search)
    assert [entry.reset_counter for entry in search[:-1]] == [0] * (len(search) - 1)
    assert lost.reset_counter == 1
    assert (lost.t_sensor_ns - search[0].t_sensor_ns) * 1e-9 == pytest.approx(0.5, abs=0.02)
    after = [entry for entry in outcome.odometry if entry.t_sensor_ns > lost.t_sensor_ns]
    assert all(entry.status is OdometryStatus.INITIALISING for entry in after)
    assert any("not still" in entry.reason for entry in after)


@pytest.mark.parametrize("shift_ns", [90_000_000_000, -3_000_000_000])
def test_a_jump_of_the_sensors_clock_in_flight_is_survived_with_a_new_reset_counter(
    field_flight: SimulatedFlight, field_events: Events, shift_ns: int
) -> None:
    jump_ns = 5_503_000_000
    events = [_shifted(e, shift_ns) if _time_ns(e) > jump_ns else e for e in field_events]
    outcome = run(events)
    assert all(
        entry.reset_counter == 0 for entry in outcome.tracked if entry.t_ns < jump_ns + CLOCK_OFFSET_NS
    )
    after = [entry for entry in outcome.tracked if entry.t_ns > jump_ns + CLOCK_OFFSET_NS]
    assert all(entry.reset_counter == 1 for entry in after)
    assert after[0].status is OdometryStatus.DEGRADED
    assert "sensor clock jumped" in after[0].reason
    assert after[-1].status is OdometryStatus.TRACKING
    unshifted = [dataclasses.replace(e, t_sensor_ns=e.t_sensor_ns - shift_ns) for e in after]
    p, _, p_true, _ = errors(field_flight, unshifted)
    assert float(np.linalg.norm(p - p_true, axis=1).max()) < 0.06
    times = [entry.t_ns for entry in outcome.odometry]
    assert times == sorted(times)


def test_a_long_silence_loses_the_odometry_and_rest_starts_it_again() -> None:
    flight = SimulatedFlight(room(), hover_trajectory(6.0), seed=2)
    events = [e for e in flight.events() if not 2_500_000_000 < _time_ns(e) < 3_700_000_000]
    outcome = run(events)
    lost = [entry for entry in outcome.odometry if entry.status is OdometryStatus.LOST]
    assert [entry.reason for entry in lost] == ["IMU data interrupted"]
    assert outcome.odometry[-1].status is OdometryStatus.TRACKING
    assert outcome.odometry[-1].reset_counter == 1
    np.testing.assert_allclose(outcome.odometry[-1].p_map, 0.0, atol=0.02)


def test_starting_in_motion_is_refused_with_the_reason_twice_a_second() -> None:
    flight = SimulatedFlight(room(), loop_trajectory(6.0, still_s=-3.0, size_m=(5.0, 3.2)), seed=2)
    outcome = run([e for e in flight.events() if isinstance(e, ImuSample)])
    assert outcome.tracked == []
    assert 8 <= len(outcome.odometry) <= 14
    assert all(entry.quality == 0 for entry in outcome.odometry)
    assert "turning" in outcome.odometry[-1].reason or "not still" in outcome.odometry[-1].reason


def test_points_that_are_not_finite_and_empty_scans_do_no_harm(
    room_flight: SimulatedFlight, room_events: Events
) -> None:
    events: Events = []
    for event in room_events[:900]:
        if isinstance(event, LidarScan):
            points = event.points_lidar.copy()
            points[::7] = np.nan
            points[1::7] = np.inf
            points[2::7] = 0.0
            event = dataclasses.replace(event, points_lidar=points)
            if event.sequence % 9 == 8:
                event = dataclasses.replace(
                    event,
                    points_lidar=points[:0],
                    offsets_ns=event.offsets_ns[:0],
                    reflectivity=event.reflectivity[:0],
                    tags=event.tags[:0],
                )
        events.append(event)
    outcome = run(events)
    ape = trajectory_error.absolute_error(*errors(room_flight, [scan.odometry for scan in outcome.scans]))
    assert ape.rmse_m < 0.01
    for scan in outcome.scans:
        assert np.isfinite(scan.points_map).all()


def test_samples_that_are_not_finite_are_dropped(room_flight: SimulatedFlight, room_events: Events) -> None:
    events: Events = []
    for index, event in enumerate(room_events[:700]):
        if isinstance(event, ImuSample) and index % 50 == 49:
            event = dataclasses.replace(event, gyro_imu=np.array([np.nan, 0.0, 0.0]))
        events.append(event)
    outcome = run(events)
    assert outcome.lio.sequencer.counts.samples_implausible == 14
    assert outcome.tracked[-1].status is OdometryStatus.TRACKING
    assert all(np.isfinite(entry.p_map).all() for entry in outcome.odometry)


def test_saturated_samples_are_reported_but_do_not_break_the_flight(
    room_flight: SimulatedFlight, room_events: Events
) -> None:
    events: Events = []
    for event in room_events:
        if isinstance(event, ImuSample) and 4_000_000_000 < event.t_sensor_ns < 4_020_000_000:
            event = dataclasses.replace(event, accel_imu=np.array([80.0, -80.0, 9.0]))
        events.append(event)
    outcome = run(events)
    p, _, p_true, _ = errors(room_flight, outcome.tracked)
    reported = [entry for entry in outcome.tracked if entry.status is OdometryStatus.DEGRADED]
    assert reported[0].reason == "IMU saturated"
    assert reported[0].t_sensor_ns < 4_030_000_000
    assert all(entry.status is not OdometryStatus.LOST for entry in outcome.tracked)
    assert float(np.linalg.norm(p[-1] - p_true[-1])) < 0.05


def test_returns_outside_the_range_limits_never_start_the_odometry() -> None:
    flight = SimulatedFlight(room(), hover_trajectory(3.5), seed=2)
    outcome = run(list(flight.events()), SMALL.model_copy(update={"min_range_m": 5.0, "max_range_m": 5.0}))
    assert outcome.scans == []
    assert outcome.tracked == []
    assert outcome.odometry[-1].reason == "no map to start in: 0 points a scan while resting, 200 needed"


def test_without_scans_the_odometry_does_not_start() -> None:
    flight = SimulatedFlight(room(), hover_trajectory(3.5), seed=2)
    outcome = run([event for event in flight.events() if isinstance(event, ImuSample)])
    assert outcome.tracked == []
    assert outcome.odometry[-1].reason == "0 scans while resting, 4 needed"


def test_steady_motion_that_the_imu_cannot_feel_is_refused_by_the_scans() -> None:
    knots = np.arange(0.0, 5.0, 0.1)
    p_world = np.stack([0.5 * knots - 1.0, np.full_like(knots, 2.5), np.full_like(knots, 1.5)], axis=1)
    flight = SimulatedFlight(room(), Trajectory(knots, p_world, np.zeros_like(knots)), seed=2)
    outcome = run(list(flight.events()))
    assert outcome.tracked == []
    assert "scans moved by" in outcome.odometry[-1].reason


def test_over_an_empty_field_the_estimate_says_that_it_cannot_see_its_own_motion() -> None:
    flight = SimulatedFlight(open_field(), hover_trajectory(5.0, (0.0, 0.0, 2.0)), seed=2)
    outcome = run(list(flight.events()))
    last = outcome.odometry[-1]
    assert last.status is OdometryStatus.DEGRADED
    assert "directions unobserved" in last.reason
    assert abs(float(last.p_map[2])) < 0.03
    horizontal = float(np.sqrt(last.covariance_pose[0, 0]))
    assert float(np.linalg.norm(last.p_map[:2])) < 4.0 * horizontal * np.sqrt(2.0)
    assert horizontal > 2.0 * float(np.sqrt(last.covariance_pose[2, 2]))


def test_memory_stays_bounded_by_the_settings(field_events: Events) -> None:
    settings = OdometrySettings(fine_blocks=1024, coarse_blocks=1024)
    outcome = run(field_events, settings)
    assert outcome.lio.fine_map.blocks <= 1024
    assert outcome.tracked[-1].reset_counter == 0


def test_a_scan_waits_until_the_imu_covers_its_end(room_events: Events) -> None:
    early: Events = []
    for event in room_events[:650]:
        # The scan arrives before the last samples that it covers.
        position = max(0, len(early) - 4) if isinstance(event, LidarScan) else len(early)
        early.insert(position, event)
    outcome_late, outcome_early = run(room_events[:650]), run(early)
    assert [s.sequence for s in outcome_early.scans] == [s.sequence for s in outcome_late.scans]
    for late, soon in zip(outcome_late.scans, outcome_early.scans, strict=True):
        np.testing.assert_allclose(soon.odometry.p_map, late.odometry.p_map, atol=1e-3)


def test_registered_scans_keep_the_nearest_points_when_they_must_be_thinned(room_events: Events) -> None:
    outcome = run(room_events[:600], SMALL.model_copy(update={"registered_points": 1000}))
    full = run(room_events[:600])
    thinned, whole = outcome.scans[-1], full.scans[-1]
    assert len(thinned.points_map) == 1000
    ranges = np.sort(np.linalg.norm(whole.points_map - whole.odometry.p_map, axis=1))
    kept = np.sort(np.linalg.norm(thinned.points_map - thinned.odometry.p_map, axis=1))
    np.testing.assert_allclose(kept[:400], ranges[:400], atol=1e-3)


def test_scans_of_another_clock_are_counted_and_dropped(room_events: Events) -> None:
    stray = next(e for e in room_events if isinstance(e, LidarScan))
    far = _shifted(stray, 50 * SCAN_NS + 10_000_000_000)
    outcome = run([*room_events[:400], far, *room_events[400:700]])
    assert outcome.lio.sequencer.counts.scans_stale >= 1
    assert outcome.tracked[-1].status is OdometryStatus.TRACKING
