import math
from dataclasses import replace

import numpy as np
import pytest

from companion.messages import VehicleMode
from sitl.autopilot_inputs import ExternalVision, VisionFrame
from tests.sitl.autopilot_rig import Rig


def test_the_steady_estimate_is_within_centimetres_and_says_so() -> None:
    rig = Rig()
    rig.take_off_to_offboard((0.5, 0.0, 0.0))
    errors = []
    for _ in range(50):
        rig.run(0.1)
        errors.append(rig.estimate_error())
    assert max(errors) < 0.03
    assert rig.autopilot.estimator.position_variance == pytest.approx(4e-4, rel=0.5)
    assert rig.autopilot.estimator.velocity_variance == pytest.approx(7e-4, rel=0.5)


def test_the_estimate_rests_on_external_vision_and_not_on_the_truth() -> None:
    rig = Rig()
    rig.change = lambda sample: replace(sample, p_local=(5.0, -2.0, 1.0))
    rig.run(2.0)
    assert rig.autopilot.estimator.p_local == pytest.approx((5.0, -2.0, 1.0), abs=0.05)


def test_dead_reckoning_drifts_as_measured() -> None:
    drifts = []
    for seed in range(4):
        rig = Rig({"EKF2_NOAID_TOUT": 6_000_000}, seed=seed)
        rig.take_off_to_offboard()
        rig.vision = False
        row = []
        for _ in range(5):
            rig.run(1.0)
            row.append(rig.estimate_error())
        drifts.append(row)
    assert np.mean(drifts, axis=0) == pytest.approx([0.3, 0.8, 1.5, 2.4, 3.5], rel=0.35, abs=0.15)


def test_the_covariance_grows_as_measured_while_coasting() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.vision = False
    variances = []
    for _ in range(5):
        rig.run(1.0)
        variances.append(rig.autopilot.estimator.position_variance)
    assert variances == pytest.approx([0.002, 0.010, 0.04, 0.1, 0.24], rel=0.4)


def test_aiding_stops_four_tenths_of_a_second_after_the_last_sample() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    resets = rig.autopilot.estimator.motion.reset_counter
    rig.vision = False
    assert rig.run(1.0, lambda: not rig.aided())
    rig.run(0.01)
    estimator = rig.autopilot.estimator
    assert estimator.velocity_valid
    assert estimator.coasting_s == pytest.approx(0.42, abs=0.03)
    assert estimator.motion.reset_counter == resets + 2, "the heading falls back to the magnetometer"


def test_returning_data_restarts_the_estimate_with_counted_resets() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.vision = False
    rig.run(2.0)
    before = rig.autopilot.estimator.motion.reset_counter
    assert rig.estimate_error() > 0.3
    rig.vision = True
    rig.run(0.5)
    assert rig.estimate_error() < 0.05
    assert rig.autopilot.estimator.motion.reset_counter - before >= 3


def test_starting_vision_counts_about_five_resets() -> None:
    rig = Rig()
    rig.run(1.0)
    assert rig.autopilot.estimator.motion.reset_counter == pytest.approx(5, abs=1)


@pytest.mark.parametrize(("rate_hz", "starts"), [(30.0, True), (10.0, True), (4.0, False)])
def test_fusion_starts_only_on_intervals_below_200_ms(rate_hz: float, starts: bool) -> None:
    rig = Rig()
    rig.vision_period_ns = round(1e9 / rate_hz)
    rig.run(2.0)
    assert rig.autopilot.estimator.position_valid is starts


def test_four_hertz_keeps_a_running_fusion_alive() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.vision_period_ns = 250_000_000
    rig.run(5.0)
    assert rig.aided()
    assert rig.estimate_error() < 0.1


def test_a_jump_without_counted_reset_is_rejected_for_one_to_two_seconds_and_then_taken() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.change = _moved(1.0)
    rig.run(1.0)
    assert abs(rig.autopilot.estimator.p_local[0] - rig.body.p[0]) < 0.2
    rig.run(1.2)
    assert rig.autopilot.estimator.p_local[0] - rig.body.p[0] == pytest.approx(1.0, abs=0.2)


def test_late_samples_are_compared_with_their_own_time() -> None:
    rig = Rig()
    rig.vision_age_ns = 60_000_000
    rig.take_off_to_offboard((1.0, 0.0, 0.0))
    rig.run(4.0)
    assert rig.estimate_error() < 0.03


def test_samples_older_than_300_ms_stop_all_fusion() -> None:
    rig = Rig()
    rig.take_off_to_offboard()
    rig.vision_age_ns = 310_000_000
    rig.run(1.5)
    estimator = rig.autopilot.estimator
    assert not estimator.aided
    assert not estimator.vision.yaw.active
    assert estimator.vision.dropped > 10


def test_an_unsupported_frame_drops_the_position_but_fuses_velocity_and_heading() -> None:
    rig = Rig()
    rig.change = lambda sample: replace(sample, frame=VisionFrame.UNSUPPORTED, p_local=None)
    rig.run(2.0)
    vision = rig.autopilot.estimator.vision
    assert (vision.position.active, vision.height.active) == (False, False)
    assert (vision.velocity.active, vision.yaw.active) == (True, True)


def test_a_missing_attitude_leaves_the_heading_to_the_magnetometer() -> None:
    rig = Rig(map_yaw=1.0)
    rig.change = lambda sample: replace(sample, q_local_body=None)
    rig.run(3.0)
    estimator = rig.autopilot.estimator
    assert estimator.vision.position.active
    assert not estimator.vision.yaw.active
    assert estimator.motion.turn == pytest.approx(-0.5 * math.pi, abs=0.3)


def test_without_magnetometer_nothing_is_fused_before_vision_gives_a_heading() -> None:
    rig = Rig({"EKF2_MAG_TYPE": 5})
    rig.change = lambda sample: replace(sample, q_local_body=None)
    rig.run(2.0)
    assert not rig.aided()
    rig.change = lambda sample: sample
    rig.run(1.0)
    assert rig.autopilot.estimator.vision.position.active


def test_a_north_frame_after_an_odometry_frame_is_not_fused_until_reboot() -> None:
    rig = Rig()
    rig.run(2.0)
    rig.change = lambda sample: replace(sample, frame=VisionFrame.NORTH)
    rig.run(1.0)
    assert not rig.aided()
    rig.change = lambda sample: sample
    rig.run(2.0)
    assert not rig.aided()


def test_a_north_frame_from_the_start_is_fused() -> None:
    rig = Rig()
    rig.change = lambda sample: replace(sample, frame=VisionFrame.NORTH)
    rig.run(2.0)
    assert rig.autopilot.estimator.vision.position.active


@pytest.mark.parametrize(("minimum", "fused"), [(0, True), (50, False)])
def test_quality_counts_only_with_a_minimum_configured(minimum: int, fused: bool) -> None:
    rig = Rig({"EKF2_EV_QMIN": minimum})
    rig.change = lambda sample: replace(sample, quality=20)
    rig.run(2.0)
    assert rig.aided() is fused


@pytest.mark.parametrize(
    ("control", "position", "height", "velocity", "yaw"),
    [
        (15, True, True, True, True),
        (11, True, True, False, True),
        (4, False, False, True, False),
        (0, False, False, False, False),
    ],
)
def test_the_control_parameter_selects_what_is_fused(
    control: int, position: bool, height: bool, velocity: bool, yaw: bool
) -> None:
    rig = Rig({"EKF2_EV_CTRL": control})
    rig.run(2.0)
    vision = rig.autopilot.estimator.vision
    active = (vision.position.active, vision.height.active, vision.velocity.active, vision.yaw.active)
    assert active == (position, height, velocity, yaw)


def test_claimed_variances_below_the_parameter_do_not_count() -> None:
    variances = []
    for claimed in (1e-8, 1e-2, None):
        rig = Rig()
        covariance = None if claimed is None else (claimed, claimed, claimed)
        rig.change = _claiming(covariance)
        rig.run(3.0)
        variances.append(rig.autopilot.estimator.position_variance)
    assert variances[0] == variances[1] == variances[2]


def test_gnss_gives_a_global_position_and_a_north_aligned_frame() -> None:
    rig = Rig(gnss=True)
    rig.run(2.0)
    assert not rig.autopilot.conditions().global_position
    rig.run(3.0)
    assert rig.autopilot.conditions().global_position
    rig.autopilot.request_mode(VehicleMode.TAKEOFF)
    rig.autopilot.request_arming(True)
    assert rig.run(15.0, lambda: rig.mode() is VehicleMode.HOLD)
    rig.fly_offboard((1.0, 0.0, 0.0))
    rig.run(0.1)
    rig.autopilot.request_mode(VehicleMode.OFFBOARD)
    rig.run(3.0)
    assert rig.body.v[1] == pytest.approx(1.0, abs=0.1), "local x is north"


def _moved(distance: float):  # type: ignore[no-untyped-def]
    def change(sample: ExternalVision) -> ExternalVision:
        x, y, z = sample.p_local or (0.0, 0.0, 0.0)
        return replace(sample, p_local=(x + distance, y, z))

    return change


def _claiming(variance: tuple[float, float, float] | None):  # type: ignore[no-untyped-def]
    return lambda sample: replace(sample, position_variance=variance)
