import numpy as np
import pytest

from companion.drivers.livox_clock import (
    FALL_LIMIT_PPM,
    IMPOSSIBLY_EARLY_NS,
    RISE_LIMIT_PPM,
    ClockOffsetEstimator,
)

PERIOD_NS = 480_000
OFFSET_NS = 7_000_000_000
MS = 1_000_000
S = 1_000_000_000


def run(
    estimator: ClockOffsetEstimator,
    start_ns: int,
    duration_ns: int,
    rng: np.random.Generator,
    drift_ppm: float = 0.0,
    offset_ns: int = OFFSET_NS,
) -> list[int]:
    """Feed packets whose delay is 50 us plus an exponential tail; return the offset after each."""
    offsets = []
    for t_sensor_ns in range(start_ns, start_ns + duration_ns, PERIOD_NS):
        delay_ns = 50_000 + int(rng.exponential(300_000))
        truth_ns = offset_ns + int(t_sensor_ns * drift_ppm * 1e-6)
        estimator.update(t_sensor_ns + truth_ns + delay_ns, t_sensor_ns)
        offsets.append(estimator.offset_ns)
    return offsets


@pytest.mark.parametrize("drift_ppm", [-80.0, 0.0, 80.0])
def test_the_offset_follows_a_drifting_clock_closely_despite_late_packets(drift_ppm: float) -> None:
    estimator = ClockOffsetEstimator()
    run(estimator, 0, 20 * S, np.random.default_rng(1), drift_ppm)
    truth_ns = OFFSET_NS + int(20 * S * drift_ppm * 1e-6)
    assert abs(estimator.offset_ns - 50_000 - truth_ns) < 250_000
    assert estimator.settled
    assert estimator.restarts == 0


def test_the_offset_never_steps_faster_than_its_limits_once_settled() -> None:
    estimator = ClockOffsetEstimator()
    rng = np.random.default_rng(2)
    run(estimator, 0, 2 * S, rng)
    before_ns = estimator.offset_ns
    t_host_ns = 0
    for index in range(20_000):
        t_sensor_ns = 2 * S + index * PERIOD_NS
        # A queue that fills for a second and then drains: every packet is late by up to 40 ms.
        delay_ns = 50_000 + (40 * MS if 2_000 < index < 12_000 else 0)
        previous_ns, t_host_ns = t_host_ns, t_sensor_ns + OFFSET_NS + delay_ns
        estimator.update(t_host_ns, t_sensor_ns)
        step_ns = estimator.offset_ns - before_ns
        elapsed_ns = max(0, t_host_ns - previous_ns) if previous_ns else PERIOD_NS
        assert (
            -elapsed_ns * FALL_LIMIT_PPM // 10**6 - 1 <= step_ns <= elapsed_ns * RISE_LIMIT_PPM // 10**6 + 1
        )
        before_ns = estimator.offset_ns
    assert abs(estimator.offset_ns - OFFSET_NS - 50_000) < 100_000
    assert estimator.restarts == 0


def test_a_stall_of_the_host_does_not_move_the_offset() -> None:
    estimator = ClockOffsetEstimator()
    rng = np.random.default_rng(3)
    run(estimator, 0, 3 * S, rng)
    settled_ns = estimator.offset_ns
    t_host_ns = 3 * S + OFFSET_NS + 800 * MS
    for t_sensor_ns in range(3 * S, 3 * S + 800 * MS, PERIOD_NS):
        t_host_ns += 5_000
        estimator.update(max(t_host_ns, t_sensor_ns + OFFSET_NS + 50_000), t_sensor_ns)
    assert abs(estimator.offset_ns - settled_ns) < 500_000
    assert estimator.restarts == 0


def test_a_packet_that_arrives_before_it_was_sent_proves_a_jump_forward() -> None:
    estimator = ClockOffsetEstimator()
    run(estimator, 0, 3 * S, np.random.default_rng(4))
    assert estimator.update(3 * S + OFFSET_NS, 4 * S)
    assert estimator.restarts == 1
    assert estimator.offset_ns == OFFSET_NS - S
    assert not estimator.settled


def test_a_declared_restart_starts_anew_unless_the_pair_fits_the_estimate() -> None:
    estimator = ClockOffsetEstimator()
    run(estimator, 0, 3 * S, np.random.default_rng(5))
    assert not estimator.declare_restart(3 * S + OFFSET_NS + MS, 3 * S)
    assert estimator.restarts == 0
    assert estimator.declare_restart(3 * S + OFFSET_NS, 1_000)
    assert estimator.restarts == 1
    assert estimator.offset_ns == 3 * S + OFFSET_NS - 1_000


def test_a_first_packet_that_was_late_is_corrected_within_the_first_second() -> None:
    estimator = ClockOffsetEstimator()
    estimator.update(OFFSET_NS + IMPOSSIBLY_EARLY_NS - MS, 0)
    estimator.update(OFFSET_NS + IMPOSSIBLY_EARLY_NS, PERIOD_NS + IMPOSSIBLY_EARLY_NS - 50_000)
    assert estimator.offset_ns == OFFSET_NS - PERIOD_NS + 50_000
    assert estimator.restarts == 0


def test_equal_inputs_give_equal_offsets() -> None:
    first = run(ClockOffsetEstimator(), 0, 2 * S, np.random.default_rng(6), 20.0)
    assert first == run(ClockOffsetEstimator(), 0, 2 * S, np.random.default_rng(6), 20.0)
