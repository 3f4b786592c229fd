"""When own motion from another process is trusted, doubted and refused."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import ExternalOdometry, ImuSample
from tests.perception.odometry.external_flight import (
    DEGRADED,
    END_NS,
    INITIALISING,
    LOST,
    TRACKING,
    Events,
    Peer,
    after,
    changed,
    errors,
    merged,
    messages,
    run,
)
from tests.perception.odometry.simulated_flight import (
    CLOCK_OFFSET_NS,
    SimulatedFlight,
)


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


def test_messages_without_imu_or_ahead_of_it_are_not_used(
    inertial: Events, sent: list[ExternalOdometry]
) -> None:
    ahead = changed(sent, lambda other: replace(other, clock_offset_ns=other.clock_offset_ns + 2_000_000_000))
    result = run(merged(inertial, ahead))
    assert {entry.status for entry in result.odometry} == {INITIALISING}
    assert result.estimator.messages_unusable > 100
    assert run(sent).odometry == []
