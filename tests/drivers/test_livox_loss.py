import numpy as np
import pytest

from companion.drivers.livox_loss import Arrival, LossAccount

PERIOD_NS = 480_000
T0_NS = 100_000_000_000


def fed(indices: list[int], account: LossAccount | None = None) -> tuple[LossAccount, list[Arrival]]:
    """Feed packets by their index; the counter starts near its wrap."""
    account = account or LossAccount(PERIOD_NS)
    arrivals = [account.observe((65_530 + index) & 0xFFFF, T0_NS + index * PERIOD_NS, 0) for index in indices]
    return account, arrivals


def test_an_unbroken_stream_across_the_counters_wrap_loses_nothing() -> None:
    account, arrivals = fed(list(range(100_000)))
    assert set(arrivals) == {Arrival.IN_ORDER}
    assert (account.received, account.lost, account.jumps, account.outages) == (100_000, 0, 0, 0)


@pytest.mark.parametrize("gap", [1, 7, 1_000, 5_000, 70_000])
def test_a_gap_is_counted_exactly_even_beyond_the_counters_range(gap: int) -> None:
    account, _ = fed([0, 1, 2, 3 + gap, 4 + gap])
    assert account.lost == gap
    assert account.outages == (gap > 1_041)


def test_a_duplicate_packet_is_counted_and_named() -> None:
    account, arrivals = fed([0, 1, 1, 2, 0, 3])
    assert arrivals[2] is arrivals[4] is Arrival.DUPLICATE
    assert (account.duplicates, account.received, account.lost) == (2, 4, 0)


def test_a_late_packet_is_no_longer_lost() -> None:
    account, arrivals = fed([0, 1, 4, 2, 3, 5])
    assert arrivals[3] is arrivals[4] is Arrival.LATE
    assert (account.reordered, account.lost, account.received) == (2, 0, 6)


def test_losses_of_a_random_stream_are_counted_exactly() -> None:
    rng = np.random.default_rng(1)
    kept = np.flatnonzero(rng.random(30_000) > 0.2)
    account, _ = fed([0, *kept[kept > 0].tolist()])
    assert account.lost == kept[-1] + 1 - account.received
    assert account.jumps == 0


def test_time_going_back_while_the_counter_goes_on_is_a_jump() -> None:
    account, _ = fed(list(range(10)))
    step_back_ns = 100_000_000
    arrival = account.observe((65_530 + 10) & 0xFFFF, T0_NS + 10 * PERIOD_NS - step_back_ns, 0)
    assert arrival is Arrival.JUMP
    assert (account.jumps, account.lost) == (1, 0)


def test_a_restart_from_zero_is_a_jump() -> None:
    account, _ = fed(list(range(10)))
    assert account.observe(0, 1_000_000, 0) is Arrival.JUMP
    assert account.observe(1, 1_480_000, 0) is Arrival.IN_ORDER
    assert account.lost == 0


def test_a_known_restart_of_the_clock_is_a_jump_and_no_loss() -> None:
    account, _ = fed(list(range(10)))
    arrival = account.observe((65_530 + 10) & 0xFFFF, T0_NS + 10 * PERIOD_NS + 1_000_000_000, 1)
    assert arrival is Arrival.JUMP
    assert (account.jumps, account.lost, account.outages) == (1, 0, 0)


def test_a_sender_that_stops_its_counter_is_found_out_by_its_stamps() -> None:
    account = LossAccount(PERIOD_NS)
    account.observe(5, T0_NS, 0)
    account.observe(6, T0_NS + 11 * PERIOD_NS, 0)
    assert account.lost == 10


def test_a_restarted_counter_with_stamps_ahead_is_a_jump_only_if_the_packet_does_not_fit_the_clock() -> None:
    account, _ = fed(list(range(10)))
    assert account.observe(7_000, T0_NS + 12 * PERIOD_NS, 0, lateness_ns=1_000) is Arrival.IN_ORDER
    assert account.lost == 2
    assert account.observe(0, T0_NS + 20 * PERIOD_NS, 0, lateness_ns=900_000_000) is Arrival.JUMP
    assert (account.lost, account.jumps) == (2, 1)
    # A long outage leaves the counter where its stamps say, so it is a loss however late the packet is.
    gap = 5_000
    assert account.observe(gap + 1, T0_NS + (21 + gap) * PERIOD_NS, 0, 900_000_000) is Arrival.IN_ORDER
    assert account.lost == 2 + gap
