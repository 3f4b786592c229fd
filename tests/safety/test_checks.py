"""What counts as usable odometry and an agreeing autopilot."""

from dataclasses import replace

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import LandedState, Odometry, OdometryStatus, VehicleMode, VehicleState
from companion.safety.checks import Checks, Facts
from companion.safety.settings import SafetySettings

NOW_NS = 10_000_000_000
ODOMETRY = Odometry(
    t_ns=NOW_NS,
    t_sensor_ns=0,
    p_map=np.array([1.0, 2.0, 1.5]),
    q_map_body=rotation.IDENTITY,
    v_map=np.array([0.5, 0.0, 0.0]),
    omega_body=np.zeros(3),
    covariance_pose=np.eye(6),
    covariance_velocity=np.eye(3),
    quality=90,
    reset_counter=0,
    status=OdometryStatus.TRACKING,
)
VEHICLE = VehicleState(
    t_ns=NOW_NS,
    connected=True,
    armed=True,
    mode=VehicleMode.OFFBOARD,
    landed=LandedState.IN_AIR,
    failsafe=False,
    t_local_ns=NOW_NS,
    p_map=np.array([1.0, 2.0, 1.5]),
    v_map=np.array([0.5, 0.0, 0.0]),
    q_map_body=rotation.IDENTITY,
    estimator_reset_counter=0,
    mode_changes=1,
)


def facts(
    checks: Checks,
    odometry: Odometry | None,
    vehicle: VehicleState | None,
    t_ns: int,
    t_scan_ns: int | None = None,
) -> Facts:
    scanned_ns = t_ns if t_scan_ns is None else t_scan_ns
    checks.observe(odometry, vehicle, scanned_ns, t_ns)
    return checks.facts(
        odometry,
        vehicle,
        scanned_ns,
        t_ns,
        authorised=False,
        revoked=False,
        finished=False,
        engage_timed_out=False,
        mode_left=False,
        stopping=False,
        stalled=False,
    )


def test_fresh_odometry_and_a_live_link_are_healthy() -> None:
    assert facts(Checks(SafetySettings()), ODOMETRY, VEHICLE, NOW_NS).healthy


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"t_ns": NOW_NS - 201_000_000}, "201 ms old"),
        ({"t_ns": NOW_NS + 51_000_000}, "51 ms in the future"),
        ({"quality": 19, "reason": "few points"}, "quality 19: few points"),
        ({"status": OdometryStatus.LOST, "reason": "diverged"}, "lost: diverged"),
        ({"status": OdometryStatus.INITIALISING}, "initialising"),
        ({"p_map": np.array([np.nan, 0, 0])}, "not finite"),
        ({"v_map": np.array([0, np.inf, 0])}, "not finite"),
        ({"q_map_body": np.array([1, 0, 0, np.nan])}, "not finite"),
        ({"omega_body": np.array([0, 0, np.inf])}, "not finite"),
    ],
)
def test_bad_odometry_is_named(change: dict[str, object], word: str) -> None:
    found = facts(Checks(SafetySettings()), replace(ODOMETRY, **change), VEHICLE, NOW_NS)  # type: ignore[arg-type]
    assert not found.odometry_usable
    assert word in found.problem


def test_unusable_odometry_becomes_lost_after_a_second() -> None:
    checks = Checks(SafetySettings())
    assert not facts(checks, ODOMETRY, VEHICLE, NOW_NS).odometry_lost
    assert not facts(checks, ODOMETRY, VEHICLE, NOW_NS + 1_100_000_000).odometry_usable
    assert facts(checks, ODOMETRY, VEHICLE, NOW_NS + 1_100_000_000).odometry_lost


def test_a_silent_autopilot_is_no_link() -> None:
    found = facts(Checks(SafetySettings()), ODOMETRY, replace(VEHICLE, connected=False), NOW_NS)
    assert found.problem == "no link to the autopilot"
    old = replace(VEHICLE, t_local_ns=NOW_NS - 2_100_000_000)
    assert not facts(Checks(SafetySettings()), ODOMETRY, old, NOW_NS).link


@pytest.mark.parametrize(
    "change",
    [
        {"v_map": np.array([2.0, 0.0, 0.0])},
        {"q_map_body": rotation.from_yaw(0.5)},
        {"v_map": np.full(3, np.nan)},
    ],
)
def test_estimates_that_differ_for_half_a_second_disagree(change: dict[str, object]) -> None:
    checks = Checks(SafetySettings())
    assert facts(checks, ODOMETRY, VEHICLE, NOW_NS).estimates_agree
    for step in range(8):
        t_ns = NOW_NS + step * 100_000_000
        odometry = replace(ODOMETRY, t_ns=t_ns)
        vehicle = replace(VEHICLE, t_local_ns=t_ns, **change)  # type: ignore[arg-type]
        assert facts(checks, odometry, vehicle, t_ns).estimates_agree == (step < 5)


def test_a_disagreement_is_not_forgotten_while_nothing_can_be_compared() -> None:
    checks = Checks(SafetySettings())
    turned = replace(VEHICLE, q_map_body=rotation.from_yaw(0.5))
    for step in range(8):
        t_ns = NOW_NS + step * 100_000_000
        odometry = replace(ODOMETRY, t_ns=t_ns, quality=90 if step % 2 == 0 else 1)
        found = facts(checks, odometry, replace(turned, t_local_ns=t_ns), t_ns)
    assert not found.estimates_agree


def test_without_scans_the_vehicle_is_blind_however_fresh_the_inertial_odometry_is() -> None:
    checks = Checks(SafetySettings())
    assert facts(checks, ODOMETRY, VEHICLE, NOW_NS, NOW_NS - 390_000_000).odometry_usable
    blind = facts(checks, ODOMETRY, VEHICLE, NOW_NS, NOW_NS - 410_000_000)
    assert not blind.odometry_usable
    assert blind.problem == "no scan for 410 ms"
    assert facts(checks, ODOMETRY, VEHICLE, NOW_NS, 0).problem == "no scan yet"


def test_a_reset_of_the_map_is_noticed_from_take_off_to_landing() -> None:
    checks = Checks(SafetySettings())
    standing = replace(VEHICLE, armed=False, landed=LandedState.ON_GROUND)
    moved = replace(ODOMETRY, reset_counter=1)
    assert not facts(checks, ODOMETRY, standing, NOW_NS).map_jumped
    assert facts(checks, moved, VEHICLE, NOW_NS).map_jumped
    assert not facts(checks, moved, standing, NOW_NS).map_jumped
