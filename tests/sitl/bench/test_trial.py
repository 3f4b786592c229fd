import mmap
from collections.abc import Iterator

import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.geometry.trajectory import Trajectory
from companion.messages import ImuSample, LidarScan
from sitl.bench.comparison import results
from sitl.bench.contenders import Estimate, Job, SensorEvent
from sitl.bench.trial import Race, Trial, resident_mib

PERIOD_NS = 100_000_000


def _scan(index: int) -> LidarScan:
    empty = np.zeros(0, np.uint8)
    return LidarScan(
        t_ns=(index + 1) * PERIOD_NS,
        sequence=index,
        t_sensor_start_ns=index * PERIOD_NS,
        t_sensor_end_ns=(index + 1) * PERIOD_NS,
        clock_offset_ns=0,
        points_lidar=np.zeros((0, 3), np.float32),
        offsets_ns=np.zeros(0, np.int32),
        reflectivity=empty,
        tags=empty,
        packets=0,
        packets_expected=0,
    )


class _Scripted:
    """Knows the way, but stumbles as told."""

    setup = "scripted"
    remark = ""

    def __init__(self, calls: list[str], name: str, *, raises_at: int = -1, silent_at: int = -1) -> None:
        self.calls = calls
        self.name = name
        self.raises_at = raises_at
        self.silent_at = silent_at
        self.nonsense_at = -1

    def jobs(self, event: SensorEvent) -> Iterator[Job]:
        yield lambda: self._run(event)

    def _run(self, event: SensorEvent) -> Estimate | None:
        if isinstance(event, ImuSample) or event.sequence == self.silent_at:
            return None
        self.calls.append(self.name)
        if event.sequence == self.raises_at:
            raise RuntimeError("lost the\n way")
        p = [float(event.sequence) if event.sequence != self.nonsense_at else np.nan, 0.0, 0.0]
        return Estimate(event.t_sensor_end_ns, Pose(np.array(p), rotation.IDENTITY))


def _truth(scans: int) -> Trajectory:
    p = np.zeros((scans, 3))
    p[:, 0] = np.arange(scans)
    t_ns = (np.arange(scans, dtype=np.int64) + 1) * PERIOD_NS
    return Trajectory(t_ns, p, np.tile(rotation.IDENTITY, (scans, 1)))


def test_the_order_of_the_systems_rotates_from_scan_to_scan() -> None:
    calls: list[str] = []
    race = Race([Trial(name, _Scripted(calls, name), 4) for name in "abc"])
    for index in range(4):
        race.take(_scan(index))
    assert "".join(calls) == "abcbcacababc"


def test_what_a_system_raises_or_makes_up_is_counted_and_the_others_fly_on() -> None:
    calls: list[str] = []
    stumbling = _Scripted(calls, "stumbling", raises_at=30, silent_at=40)
    stumbling.nonsense_at = 50
    race = Race([Trial("stumbling", stumbling, 16), Trial("steady", _Scripted(calls, "steady"), 16)])
    for index in range(100):  # more than was reckoned with
        race.take(_scan(index))
    bad, good = (result.row for result in results("somewhere", race, _truth(100)))
    assert (bad.failures, good.failures) == (2, 0)
    assert bad.note == "RuntimeError: lost the way"
    assert (bad.scans, good.scans) == (80, 80)  # the first two seconds do not count
    assert good.coverage_percent == 100.0
    assert bad.coverage_percent == 100.0 * 77 / 80
    assert good.ape_rmse_m is not None
    assert good.ape_rmse_m < 1e-9


def test_an_error_of_our_own_is_not_forgiven() -> None:
    race = Race([Trial("ours", _Scripted([], "ours", raises_at=3), 16, forgiving=False)])
    race.take(_scan(2))
    with pytest.raises(RuntimeError):
        race.take(_scan(3))


def test_without_truth_there_are_times_but_no_errors() -> None:
    race = Race([Trial("steady", _Scripted([], "steady"), 16)])
    for index in range(50):
        race.take(_scan(index))
    row = results("somewhere", race, None)[0].row
    assert row.ape_rmse_m is None
    assert row.drift_percent is None
    assert row.path_m is None
    assert row.cpu_ms_median is not None
    assert row.memory_growth_mib is None  # shorter than a minute


def test_memory_growth_is_counted_after_the_first_minute() -> None:
    race = Race([Trial("steady", _Scripted([], "steady"), 2000)])
    # Straight from the system: what was freed before would be used again, and nothing would grow.
    with mmap.mmap(-1, 32 * 2**20) as kept:
        for index in range(800):
            if index == 700:
                kept.write(bytes(32 * 2**20))
            race.take(_scan(index))
    growth_mib = results("somewhere", race, None)[0].row.memory_growth_mib
    if resident_mib() is None:
        assert growth_mib is None
    else:
        assert growth_mib is not None
        assert 24.0 < growth_mib < 48.0
