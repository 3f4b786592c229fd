import dataclasses
from typing import Any

import numpy as np
import pytest

from companion.messages import OdometryStatus
from companion.perception.odometry.degeneracy import Observability, weak_directions
from companion.perception.odometry.health import Concern, HealthMonitor
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.odometry.state import ERROR_SIZE, STATE_SIZE, NavigationState
from companion.perception.odometry.update import Correction

SETTINGS = OdometrySettings()
SECOND = 1_000_000_000
WAY = np.zeros((2, 22))


def _state(t_ns: int = 0, sigma_m: float = 0.003) -> NavigationState:
    vector = np.zeros(STATE_SIZE)
    vector[3:12] = np.eye(3).ravel()
    vector[23] = -9.81
    covariance = np.eye(ERROR_SIZE) * 1e-6
    covariance[:3, :3] = np.eye(3) * sigma_m**2 / 3.0
    return NavigationState(t_ns, vector, covariance)


def _observability(weak: list[int]) -> Observability:
    kept = np.ones(6, dtype=np.bool_)
    kept[weak] = False
    return Observability(np.where(kept, 0.2, 0.001), np.eye(6), 5.0, kept)


GAIN = np.eye(6) * 1e-6


def _correction(state: NavigationState) -> Correction:
    return Correction(
        state, True, 2500, 2450, 2420, 0.02, 0.7, _observability([]), False, 2, 2, state.vector, GAIN
    )


def _quality(monitor: HealthMonitor, correction: Correction) -> int:
    monitor.observe(_state(), correction, WAY)
    return monitor.judge(_state()).quality


def test_a_good_match_is_tracking_with_full_quality() -> None:
    monitor = HealthMonitor(SETTINGS, 0)
    monitor.observe(_state(), _correction(_state()), WAY)
    health = monitor.judge(_state())
    assert (health.status, health.quality, health.reason) == (OdometryStatus.TRACKING, 100, "")


@pytest.mark.parametrize(
    "worse",
    [
        [{"matched": n, "found": n, "offered": n} for n in (2500, 150, 100, 60)],
        [{"matched": n, "found": n, "offered": 2500} for n in (2000, 800, 400, 200)],
        [{"normalised_rms": rms} for rms in (0.5, 1.8, 2.2, 2.9)],
        [{"observability": _observability(weak)} for weak in ([], [0], [0, 1], [0, 1, 5])],
    ],
)
def test_quality_never_rises_when_a_match_gets_worse(worse: list[dict[str, Any]]) -> None:
    good = _correction(_state())
    qualities = [
        _quality(HealthMonitor(SETTINGS, 0), dataclasses.replace(good, **change)) for change in worse
    ]
    assert qualities == sorted(qualities, reverse=True)
    assert qualities[0] > 90
    assert qualities[-1] < 40


def test_quality_falls_with_time_and_with_uncertainty() -> None:
    monitor = HealthMonitor(SETTINGS, 0)
    by_age = [monitor.judge(_state(t)).quality for t in range(0, 4 * SECOND, SECOND // 4)]
    assert by_age == sorted(by_age, reverse=True)
    assert by_age[0] == 100
    by_sigma = [monitor.judge(_state(0, sigma)).quality for sigma in (0.01, 0.05, 0.1, 0.5, 2.0)]
    assert by_sigma == sorted(by_sigma, reverse=True)
    assert monitor.judge(_state(0, 4.0)).status is OdometryStatus.LOST
    assert monitor.is_over(_state(0, 4.0))


def test_an_alarm_stands_from_its_first_sign_until_half_a_second_after_its_last() -> None:
    monitor = HealthMonitor(SETTINGS, SECOND)
    monitor.alarm(SECOND, Concern.INERTIAL, "first")
    monitor.alarm(SECOND + 20_000_000, Concern.INERTIAL, "again")
    health = monitor.judge(_state(SECOND + 30_000_000))
    assert (health.status, health.reason) == (OdometryStatus.DEGRADED, "again")
    assert health.quality == 10
    monitor.observe(_state(), _correction(_state(SECOND + 400_000_000)), WAY)
    assert monitor.judge(_state(SECOND + 520_000_000)).status is OdometryStatus.DEGRADED
    assert monitor.judge(_state(SECOND + 521_000_000)).status is OdometryStatus.TRACKING


def test_of_several_alarms_the_oldest_is_told() -> None:
    monitor = HealthMonitor(SETTINGS, 0)
    monitor.alarm(10, Concern.SCAN, "cause")
    monitor.alarm(20, Concern.CONTRADICTION, "consequence")
    monitor.alarm(30, Concern.SCAN, "cause")
    assert monitor.judge(_state(40)).reason == "cause"


def test_a_clock_that_jumps_takes_alarms_and_ages_along() -> None:
    monitor = HealthMonitor(SETTINGS, 0)
    monitor.alarm(10, Concern.SCAN, "covered")
    monitor.relabel(90 * SECOND)
    assert monitor.judge(_state(90 * SECOND + 20)).reason == "covered"
    assert monitor.judge(_state(91 * SECOND)).reason == "no scan matched for 1.0 s"


def test_a_refused_scan_is_told_at_once() -> None:
    monitor = HealthMonitor(SETTINGS, 0)
    refused = dataclasses.replace(_correction(_state()), accepted=False, matched=30, found=200)
    assert not monitor.observe(_state(), refused, WAY)
    health = monitor.judge(_state())
    assert health.status is OdometryStatus.DEGRADED
    assert health.reason == "scan does not match: 30 of 2500 points agree"


def test_many_points_that_contradict_the_map_are_told_and_few_are_not() -> None:
    few = dataclasses.replace(_correction(_state()), found=2500, matched=2300)
    many = dataclasses.replace(_correction(_state()), found=2500, matched=2100)
    monitor = HealthMonitor(SETTINGS, 0)
    monitor.observe(_state(), few, WAY)
    assert monitor.judge(_state()).status is OdometryStatus.TRACKING
    monitor.observe(_state(), many, WAY)
    assert monitor.judge(_state()).reason == "16 % of the points contradict the map"


def test_what_a_wider_search_finds_is_a_jump_and_stays_out_of_the_map_for_a_while() -> None:
    monitor = HealthMonitor(SETTINGS, 0)
    assert monitor.may_map(0)
    assert monitor.observe(_state(), dataclasses.replace(_correction(_state()), wide=True), WAY)
    assert monitor.judge(_state()).status is OdometryStatus.DEGRADED
    assert not monitor.may_map(100_000_000)
    assert monitor.may_map(SECOND)


def test_without_a_match_the_verdict_goes_from_degraded_to_lost_to_over() -> None:
    monitor = HealthMonitor(SETTINGS, 0)
    assert monitor.judge(_state(200_000_000)).status is OdometryStatus.TRACKING
    assert monitor.judge(_state(300_000_000)).status is OdometryStatus.DEGRADED
    assert not monitor.must_search(SECOND)
    assert monitor.must_search(2 * SECOND)
    assert monitor.judge(_state(5 * SECOND)).status is OdometryStatus.LOST
    assert not monitor.is_over(_state(5 * SECOND))
    assert monitor.is_over(_state(15 * SECOND))


def test_a_state_that_is_not_finite_is_lost_for_good() -> None:
    monitor = HealthMonitor(SETTINGS, 0)
    state = _state()
    state.vector[12] = np.nan
    assert monitor.judge(state).status is OdometryStatus.LOST
    assert monitor.is_over(state)


def test_a_place_found_again_is_degraded_first_and_a_jump_after_a_loss() -> None:
    monitor = HealthMonitor(SETTINGS, 0)
    short, long = 2 * SECOND, 6 * SECOND
    assert not monitor.relocated(_state(short), _correction(_state(short)))
    health = monitor.judge(_state(short + 100_000_000))
    assert (health.status, health.reason) == (OdometryStatus.DEGRADED, "place found again after an outage")
    assert monitor.relocated(_state(2 * long), _correction(_state(2 * long)))


def test_weak_directions_are_named_in_the_map() -> None:
    assert weak_directions(_observability([0]), np.eye(3)) == ["along x of the map"]
    assert weak_directions(_observability([2, 5]), np.eye(3)) == ["along z of the map", "about z of the map"]
    turned = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    assert weak_directions(_observability([3]), turned) == ["about y of the map"]
    oblique = _observability([0])
    oblique.directions[:2, 0] = [-np.sqrt(0.5), -np.sqrt(0.5)]
    assert weak_directions(oblique, np.eye(3)) == ["along 45 deg of the map"]


def test_a_corridor_says_along_which_axis_it_is_blind() -> None:
    monitor = HealthMonitor(SETTINGS, 0)
    correction = dataclasses.replace(_correction(_state()), observability=_observability([1, 5]))
    monitor.observe(_state(), correction, WAY)
    assert monitor.judge(_state()).reason == (
        "2 directions unobserved: along y of the map, about z of the map"
    )
