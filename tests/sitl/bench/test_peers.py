import sys

import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import LidarScan
from sitl.bench.comparison import SYSTEMS, Result, Row
from sitl.bench.odometry import Plan, measure
from sitl.bench.peers import deskewed

_COMPARED = ("rko_lio", "kiss_icp", "small_gicp")


@pytest.fixture(scope="module")
def flight() -> dict[str, Result]:
    """One short flight with everybody who is installed."""
    return {result.row.system: result for result in measure(Plan(["indoor"], SYSTEMS, 10.0, seed=3))}


@pytest.mark.parametrize("system", _COMPARED)
def test_a_peer_follows_the_flight(flight: dict[str, Result], system: str) -> None:
    pytest.importorskip(system)
    row = flight[system].row
    assert row.ape_rmse_m is not None
    assert row.ape_rmse_m < 0.15
    assert row.coverage_percent == pytest.approx(100.0)
    assert row.failures == 0
    assert row.cpu_ms_median is not None
    assert row.cpu_ms_median > 0.0
    assert row.note == ""


@pytest.mark.parametrize("system", _COMPARED)
def test_the_pose_of_a_peer_is_that_of_the_end_of_the_scan(flight: dict[str, Result], system: str) -> None:
    pytest.importorskip(system)
    judgement = flight[system].judgement
    assert judgement is not None
    flying = slice(40, None)
    v = np.gradient(judgement.p_true, 0.1, axis=0)[flying]
    late_m = np.sum((judgement.p_laid - judgement.p_true)[flying] * v, axis=1)
    late_s = float(np.sum(late_m) / np.sum(v * v))
    assert abs(late_s) < 0.02  # half a scan would be 0.05


def test_ours_follows_it_better_than_all_of_them(flight: dict[str, Result]) -> None:
    ours = flight["companion"].row
    assert ours.ape_rmse_m is not None
    assert ours.ape_rmse_m < 0.01
    assert ours.velocity_rmse_mps is not None
    assert ours.velocity_rmse_mps < 0.1
    others = [result.row.ape_rmse_m for name, result in flight.items() if name != "companion"]
    assert all(ours.ape_rmse_m < other for other in others if other is not None)


def test_a_peer_that_is_not_installed_gets_a_row_that_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    rows = [result.row for result in measure(Plan(["indoor"], ["small_gicp", "companion"], 5.0))]
    assert [row.system for row in rows] == ["small_gicp", "companion"]
    assert isinstance(rows[0], Row)
    assert "not installed" in rows[0].note
    assert rows[0].ape_rmse_m is None
    assert rows[1].ape_rmse_m is not None


def test_deskewing_undoes_a_constant_motion() -> None:
    rng = np.random.default_rng(2)
    p_world = rng.uniform(-10.0, 10.0, (500, 3))
    offsets_ns = np.sort(rng.integers(0, 100_000_000, 500)).astype(np.int32)
    share = offsets_ns[:, None] / 1e8
    turn, step = np.array([0.02, -0.01, 0.15]), np.array([0.3, 0.05, -0.02])
    # The sensor moves from the origin, in a straight line while it turns.
    q_start_sensor = rotation.exp(share * turn)
    points = rotation.rotate(rotation.conjugate(q_start_sensor), p_world - share * step)
    scan = LidarScan(
        t_ns=0,
        sequence=0,
        t_sensor_start_ns=0,
        t_sensor_end_ns=100_000_000,
        clock_offset_ns=0,
        points_lidar=points.astype(np.float32),
        offsets_ns=offsets_ns,
        reflectivity=np.zeros(500, np.uint8),
        tags=np.zeros(500, np.uint8),
        packets=1,
        packets_expected=1,
    )
    motion = Pose.of(step, rotation.exp(turn))
    np.testing.assert_allclose(deskewed(scan, motion), motion.inverse().transform(p_world), atol=1e-4)
