import dataclasses

import numpy as np

from companion.messages import ImuSample, LidarScan
from companion.perception.odometry.scan_monitor import ScanMonitor
from companion.perception.odometry.settings import OdometrySettings

OFFSET_NS = 5_000_000_000
PERIOD_NS = 100_000_000


def _scan(index: int, shift_ns: int = 0, seed: int | None = None) -> LidarScan:
    rng = np.random.default_rng(index if seed is None else seed)
    points = rng.normal(0.0, 5.0, (3000, 3)).astype(np.float32)
    end_ns = PERIOD_NS * (index + 1)
    return LidarScan(
        t_ns=end_ns + OFFSET_NS,
        sequence=index,
        t_sensor_start_ns=end_ns - PERIOD_NS + shift_ns,
        t_sensor_end_ns=end_ns + shift_ns,
        clock_offset_ns=OFFSET_NS,
        points_lidar=points,
        offsets_ns=np.zeros(3000, dtype=np.int32),
        reflectivity=np.zeros(3000, dtype=np.uint8),
        tags=np.zeros(3000, dtype=np.uint8),
        packets=208,
        packets_expected=208,
    )


def _sample(scan: LidarScan, early_ns: int = 2_000_000) -> ImuSample:
    """The newest sample when the scan arrives."""
    t_ns = scan.t_ns - early_ns
    return ImuSample(t_ns, t_ns - OFFSET_NS, np.zeros(3), np.zeros(3))


def _observe(monitor: ScanMonitor, scan: LidarScan) -> str:
    return monitor.observe(scan, _sample(scan))


def test_scans_of_a_world_are_healthy() -> None:
    monitor = ScanMonitor(OdometrySettings())
    assert [_observe(monitor, _scan(i)) for i in range(20)] == [""] * 20


def test_a_scan_that_comes_again_is_noticed_at_once() -> None:
    monitor = ScanMonitor(OdometrySettings())
    _observe(monitor, _scan(0, seed=7))
    assert _observe(monitor, _scan(1, seed=7)) == "LiDAR frozen: scans repeat"


def test_a_covered_window_is_noticed_whether_nothing_returns_or_all_from_near() -> None:
    monitor = ScanMonitor(OdometrySettings())
    scan = _scan(0)
    empty = dataclasses.replace(scan, points_lidar=scan.points_lidar[:12])
    assert _observe(monitor, empty) == "LiDAR sees nothing: 12 returns"
    ranges = np.linalg.norm(scan.points_lidar, axis=1, keepdims=True)
    near = dataclasses.replace(scan, points_lidar=(0.4 * scan.points_lidar / ranges).astype(np.float32))
    assert _observe(monitor, near).startswith("LiDAR blocked: 100 %")


def test_stamps_that_move_against_the_imus_are_noticed_at_the_second_scan() -> None:
    monitor = ScanMonitor(OdometrySettings())
    for i in range(10):
        assert _observe(monitor, _scan(i)) == ""
    assert _observe(monitor, _scan(10, shift_ns=-60_000_000)) == ""
    told = _observe(monitor, _scan(11, shift_ns=-60_000_000))
    assert told == "stamps of scans moved by +60 ms against the IMU's"


def test_one_scan_held_up_on_its_way_and_jitter_are_no_fault() -> None:
    monitor = ScanMonitor(OdometrySettings())
    rng = np.random.default_rng(3)
    for i in range(60):
        late_ns = 80_000_000 if i == 30 else int(rng.uniform(0.0, 15e6))
        assert _observe(monitor, _scan(i, shift_ns=-late_ns)) == ""


def test_stamps_that_keep_their_new_distance_become_the_usual_ones() -> None:
    monitor = ScanMonitor(OdometrySettings())
    for i in range(15):
        _observe(monitor, _scan(i))
    told = [_observe(monitor, _scan(i, shift_ns=50_000_000)) for i in range(15, 40)]
    assert told[1] != ""
    assert told[-10:] == [""] * 10


def test_while_the_imu_is_silent_its_stamps_say_nothing() -> None:
    monitor = ScanMonitor(OdometrySettings())
    last = _sample(_scan(9))
    for i in range(10):
        _observe(monitor, _scan(i))
    assert all(monitor.observe(_scan(i), last) == "" for i in range(11, 20))
