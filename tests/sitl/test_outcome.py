"""What a flight came to, on values worked out by hand."""

import hashlib
import math
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from companion.geometry import rotation
from companion.logs import channels
from companion.logs.metadata import FlightMetadata
from companion.logs.records import StampedPose, Statistics
from companion.logs.writer import FlightLog, LogSettings
from companion.messages import FloatArray, MavlinkMessage, Odometry, OdometryStatus, Setpoint
from sitl.outcome import (
    Ending,
    Latency,
    OdometryError,
    SetpointStream,
    evaluate,
    latency,
    odometry_error,
    stream,
)

MS = 1_000_000
SECOND = 1_000_000_000
SENT = MavlinkMessage("SET_POSITION_TARGET_LOCAL_NED", 1, 191, {"vx": 1.0})
ENDING = Ending(
    success=True,
    reason="landed at the goal",
    goal_distance_m=0.25,
    collisions=0,
    sim_time_s=30.0,
    wall_time_s=6.0,
)


def setpoint(t_ms: float, scan_ms: float) -> Setpoint:
    return Setpoint(round(t_ms * MS), round(t_ms * MS), round(scan_ms * MS), np.zeros(3), 0.0, "role")


def odometry(
    t_s: float, p_map: FloatArray, *, status: OdometryStatus = OdometryStatus.TRACKING, tilt: float = 0.0
) -> Odometry:
    return Odometry(
        t_ns=round(t_s * SECOND),
        t_sensor_ns=0,
        p_map=p_map,
        q_map_body=rotation.exp([tilt, 0.0, 0.0]),
        v_map=np.zeros(3),
        omega_body=np.zeros(3),
        covariance_pose=np.eye(6),
        covariance_velocity=np.eye(3),
        quality=90,
        reset_counter=0,
        status=status,
    )


def true_pose(t_s: float, x: float) -> StampedPose:
    return StampedPose(round(t_s * SECOND), "world", np.array([x, 0.0, 1.0]), rotation.IDENTITY)


class TestLatency:
    def test_counts_from_a_scan_to_the_first_setpoint_on_it_that_left(self) -> None:
        setpoints = [setpoint(110, 100), setpoint(220, 200), setpoint(240, 200), setpoint(330, 300)]
        sent_ns = [111 * MS, 224 * MS, 241 * MS, 336 * MS]
        # The first scan does not count; the others took 24 and 36 ms.
        assert astuple(latency(setpoints, sent_ns)) == pytest.approx((30.0, 35.88))

    def test_a_setpoint_without_a_scan_or_never_sent_does_not_count(self) -> None:
        setpoints = [setpoint(50, 0), setpoint(110, 100), setpoint(220, 200), setpoint(330, 300)]
        assert astuple(latency(setpoints, [111 * MS, 225 * MS])) == pytest.approx((25.0, 25.0))

    def test_without_two_scans_there_is_none(self) -> None:
        assert latency([setpoint(110, 100)], [111 * MS]) == Latency(None, None)
        assert latency([], []) == Latency(None, None)


class TestStream:
    def test_the_rate_is_the_mean_and_the_gap_the_longest(self) -> None:
        gaps_ms = np.array([0, 20, 20, 40, 20])
        found = stream((np.cumsum(gaps_ms) * MS).tolist())
        assert astuple(found) == pytest.approx((40.0, 40.0))

    def test_one_setpoint_is_no_stream(self) -> None:
        assert stream([5 * MS]) == stream([]) == SetpointStream(None, None)


class TestOdometryError:
    def test_a_map_that_is_merely_turned_and_moved_is_no_error(self) -> None:
        truth = [true_pose(t, 2.0 * t) for t in range(6)]
        estimates = [odometry(t, np.array([2.0 * t - 3.0, 4.0, 0.0])) for t in range(6)]
        error = odometry_error(estimates, truth)
        assert error.ape_rmse_m == pytest.approx(0.0, abs=1e-9)
        assert error.drift_percent == pytest.approx(0.0, abs=1e-9)
        assert error.map_tilt_deg == pytest.approx(0.0, abs=1e-6)

    def test_a_scale_error_is_drift_by_the_path_flown(self) -> None:
        # 10 m flown, 10.2 m believed: 2 %. Aligned by their means, errors are 0.02 m x (-5 ... 5).
        truth = [true_pose(t, 1.0 * t) for t in range(11)]
        estimates = [odometry(t, np.array([1.02 * t, 0.0, 1.0])) for t in range(11)]
        error = odometry_error(estimates, truth)
        assert error.drift_percent == pytest.approx(2.0)
        assert error.ape_rmse_m == pytest.approx(0.02 * math.sqrt(10.0))

    def test_a_tilted_start_is_the_maps_tilt(self) -> None:
        truth = [true_pose(t, 1.0 * t) for t in range(4)]
        estimates = [odometry(t, np.array([1.0 * t, 0.0, 1.0]), tilt=math.radians(3.0)) for t in range(4)]
        assert odometry_error(estimates, truth).map_tilt_deg == pytest.approx(3.0)

    def test_without_estimates_or_truth_nothing_is_claimed(self) -> None:
        nothing = OdometryError(None, None, None)
        truth = [true_pose(t, 1.0 * t) for t in range(4)]
        estimates = [odometry(t + 100.0, np.zeros(3)) for t in range(4)]
        assert odometry_error([], truth) == odometry_error(estimates, []) == nothing
        assert odometry_error(estimates, truth) == nothing


def test_a_flight_is_judged_by_its_log(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    metadata = FlightMetadata(vehicle="uav1", role="leader", mode="lockstep", configuration="", seed=1)
    log = FlightLog(path, LogSettings(), metadata, threaded=False)
    for step in range(11):
        t_ns = step * SECOND
        log.write(channels.TRUTH, true_pose(step, 1.0 * step), t_ns)
        initialising = step == 0
        status = OdometryStatus.INITIALISING if initialising else OdometryStatus.TRACKING
        # What is said while initialising does not count, however wrong.
        p_map = np.array([500.0 if initialising else 1.0 * step, 0.0, 1.0])
        log.record(odometry(step, p_map, status=status), t_ns)
        log.record(setpoint(1e3 * step, 1e3 * step - 15.0), t_ns)
        log.write(channels.MAVLINK_TX, SENT, t_ns + 5 * MS)
        log.write(channels.MAVLINK_TX, MavlinkMessage("HEARTBEAT", 1, 191, {}), t_ns + 6 * MS)
        log.record(Statistics(t_ns, "lidar", {"packets": 100 * step, "lost": step}), t_ns)
        log.record(Statistics(t_ns, "runtime", {"messages_dropped": 99}), t_ns)
    log.close()
    outcome = evaluate(ENDING, path)
    assert outcome.success
    assert outcome.real_time_factor == 5.0
    assert outcome.odometry.ape_rmse_m == pytest.approx(0.0, abs=1e-9)
    assert astuple(outcome.latency_ms) == pytest.approx((20.0, 20.0))
    assert astuple(outcome.setpoints) == pytest.approx((1.0, 1000.0))
    assert (outcome.livox.packets, outcome.livox.lost) == (1000, 10)
    assert outcome.log == str(path)
    assert outcome.log_sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
