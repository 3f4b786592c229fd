"""Own motion from another process, carried on by the IMU, and scans registered with it."""

from dataclasses import replace

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import ExternalOdometry, ImuSample, LidarScan, RegisteredScan
from companion.perception.odometry.external_settings import ExternalMotionSettings
from tests.perception.odometry.conftest import Outcome
from tests.perception.odometry.external_flight import (
    END_NS,
    EXACT,
    INITIALISING,
    LOST,
    TRACKING,
    Events,
    Peer,
    changed,
    errors,
    merged,
    messages,
    rms,
    run,
)
from tests.perception.odometry.simulated_flight import (
    CLOCK_OFFSET_NS,
    T_BODY_LIDAR,
    SimulatedFlight,
    hover_trajectory,
    open_field,
)


@pytest.mark.parametrize(
    "peer",
    [
        Peer(hz=10.0, delay_ns=40_000_000),
        Peer(hz=50.0),
        Peer(hz=200.0, delay_ns=2_000_000),
        Peer(hz=10.0, delay_ns=90_000_000, states_velocity=False),
        Peer(hz=100.0, states_velocity=False),
    ],
    ids=lambda peer: f"{peer.hz:g} Hz{'' if peer.states_velocity else ', no velocity'}",
)
def test_every_sender_is_followed_as_closely_as_it_states(
    field_flight: SimulatedFlight, inertial: Events, peer: Peer
) -> None:
    result = run(merged(inertial, messages(field_flight, END_NS, peer)))
    assert all(entry.status is not LOST for entry in result.odometry)
    position_m, attitude_deg, velocity = errors(field_flight, result.tracked)
    assert position_m < (0.012 if peer.states_velocity else 0.016)
    assert attitude_deg < 0.12
    assert velocity < (0.05 if peer.states_velocity else 0.08)
    assert result.estimator.messages_unusable == 0


def test_without_noise_nothing_is_added(field_flight: SimulatedFlight, inertial: Events) -> None:
    result = run(merged(inertial, messages(field_flight, END_NS, EXACT)))
    position_m, attitude_deg, velocity = errors(field_flight, result.tracked)
    assert position_m < 5e-4
    assert attitude_deg < 0.02
    assert velocity < 0.005


@pytest.mark.parametrize("output_hz", [50.0, 200.0])
def test_odometry_comes_at_the_output_rate_whatever_the_senders(
    inertial: Events, field_flight: SimulatedFlight, output_hz: float
) -> None:
    result = run(merged(inertial, messages(field_flight, END_NS, Peer(hz=10.0))), output_hz=output_hz)
    times = np.array([entry.t_sensor_ns for entry in result.tracked])
    assert np.all(np.diff(times)[1:] == round(1e9 / output_hz))
    assert all(entry.t_ns == entry.t_sensor_ns + CLOCK_OFFSET_NS for entry in result.tracked)


def test_it_counts_after_a_second_of_agreement(inertial: Events, sent: list[ExternalOdometry]) -> None:
    result = run(merged(inertial, sent))
    assert {entry.status for entry in result.between(0.0, 1.05)} == {INITIALISING}
    assert result.at(0.6).reason == "external odometry for 0.4 s of 1 s"
    assert result.at(1.3).status is TRACKING
    assert result.at(1.3).quality >= 85


def test_scans_are_registered_as_our_own_odometry_does(
    field_events: Events, field_flight: SimulatedFlight, field_outcome: Outcome
) -> None:
    result = run(merged(field_events, messages(field_flight, END_NS, Peer(hz=50.0))))
    own = {scan.sequence: scan for scan in field_outcome.scans}
    compared = [(scan, own[scan.sequence]) for scan in result.scans if scan.sequence in own]
    assert len(compared) > 60
    apart = [
        np.median(np.linalg.norm(scan.points_map - other.points_map, axis=1)) for scan, other in compared
    ]
    assert rms(np.array(apart)) < 0.03
    for scan, other in compared:
        np.testing.assert_array_equal(scan.ages_ns, other.ages_ns)
        assert scan.odometry.t_sensor_ns == other.odometry.t_sensor_ns
    assert errors(field_flight, [scan.odometry for scan in result.scans])[2] < 0.05


@pytest.mark.parametrize("hz", [10.0, 50.0])
def test_points_are_moved_to_where_the_scan_ends_by_the_way_in_between(
    field_events: Events, field_flight: SimulatedFlight, hz: float
) -> None:
    """With exact messages each point lies where the truth at its own moment puts it."""
    result = run(merged(field_events, messages(field_flight, END_NS, replace(EXACT, hz=hz))))
    scans = {event.sequence: event for event in field_events if isinstance(event, LidarScan)}
    worst = 0.0
    for registered in result.scans[20::10]:
        scan = scans[registered.sequence]
        p, q, _ = field_flight.truth(scan.t_sensor_start_ns + scan.offsets_ns.astype(np.int64))
        expected = p + rotation.rotate(q, T_BODY_LIDAR.transform(scan.points_lidar))
        near = np.linalg.norm(scan.points_lidar, axis=1)
        kept = expected[(near >= 0.3) & (near <= 70.0)]
        worst = max(worst, float(np.median(np.linalg.norm(registered.points_map - kept, axis=1))))
    assert worst < 0.006


def test_a_scan_waits_until_messages_cover_its_end(
    field_events: Events, field_flight: SimulatedFlight
) -> None:
    peer = replace(EXACT, delay_ns=60_000_000)
    covered_ns = 0
    estimator = run([]).estimator
    registered = 0
    for event in merged(field_events, messages(field_flight, END_NS, peer)):
        if isinstance(event, ExternalOdometry):
            covered_ns = event.t_valid_ns - CLOCK_OFFSET_NS
        for output in estimator.handle(event):
            if isinstance(output, RegisteredScan):
                registered += 1
                assert covered_ns >= output.odometry.t_sensor_ns
                if output.odometry.t_sensor_ns > 2_000_000_000:  # those before waited for the start
                    assert isinstance(event, ExternalOdometry)
                    assert covered_ns - output.odometry.t_sensor_ns < 20_000_000
    assert registered > 60


def test_equal_events_give_equal_outputs(field_events: Events, sent: list[ExternalOdometry]) -> None:
    first, second = (run(merged(field_events[:600], sent[:200])) for _ in range(2))
    assert len(first.scans) == len(second.scans) > 10
    for one, other in zip(first.scans, second.scans, strict=True):
        assert one.points_map.tobytes() == other.points_map.tobytes()
        assert one.odometry.p_map.tobytes() == other.odometry.p_map.tobytes()


def test_the_gyros_bias_is_learnt_from_the_attitudes(inertial: Events, field_flight: SimulatedFlight) -> None:
    result = run(
        merged(inertial, messages(field_flight, END_NS, EXACT)), ExternalMotionSettings(gyro_bias_time_s=1.0)
    )
    learnt = result.estimator._reckoning.gyro_bias
    np.testing.assert_allclose(learnt, field_flight.errors.gyro_bias, atol=5e-4)


def test_memory_stays_bounded_over_a_long_hover() -> None:
    flight = SimulatedFlight(open_field(), hover_trajectory(1.0), seed=1)
    quiet = np.array([0.0, 0.0, 9.80665])
    template = messages(flight, 300_000_000, EXACT)[0]
    estimator = run([]).estimator
    for index in range(1, 3000):  # 15 s at 200 Hz
        t_ns = index * 5_000_000
        estimator.handle(ImuSample(t_ns + CLOCK_OFFSET_NS, t_ns, np.zeros(3), quiet))
        message = replace(
            template, t_ns=t_ns + CLOCK_OFFSET_NS, t_source_ns=t_ns, clock_offset_ns=CLOCK_OFFSET_NS
        )
        outputs = estimator.handle(message)
    assert not outputs
    assert estimator._path._count <= len(estimator._path._rows)
    assert len(estimator._messages) <= 1
    assert len(estimator._health._lifts._entries) <= 401
    assert len(estimator._health._arrivals) <= 201


def test_stamps_on_the_lidars_clock_need_no_hosts(
    field_flight: SimulatedFlight, inertial: Events, sent: list[ExternalOdometry]
) -> None:
    on_lidar = changed(
        sent,
        lambda other: replace(
            other,
            on_lidar_clock=True,
            t_source_ns=other.t_valid_ns - CLOCK_OFFSET_NS,
            clock_offset_ns=CLOCK_OFFSET_NS + 80_000_000,  # badly estimated
        ),
    )
    result = run(merged(inertial, on_lidar))
    assert errors(field_flight, result.tracked)[0] < 0.012
