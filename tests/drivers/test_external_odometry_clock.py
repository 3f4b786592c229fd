"""When a message was valid: three kinds of clock, late and repeated stamps, clocks that are set."""

import numpy as np
import pytest

from companion.drivers.external_odometry_clock import SourceClockFollower, StampVerdict
from companion.drivers.external_odometry_settings import ExternalOdometrySettings, SourceClock

MS = 1_000_000
SECOND_NS = 1_000_000_000
START_NS = 500 * SECOND_NS
UNIX_NS = 1_760_000_000 * SECOND_NS
ANEW, ACCEPTED = StampVerdict.BEGUN_ANEW, StampVerdict.ACCEPTED


class Sender:
    """Stamps at 50 Hz on a clock that is ahead of the host's; the host hears of them later."""

    def __init__(self, clock: SourceClock, ahead_ns: int, **settings: float) -> None:
        self.follower = SourceClockFollower(ExternalOdometrySettings(clock=clock, **settings))  # type: ignore[arg-type]
        self.ahead_ns = ahead_ns
        self.t_ns = START_NS

    def send(self, delay_ns: int = 2 * MS, after_ns: int = 20 * MS) -> StampVerdict:
        """Send the next message; return what is thought of its stamp."""
        self.t_ns += after_ns
        return self.follower.judge(self.t_ns + delay_ns, (self.t_ns + self.ahead_ns) // 1000)

    def error_ms(self) -> float:
        """Return how far the host's idea of the newest stamp's time is off."""
        return (self.t_ns + self.ahead_ns + self.follower.offset_ns - self.t_ns) / MS


@pytest.mark.parametrize("ahead_ns", [UNIX_NS - START_NS, 5 * SECOND_NS - START_NS, 0])
def test_the_offset_of_any_clock_is_that_of_the_least_delayed_message(ahead_ns: int) -> None:
    rng = np.random.default_rng(3)
    sender = Sender("estimated", ahead_ns)
    verdicts = {sender.send(2 * MS + int(rng.exponential(5 * MS))) for _ in range(300)}
    assert verdicts == {ANEW, ACCEPTED}
    assert 1.9 < sender.error_ms() < 3.0


def test_a_known_least_delay_is_taken_off() -> None:
    sender = Sender("estimated", UNIX_NS, min_delay_ms=30.0)
    for _ in range(100):
        sender.send(30 * MS)
    assert abs(sender.error_ms()) < 0.1


def test_the_hosts_own_clock_needs_no_estimate() -> None:
    sender = Sender("host_monotonic", 0)
    assert sender.send(35 * MS) is ANEW
    assert sender.send(35 * MS) is ACCEPTED
    assert sender.error_ms() == 0.0


def test_a_stamp_beyond_the_hosts_present_is_refused_on_the_hosts_clock() -> None:
    sender = Sender("host_monotonic", SECOND_NS)
    assert {sender.send() for _ in range(20)} == {StampVerdict.FUTURE}


@pytest.mark.parametrize("clock", ["estimated", "host_monotonic"])
def test_a_message_that_was_long_on_its_way_is_late(clock: SourceClock) -> None:
    sender = Sender(clock, 0)
    for _ in range(100):
        sender.send()
    assert sender.send(450 * MS, 20 * MS) is StampVerdict.LATE
    assert sender.send(2 * MS, 500 * MS) is ACCEPTED


def test_a_growing_queue_is_never_taken_for_a_clock_that_was_set() -> None:
    sender = Sender("estimated", UNIX_NS)
    for _ in range(100):
        sender.send()
    verdicts = [sender.send(delay_ns) for delay_ns in range(2 * MS, 3000 * MS, 20 * MS)]
    assert verdicts[0] is ACCEPTED
    assert set(verdicts[30:]) == {StampVerdict.LATE}
    assert abs(sender.error_ms()) < 5.0


def test_repeated_and_old_stamps_are_refused() -> None:
    sender = Sender("estimated", UNIX_NS)
    for _ in range(100):
        sender.send()
    assert sender.send(22 * MS, 0) is StampVerdict.REPEATED
    assert sender.send(42 * MS, -20 * MS) is StampVerdict.OUT_OF_ORDER
    assert sender.send(2 * MS, 40 * MS) is ACCEPTED


def test_stamps_closer_than_the_rate_allows_are_refused() -> None:
    sender = Sender("estimated", 0, max_rate_hz=100.0)
    sender.send()
    assert sender.send(2 * MS, 3 * MS) is StampVerdict.TOO_OFTEN
    assert sender.send(2 * MS, 3 * MS) is ACCEPTED


@pytest.mark.parametrize("jump_ns", [-400 * SECOND_NS, 3 * SECOND_NS, 400 * SECOND_NS])
def test_a_clock_that_was_set_is_believed_after_five_messages(jump_ns: int) -> None:
    sender = Sender("estimated", UNIX_NS)
    for _ in range(100):
        sender.send()
    sender.ahead_ns += jump_ns
    odd = StampVerdict.OUT_OF_ORDER if jump_ns < 0 else StampVerdict.FUTURE
    assert [sender.send() for _ in range(6)] == [odd, odd, odd, odd, ANEW, ACCEPTED]
    assert 1.9 < sender.error_ms() < 3.0


def test_one_odd_stamp_changes_nothing() -> None:
    sender = Sender("estimated", UNIX_NS)
    for _ in range(100):
        sender.send()
    for _ in range(20):
        sender.ahead_ns += SECOND_NS
        assert sender.send() is StampVerdict.FUTURE
        sender.ahead_ns -= SECOND_NS
        assert sender.send() is ACCEPTED


def test_a_first_message_that_was_late_does_not_spoil_the_clock() -> None:
    sender = Sender("estimated", UNIX_NS)
    assert sender.send(200 * MS) is ANEW
    assert sender.send(2 * MS, 220 * MS) is ANEW
    assert sender.send() is ACCEPTED
    assert 1.9 < sender.error_ms() < 3.0
