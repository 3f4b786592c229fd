"""Own motion from another process: carried on by the IMU, judged, and scans registered with it."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import (
    ExternalOdometry,
    FloatArray,
    ImuSample,
    LidarScan,
    Odometry,
    OdometryStatus,
    RegisteredScan,
    SensorEvent,
)
from companion.perception.odometry.external import ExternalMotionEstimator
from companion.perception.odometry.external_settings import ExternalMotionSettings
from companion.perception.odometry.settings import OdometrySettings
from tests.perception.odometry.conftest import Outcome
from tests.perception.odometry.external_flight import Peer, after, changed, merged, messages
from tests.perception.odometry.simulated_flight import (
    CLOCK_OFFSET_NS,
    T_BODY_LIDAR,
    T_LIDAR_IMU,
    SimulatedFlight,
    hover_trajectory,
    open_field,
)

Events = list[ImuSample | LidarScan]
INITIALISING, TRACKING, DEGRADED, LOST = OdometryStatus
END_NS = 8_900_000_000
EXACT = Peer(position_sigma_m=0.0, rotation_sigma_deg=0.0, velocity_sigma=0.0)


@dataclass(frozen=True)
class Run:
    """What the estimator made of its events."""

    odometry: list[Odometry]
    scans: list[RegisteredScan]
    estimator: ExternalMotionEstimator

    def at(self, t_s: float) -> Odometry:
        """Return the newest odometry at a sensor time."""
        return [entry for entry in self.odometry if entry.t_sensor_ns <= t_s * 1e9][-1]

    def between(self, start_s: float, end_s: float) -> list[Odometry]:
        return [entry for entry in self.odometry if start_s * 1e9 <= entry.t_sensor_ns <= end_s * 1e9]

    @property
    def tracked(self) -> list[Odometry]:
        return [entry for entry in self.odometry if entry.status is TRACKING]


def run(
    events: Iterable[SensorEvent],
    settings: ExternalMotionSettings | None = None,
    output_hz: float = 50.0,
) -> Run:
    limits = settings or ExternalMotionSettings()
    estimator = ExternalMotionEstimator(
        OdometrySettings(source="external", external=limits, output_hz=output_hz), T_BODY_LIDAR, T_LIDAR_IMU
    )
    odometry: list[Odometry] = []
    scans: list[RegisteredScan] = []
    for event in events:
        for output in estimator.handle(event):
            if isinstance(output, RegisteredScan):
                scans.append(output)
            else:
                odometry.append(output)
    return Run(odometry, scans, estimator)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def errors(flight: SimulatedFlight, odometry: list[Odometry]) -> tuple[float, float, float]:
    """Return RMS errors of position (m), attitude (deg) and velocity (m/s)."""
    p, q, v = flight.truth(np.array([entry.t_sensor_ns for entry in odometry]))
    return (
        rms(np.linalg.norm([entry.p_map for entry in odometry] - p, axis=1)),
        rms(np.degrees(rotation.angle_between(np.array([entry.q_map_body for entry in odometry]), q))),
        rms(np.linalg.norm([entry.v_map for entry in odometry] - v, axis=1)),
    )


@pytest.fixture(scope="module")
def sent(field_flight: SimulatedFlight) -> list[ExternalOdometry]:
    return messages(field_flight, END_NS, Peer())


@pytest.fixture(scope="module")
def inertial(field_events: Events) -> Events:
    """The flight without its scans: cheaper where they do not matter."""
    return [event for event in field_events if isinstance(event, ImuSample)]


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


def test_silence_is_degraded_then_lost_and_begins_anew(
    inertial: Events, sent: list[ExternalOdometry]
) -> None:
    gap = [other for other in sent if not 3_000_000_000 < other.t_valid_ns - CLOCK_OFFSET_NS < 5_000_000_000]
    result = run(merged(inertial, gap))
    assert result.at(3.2).status is TRACKING
    assert result.at(3.3).status is DEGRADED
    assert result.at(3.3).reason == "no external odometry for 0.3 s"
    qualities = [entry.quality for entry in result.between(3.3, 3.95)]
    assert all(later <= earlier for earlier, later in pairwise(qualities))
    lost = [entry for entry in result.odometry if entry.status is LOST]
    assert len(lost) == 1
    assert 4_000_000_000 < lost[0].t_sensor_ns < 4_030_000_000
    assert lost[0].reason == "no external odometry for 1.0 s"
    assert lost[0].quality == 0
    assert lost[0].reset_counter == 1
    assert all(entry.status is INITIALISING for entry in result.between(4.1, 5.9))
    assert result.at(4.9).reason == "no external odometry"
    assert result.at(6.3).status is TRACKING


def test_while_silent_the_imu_carries_on_and_admits_its_drift(
    field_flight: SimulatedFlight, inertial: Events, sent: list[ExternalOdometry]
) -> None:
    gap = [other for other in sent if other.t_valid_ns - CLOCK_OFFSET_NS < 6_000_000_000]
    result = run(merged(inertial, gap))
    before, late = result.at(6.0), result.between(6.9, 6.97)
    assert errors(field_flight, late)[0] < 0.15
    sigma_before = np.sqrt(np.diagonal(before.covariance_pose))
    sigma_late = np.sqrt(np.diagonal(late[-1].covariance_pose))
    assert np.all(sigma_late[:3] > sigma_before[:3])
    assert errors(field_flight, late)[0] < 3.0 * float(np.linalg.norm(sigma_late[:3]))


def moved_by(other: ExternalOdometry, way: tuple[float, float, float]) -> ExternalOdometry:
    return replace(other, p_map=other.p_map + np.array(way))


def test_an_announced_reset_is_passed_on_without_a_doubt(
    inertial: Events, sent: list[ExternalOdometry]
) -> None:
    limit_ns = 4_000_000_000 + CLOCK_OFFSET_NS
    reset = changed(
        sent,
        lambda other: (
            replace(moved_by(other, (1.0, -0.5, 0.0)), reset_counter=7)
            if other.t_valid_ns >= limit_ns
            else other
        ),
    )
    result = run(merged(inertial, reset))
    assert result.at(3.9).reset_counter == 0
    assert all(entry.status is TRACKING for entry in result.between(1.5, 8.0))
    assert result.odometry[-1].reset_counter == 1


def test_a_jump_nobody_announced_is_a_reset_under_suspicion(
    inertial: Events, sent: list[ExternalOdometry]
) -> None:
    limit_ns = 4_000_000_000 + CLOCK_OFFSET_NS
    jumped = changed(
        sent, lambda other: moved_by(other, (0.5, 0.0, 0.0)) if other.t_valid_ns >= limit_ns else other
    )
    result = run(merged(inertial, jumped))
    suspected = result.at(4.5)
    assert suspected.status is DEGRADED
    assert suspected.reason.startswith("external position jumped by 0.5")
    assert suspected.reset_counter == 1
    assert suspected.quality <= 50
    assert result.at(5.3).status is TRACKING
    assert result.odometry[-1].reset_counter == 1


def test_a_turn_of_the_map_is_a_jump_too(inertial: Events, sent: list[ExternalOdometry]) -> None:
    limit_ns = 4_000_000_000 + CLOCK_OFFSET_NS
    yaw = rotation.from_yaw(np.radians(8.0))

    def turned(other: ExternalOdometry) -> ExternalOdometry:
        if other.t_valid_ns < limit_ns:
            return other
        return replace(
            other,
            p_map=rotation.rotate(yaw, other.p_map),
            q_map_body=rotation.multiply(yaw, other.q_map_body),
            v_map=rotation.rotate(yaw, other.v_map),
        )

    result = run(merged(inertial, changed(sent, turned)))
    assert result.at(4.5).status is DEGRADED
    assert "jumped" in result.at(4.5).reason
    assert result.at(4.5).reset_counter == 1


def test_one_that_jumps_all_the_time_is_lost(inertial: Events, sent: list[ExternalOdometry]) -> None:
    def restless(other: ExternalOdometry) -> ExternalOdometry:
        steps = max(0, (other.t_valid_ns - CLOCK_OFFSET_NS - 4_000_000_000) // 200_000_000)
        return moved_by(other, (0.6 * steps, 0.0, 0.0))

    result = run(merged(inertial, changed(sent, restless)))
    assert result.at(5.0).status in (LOST, INITIALISING)
    assert any("was reset 4 times" in entry.reason for entry in result.between(4.5, 5.5))


def test_a_small_drift_is_no_jump(inertial: Events, sent: list[ExternalOdometry]) -> None:
    drifting = changed(
        sent, lambda other: moved_by(other, (0.02 * (other.t_valid_ns - CLOCK_OFFSET_NS) * 1e-9, 0.0, 0.0))
    )
    result = run(merged(inertial, drifting))
    assert result.odometry[-1].reset_counter == 0
    assert all(entry.status is TRACKING for entry in result.between(1.5, 8.0))


@pytest.mark.parametrize("tilt", [(np.pi, 0.0, 0.0), (0.0, 0.12, 0.0), (0.0, -0.12, 0.0)])
def test_a_wrong_vertical_never_flies(
    inertial: Events, sent: list[ExternalOdometry], tilt: tuple[float, float, float]
) -> None:
    """As when frames are mistaken for each other, or the sender's map is not level."""
    turn = rotation.exp(np.array(tilt))
    wrong = changed(sent, lambda other: replace(other, q_map_body=rotation.multiply(other.q_map_body, turn)))
    result = run(merged(inertial, wrong))
    assert {entry.status for entry in result.odometry} == {INITIALISING}
    expected = round(float(np.degrees(np.linalg.norm(tilt))))
    assert f"vertical is {expected} deg off" in result.at(3.0).reason


def test_a_vertical_that_tips_in_flight_is_lost(inertial: Events, sent: list[ExternalOdometry]) -> None:
    """Slowly enough that no step is a jump."""

    def tipping(other: ExternalOdometry) -> ExternalOdometry:
        since_s = max(0.0, (other.t_valid_ns - CLOCK_OFFSET_NS) * 1e-9 - 4.0)
        turn = rotation.exp(np.array([min(0.3, 0.15 * since_s), 0.0, 0.0]))
        return replace(other, q_map_body=rotation.multiply(other.q_map_body, turn))

    result = run(merged(inertial, changed(sent, tipping)))
    lost = [entry for entry in result.odometry if entry.status is LOST]
    assert "off the accelerometer's" in lost[0].reason
    assert lost[0].t_sensor_ns < 6_000_000_000


def test_a_velocity_that_is_always_zero_is_found_out(inertial: Events, sent: list[ExternalOdometry]) -> None:
    result = run(merged(inertial, changed(sent, lambda other: replace(other, v_map=np.zeros(3)))))
    flying = result.between(5.0, 8.0)
    doubtful = [entry for entry in flying if entry.status in (DEGRADED, INITIALISING, LOST)]
    assert len(doubtful) == len(flying)
    assert any("off its positions" in entry.reason or "vertical" in entry.reason for entry in doubtful)


def test_a_stated_failure_is_lost_and_a_low_quality_degraded(
    inertial: Events, sent: list[ExternalOdometry]
) -> None:
    failed = run(merged(inertial, changed(sent, after(4.0, quality=-1))))
    lost = [entry for entry in failed.odometry if entry.status is LOST]
    assert lost[0].reason == "the external odometry reports its failure"
    assert lost[0].t_sensor_ns < 4_060_000_000
    low = run(merged(inertial, changed(sent, after(4.0, quality=12)))).at(5.0)
    assert (low.status, low.reason) == (DEGRADED, "external odometry states the quality 12")
    assert 10 <= low.quality <= 12
    unstated = run(merged(inertial, changed(sent, after(4.0, quality=0)))).at(5.0)
    assert unstated.status is TRACKING
    assert 65 <= unstated.quality <= 70


def test_a_stated_uncertainty_beyond_the_limit_is_degraded(
    inertial: Events, sent: list[ExternalOdometry]
) -> None:
    vague = np.diag([0.64, 0.01, 0.01, 1e-4, 1e-4, 1e-4])
    entry = run(merged(inertial, changed(sent, after(4.0, covariance_pose=vague)))).at(5.0)
    assert entry.status is DEGRADED
    assert entry.reason == "external position uncertain by 0.80 m"


def test_covariances_are_the_senders_with_our_floors(inertial: Events, sent: list[ExternalOdometry]) -> None:
    tiny = changed(
        sent,
        lambda other: replace(
            other, covariance_pose=np.eye(6) * 1e-12, covariance_velocity=np.eye(3) * 1e-12
        ),
    )
    entry = run(merged(inertial, tiny)).at(5.0)
    np.testing.assert_allclose(np.sqrt(np.diagonal(entry.covariance_pose))[:3], 0.02, rtol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diagonal(entry.covariance_velocity)), 0.03, rtol=1e-6)
    wide = changed(sent, lambda other: replace(other, covariance_pose=np.diag([0.04] * 3 + [4e-4] * 3)))
    entry = run(merged(inertial, wide)).at(5.0)
    np.testing.assert_allclose(np.sqrt(np.diagonal(entry.covariance_pose))[:3], 0.2, rtol=0.01)


def test_a_sender_too_slow_is_degraded(field_flight: SimulatedFlight, inertial: Events) -> None:
    slow = messages(field_flight, END_NS, Peer(hz=5.0, delay_ns=5_000_000))
    before = [
        other
        for other in messages(field_flight, END_NS, Peer())
        if other.t_ns < 3_000_000_000 + CLOCK_OFFSET_NS
    ]
    later = [other for other in slow if other.t_ns >= 3_000_000_000 + CLOCK_OFFSET_NS]
    entry = run(merged(inertial, [*before, *later])).at(5.0)
    assert entry.status is DEGRADED
    assert "external odometry at 5 Hz, at least 8 wanted" in entry.reason


def test_another_session_begins_anew(inertial: Events, sent: list[ExternalOdometry]) -> None:
    result = run(merged(inertial, changed(sent, after(4.0, session=2))))
    assert result.at(3.9).reset_counter == 0
    assert {entry.status for entry in result.between(4.1, 4.9)} == {INITIALISING}
    assert result.at(5.3).status is TRACKING
    assert result.at(5.3).reset_counter == 1


def test_an_imu_that_falls_silent_is_lost_though_messages_come(
    inertial: Events, sent: list[ExternalOdometry]
) -> None:
    deaf = [event for event in inertial if event.t_ns - CLOCK_OFFSET_NS < 4_000_000_000]
    result = run(merged(deaf, sent))
    assert result.odometry[-1].status is LOST
    assert result.odometry[-1].reason == "no IMU samples for 0.6 s"


def test_a_short_gap_of_the_imu_is_bridged(
    field_flight: SimulatedFlight, inertial: Events, sent: list[ExternalOdometry]
) -> None:
    gappy = [event for event in inertial if not 5_000_000_000 < event.t_ns - CLOCK_OFFSET_NS < 5_200_000_000]
    result = run(merged(gappy, sent))
    assert all(entry.status is TRACKING for entry in result.between(1.5, 8.0))
    assert errors(field_flight, result.between(5.4, 8.0))[0] < 0.015


def test_a_lidar_clock_that_was_set_changes_nothing_but_its_stamps(
    field_flight: SimulatedFlight, inertial: Events, sent: list[ExternalOdometry]
) -> None:
    shift_ns = 50_000_000_000
    limit_ns = 5_000_000_000
    shifted = [
        replace(event, t_sensor_ns=event.t_sensor_ns + shift_ns)
        if isinstance(event, ImuSample) and event.t_sensor_ns >= limit_ns
        else event
        for event in inertial
    ]
    result = run(merged(shifted, sent))
    later = [entry for entry in result.odometry if shift_ns < entry.t_sensor_ns < shift_ns + END_NS]
    assert later
    assert all(entry.status is TRACKING for entry in later)
    back = [replace(entry, t_sensor_ns=entry.t_sensor_ns - shift_ns) for entry in later]
    assert errors(field_flight, back)[0] < 0.015


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


def test_messages_without_imu_or_ahead_of_it_are_not_used(
    inertial: Events, sent: list[ExternalOdometry]
) -> None:
    ahead = changed(sent, lambda other: replace(other, clock_offset_ns=other.clock_offset_ns + 2_000_000_000))
    result = run(merged(inertial, ahead))
    assert {entry.status for entry in result.odometry} == {INITIALISING}
    assert result.estimator.messages_unusable > 100
    assert run(sent).odometry == []


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
