import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as dialect

from sitl.autopilot_inputs import VisionFrame
from sitl.mavlink_inbound import external_vision, offboard_setpoint, vision_position_estimate
from sitl.mavlink_timesync import CONVERGED_AFTER, Timesync

_Q = [math.cos(0.3), 0.0, 0.0, math.sin(0.3)]


def odometry(**changes: Any) -> Any:
    fields: dict[str, Any] = {
        "time_usec": 1,
        "frame_id": 20,
        "child_frame_id": 12,
        "x": 1.0,
        "y": 2.0,
        "z": -3.0,
        "q": list(_Q),
        "vx": 0.1,
        "vy": 0.2,
        "vz": -0.3,
        "rollspeed": 0.0,
        "pitchspeed": 0.0,
        "yawspeed": 0.0,
        "pose_covariance": [4e-4] * 21,
        "velocity_covariance": [2.5e-3] * 21,
        "reset_counter": 3,
        "estimator_type": 3,
        "quality": 100,
    }
    return dialect.MAVLink_odometry_message(**{**fields, **changes})


def target(**changes: Any) -> Any:
    fields: dict[str, Any] = {
        "time_boot_ms": 0,
        "target_system": 1,
        "target_component": 1,
        "coordinate_frame": 1,
        "type_mask": 0x9C7,
        **dict.fromkeys(("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"), 0.0),
    }
    return dialect.MAVLink_set_position_target_local_ned_message(**{**fields, **changes})


@pytest.mark.parametrize(
    ("estimator", "taken"), [(1, True), (2, True), (3, True), (0, False), (6, False), (7, False), (8, False)]
)
def test_only_naive_vision_and_vio_estimators_reach_the_estimator(estimator: int, taken: bool) -> None:
    assert (external_vision(odometry(estimator_type=estimator), 0) is not None) is taken


def test_an_frd_sample_is_turned_z_up() -> None:
    sample = external_vision(odometry(), 7)
    assert sample is not None
    assert sample.t_ns == 7
    assert sample.frame is VisionFrame.ODOMETRY
    assert sample.p_local == pytest.approx((1.0, -2.0, 3.0))
    assert sample.v == pytest.approx((0.1, -0.2, 0.3))
    assert sample.v_in_body
    assert sample.q_local_body == pytest.approx((_Q[0], 0.0, 0.0, -_Q[3]))
    assert sample.position_variance == pytest.approx((4e-4, 4e-4, 4e-4))


@pytest.mark.parametrize(
    ("frame", "kind", "p"),
    [
        (20, VisionFrame.ODOMETRY, (1.0, -2.0, 3.0)),
        (21, VisionFrame.ODOMETRY, (1.0, 2.0, -3.0)),
        (1, VisionFrame.NORTH, (1.0, -2.0, 3.0)),
        (14, VisionFrame.UNSUPPORTED, None),
        (0, VisionFrame.UNSUPPORTED, None),
    ],
)
def test_the_frame_decides_what_becomes_of_the_position(frame: int, kind: VisionFrame, p: object) -> None:
    sample = external_vision(odometry(frame_id=frame), 0)
    assert sample is not None
    assert sample.frame is kind
    assert sample.p_local == (p if p is None else pytest.approx(p))
    assert sample.v is not None
    assert sample.q_local_body is not None


@pytest.mark.parametrize(
    ("scale", "taken"), [(1.0, True), (1.0 + 5e-6, True), (1.0 + 1e-4, False), (1.0 - 1e-4, False)]
)
def test_an_attitude_off_unit_norm_is_dropped_alone(scale: float, taken: bool) -> None:
    sample = external_vision(odometry(q=[scale * c for c in _Q]), 0)
    assert sample is not None
    assert (sample.q_local_body is not None) is taken
    assert sample.p_local is not None


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e30])
def test_unusable_numbers_drop_their_own_part(bad: float) -> None:
    sample = external_vision(odometry(x=bad, vy=bad, q=[bad, 0.0, 0.0, 0.0]), 0)
    assert sample is not None
    assert (sample.p_local, sample.v, sample.q_local_body) == (None, None, None)


def test_an_unknown_covariance_leaves_the_variance_open() -> None:
    sample = external_vision(odometry(pose_covariance=[math.nan] + [0.0] * 20), 0)
    assert sample is not None
    assert sample.position_variance is None
    assert sample.yaw_variance == 0.0


def test_a_vision_position_estimate_has_attitude_but_no_velocity() -> None:
    message = dialect.MAVLink_vision_position_estimate_message(0, 1.0, 2.0, 3.0, 0.0, 0.0, 0.6, [0.0] * 21, 4)
    sample = vision_position_estimate(message, 0)
    assert sample.frame is VisionFrame.NORTH
    assert sample.v is None
    assert sample.q_local_body == pytest.approx((_Q[0], 0.0, 0.0, -_Q[3]))
    assert sample.reset_counter == 4


@pytest.mark.parametrize(
    ("frame", "taken"), [(1, True), (8, True), (7, False), (9, False), (12, False), (20, False)]
)
def test_only_local_ned_and_body_ned_setpoints_are_taken(frame: int, taken: bool) -> None:
    assert (offboard_setpoint(target(coordinate_frame=frame)) is not None) is taken


def test_the_velocity_mask_of_mavsdk_commands_velocity_and_yaw() -> None:
    setpoint = offboard_setpoint(target(vx=1.0, vy=2.0, vz=-3.0, yaw=0.5))
    assert setpoint is not None
    assert setpoint.p_local is None
    assert setpoint.v_local == (1.0, -2.0, 3.0)
    assert (setpoint.yaw, setpoint.yaw_rate) == (-0.5, None)
    assert not setpoint.v_in_heading


def test_one_ignored_velocity_component_means_all_are() -> None:
    setpoint = offboard_setpoint(target(type_mask=0x5C7 | 0x10, yaw_rate=0.2, coordinate_frame=8))
    assert setpoint is None


def test_a_setpoint_without_finite_content_is_refused() -> None:
    assert offboard_setpoint(target(vx=math.nan)) is None


def test_time_of_arrival_is_used_until_five_hundred_good_replies() -> None:
    sync = Timesync()
    for index in range(CONVERGED_AFTER):
        assert sync.to_boot_us(123, 10**7) == 10**7
        sync.reply(index * 100_000 + 1000, index * 100_000, index * 100_000 + 5_000_500)
    assert sync.converged
    assert sync.to_boot_us(5_000_000 + 77_000, 10**9) == pytest.approx(77_000, abs=10)


def test_a_zero_stamp_after_convergence_wraps_into_an_absurd_time() -> None:
    sync = Timesync()
    for index in range(CONVERGED_AFTER):
        sync.reply(index * 100_000 + 1000, index * 100_000, index * 100_000 + 10**12)
    assert sync.to_boot_us(0, 10**9) > 2**63


def test_slow_replies_do_not_count_and_restart_the_estimate() -> None:
    sync = Timesync()
    for index in range(100):
        sync.reply(index * 100_000 + 1000, index * 100_000, index * 100_000)
    sync.reply(10**8 + 20_000, 10**8, 10**8)
    assert sync.samples == 100
    for index in range(11):
        sync.reply(10**8 + index * 100_000 + 20_000, 10**8 + index * 100_000, 0)
    assert sync.samples == 0


def test_a_slow_clock_of_seven_per_mille_is_tracked_within_milliseconds() -> None:
    sync = Timesync()
    for index in range(700):
        boot_us = index * 100_000
        sync.reply(boot_us + 1000, boot_us, round((boot_us + 500) / 0.993))
    now_us = 699 * 100_000
    assert abs(sync.to_boot_us(round(now_us / 0.993), now_us) - now_us) < 60_000
