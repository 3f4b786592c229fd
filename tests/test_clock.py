"""Clocks never go back."""

import asyncio

import pytest

from companion.clock import StepClock, SystemClock, ns_to_seconds, seconds_to_ns


def test_simulated_time_moves_only_when_told_to() -> None:
    clock = StepClock(5)
    assert clock.now_ns() == clock.now_ns() == 5
    clock.advance_to(9)
    assert clock.now_ns() == 9


def test_simulated_time_refuses_to_go_back() -> None:
    clock = StepClock(5)
    with pytest.raises(ValueError, match="cannot go back"):
        clock.advance_to(4)


def test_seconds_and_nanoseconds_convert_both_ways() -> None:
    assert seconds_to_ns(0.02) == 20_000_000
    assert ns_to_seconds(1_500_000_000) == 1.5


def test_sleeping_until_a_time_does_not_end_early() -> None:
    clock = SystemClock()
    target_ns = clock.now_ns() + 20_000_000
    asyncio.run(clock.sleep_until(target_ns))
    assert clock.now_ns() >= target_ns
