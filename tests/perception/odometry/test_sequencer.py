import numpy as np
import pytest

from companion.messages import ImuSample, LidarScan
from companion.perception.odometry.inertial_history import CAPACITY, InertialHistory
from companion.perception.odometry.sequencer import MOST_WAITING_SCANS, Arrival, Sequencer
from companion.perception.odometry.settings import OdometrySettings

SETTINGS = OdometrySettings()
MS = 1_000_000


def _sample(t_ms: float, host_ms: float | None = None, accel: float = 0.0) -> ImuSample:
    t_ns = round(t_ms * MS)
    host_ns = t_ns if host_ms is None else round(host_ms * MS)
    return ImuSample(host_ns, t_ns, np.zeros(3), np.array([accel, 0.0, 9.81]))


def _scan(start_ms: int, sequence: int = 0) -> LidarScan:
    empty = np.zeros(0, np.uint8)
    return LidarScan(
        0, sequence, start_ms * MS, (start_ms + 100) * MS, 0,
        np.zeros((0, 3), np.float32), np.zeros(0, np.int32), empty, empty, 1, 1,
    )  # fmt: skip


def test_a_scan_is_held_until_a_sample_reaches_its_end() -> None:
    sequencer = Sequencer(SETTINGS)
    sequencer.add_sample(_sample(0))
    sequencer.add_scan(_scan(0))
    for t in range(5, 100, 5):
        sequencer.add_sample(_sample(t))
        assert sequencer.covered_scan(0) is None
    sequencer.add_sample(_sample(100))
    assert sequencer.covered_scan(0) is not None
    assert sequencer.covered_scan(0) is None


def test_scans_leave_in_order_and_those_already_passed_are_dropped() -> None:
    sequencer = Sequencer(SETTINGS)
    for t in range(0, 405, 5):
        sequencer.add_sample(_sample(t))
    for k in range(4):
        sequencer.add_scan(_scan(100 * k, k))
    first = sequencer.covered_scan(250 * MS)
    assert first is not None
    assert first.sequence == 2
    assert sequencer.counts.scans_stale == 2


def test_a_scan_stamped_too_far_ahead_does_not_keep_the_next_one_waiting() -> None:
    sequencer = Sequencer(SETTINGS)
    sequencer.add_sample(_sample(0))
    sequencer.add_scan(_scan(2000, 7))
    sequencer.add_scan(_scan(0, 8))
    for t in range(5, 105, 5):
        sequencer.add_sample(_sample(t))
    scan = sequencer.covered_scan(0)
    assert scan is not None
    assert scan.sequence == 8
    assert sequencer.counts.scans_stale == 1


def test_the_queue_of_scans_is_bounded() -> None:
    sequencer = Sequencer(SETTINGS)
    for k in range(MOST_WAITING_SCANS + 5):
        sequencer.add_scan(_scan(100 * k, k))
    assert sequencer.counts.scans_overflowed == 5


def test_repeated_and_late_samples_are_counted_and_dropped() -> None:
    sequencer = Sequencer(SETTINGS)
    assert sequencer.add_sample(_sample(100)) is Arrival.FIRST
    assert sequencer.add_sample(_sample(105)) is Arrival.ACCEPTED
    assert sequencer.add_sample(_sample(105)) is Arrival.DROPPED
    assert sequencer.add_sample(_sample(95)) is Arrival.DROPPED
    assert sequencer.add_sample(_sample(110)) is Arrival.ACCEPTED
    assert sequencer.counts.samples_repeated == 2
    assert len(sequencer.history) == 3


@pytest.mark.parametrize("accel", [float("nan"), float("inf"), -1e9])
def test_samples_that_no_chip_measures_are_dropped(accel: float) -> None:
    sequencer = Sequencer(SETTINGS)
    assert sequencer.add_sample(_sample(0, accel=accel)) is Arrival.DROPPED
    assert sequencer.counts.samples_implausible == 1
    assert len(sequencer.history) == 0


@pytest.mark.parametrize("jump_ms", [60_000, -60_000])
def test_a_set_clock_moves_the_past_along_when_the_host_saw_no_gap(jump_ms: int) -> None:
    sequencer = Sequencer(SETTINGS)
    for t in range(100_000, 100_100, 5):
        sequencer.add_sample(_sample(t, host_ms=t))
    arrival = sequencer.add_sample(_sample(100_100 + jump_ms, host_ms=100_100))
    assert arrival is Arrival.RELABELLED
    assert sequencer.relabelled_by_ns == jump_ms * MS
    stretch = sequencer.history.between(
        (100_000 + jump_ms) * MS, (100_100 + jump_ms) * MS, (100_000 + jump_ms) * MS
    )
    np.testing.assert_allclose(np.diff(stretch.t_s), 0.005)
    assert stretch.suspect[-1]


def test_a_gap_that_the_host_saw_too_breaks_the_sequence() -> None:
    sequencer = Sequencer(SETTINGS)
    sequencer.add_sample(_sample(0))
    assert sequencer.add_sample(_sample(5000, host_ms=5000)) is Arrival.BROKEN
    assert len(sequencer.history) == 1


def test_a_stretch_is_cut_at_both_ends_and_uses_the_sample_that_ends_each_interval() -> None:
    history = InertialHistory()
    for k in range(5):
        history.append(10 * k * MS, np.full(3, float(k)), np.zeros(3), suspect=k == 3)
    stretch = history.between(5 * MS, 32 * MS, 5 * MS)
    np.testing.assert_allclose(stretch.t_s, [0.0, 0.005, 0.015, 0.025, 0.027])
    np.testing.assert_allclose(stretch.inertial[:, 0], [1.0, 2.0, 3.0, 4.0])
    assert stretch.suspect.tolist() == [False, False, True, False]
    beyond = history.between(40 * MS, 45 * MS, 0)
    np.testing.assert_allclose(beyond.inertial[:, 0], [4.0])


def test_a_stretch_needs_samples_and_order() -> None:
    history = InertialHistory()
    with pytest.raises(ValueError, match="no inertial stretch"):
        history.between(0, 1, 0)
    history.append(0, np.zeros(3), np.zeros(3), suspect=False)
    with pytest.raises(ValueError, match="no inertial stretch"):
        history.between(1, 1, 0)


def test_the_history_is_bounded_and_keeps_the_newest() -> None:
    history = InertialHistory()
    for k in range(5 * CAPACITY):
        history.append(5 * k * MS, np.full(3, float(k)), np.zeros(3), suspect=False)
        assert len(history) <= CAPACITY
    last = 5 * CAPACITY - 1
    assert history.last_ns == 5 * last * MS
    stretch = history.between(5 * (last - 10) * MS, 5 * last * MS, 0)
    np.testing.assert_allclose(stretch.inertial[:, 0], np.arange(last - 9, last + 1))
