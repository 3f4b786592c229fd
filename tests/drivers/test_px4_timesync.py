"""The autopilot's clock as estimated over a link with delays."""

import numpy as np
import pytest

from companion.drivers.px4_timesync import AutopilotClock
from companion.errors import ProtocolError
from companion.messages import MavlinkMessage

MS = 1_000_000
SECOND = 1_000_000_000
PERIOD = SECOND // 10
OWN = (1, 191)


def timesync(tc1: object, ts1: object) -> MavlinkMessage:
    return MavlinkMessage("TIMESYNC", 1, 1, {"tc1": tc1, "ts1": ts1})


class SlowAutopilot:
    """Answers questions with a clock of its own rate, after random delays each way."""

    def __init__(self, rate: float, start_ns: int, rng: np.random.Generator) -> None:
        self.rate, self.start_ns, self.rng = rate, start_ns, rng

    def time_ns(self, t_ns: int) -> int:
        return self.start_ns + round(t_ns * self.rate)

    def ask(self, clock: AutopilotClock, t_ns: int, *, spike_ns: int = 0) -> bool:
        question = clock.request(t_ns)
        assert question is not None
        there, back = (round(delay) for delay in self.rng.uniform(0.2 * MS, 1.5 * MS, 2))
        answer = timesync(self.time_ns(t_ns + there), question["ts1"])
        reply, started_anew = clock.receive(answer, t_ns + there + back + spike_ns)
        assert reply is None
        return started_anew


@pytest.fixture
def autopilot() -> SlowAutopilot:
    return SlowAutopilot(0.993, 5 * SECOND, np.random.default_rng(4))


def test_a_clock_that_runs_slow_is_followed_within_two_milliseconds(autopilot: SlowAutopilot) -> None:
    clock = AutopilotClock(PERIOD, OWN)
    worst = 0
    for step in range(1200):
        now = SECOND + step * PERIOD
        autopilot.ask(clock, now, spike_ns=40 * MS if step % 7 == 3 else 0)
        for later in (5 * MS + 40 * MS, 95 * MS):
            estimate = clock.autopilot_ns(now + later, now + later)
            assert estimate is not None
            worst = max(worst, abs(estimate - autopilot.time_ns(now + later)))
    assert worst < 2.5 * MS


def test_nothing_is_known_before_the_first_answer() -> None:
    clock = AutopilotClock(PERIOD, OWN)
    assert clock.offset_ns(0) is None
    reply, _ = clock.receive(timesync(0, 123), SECOND)
    assert reply is None


def test_the_autopilots_own_question_is_answered_in_its_own_time(autopilot: SlowAutopilot) -> None:
    clock = AutopilotClock(PERIOD, OWN)
    autopilot.ask(clock, SECOND)
    asked_ns = autopilot.time_ns(SECOND + 10 * MS)
    reply, _ = clock.receive(timesync(0, asked_ns), SECOND + 10 * MS)
    assert reply is not None
    assert reply["ts1"] == asked_ns
    # What PX4 computes: the difference is its whole estimate of our offset.
    assert abs(int(str(reply["tc1"])) - asked_ns) < 1 * MS


def test_questions_are_asked_at_the_rate_and_a_pause_is_not_made_up_for() -> None:
    clock = AutopilotClock(PERIOD, OWN)
    asked = [t for t in range(0, SECOND, 20 * MS) if clock.request(t) is not None]
    assert len(asked) == 10
    later = [t for t in range(5 * SECOND, 6 * SECOND, 20 * MS) if clock.request(t) is not None]
    assert len(later) == 10


@pytest.mark.parametrize("delay_ns", [-1, 101 * MS])
def test_an_answer_from_the_future_or_too_late_is_not_used(delay_ns: int) -> None:
    clock = AutopilotClock(PERIOD, OWN)
    clock.request(SECOND)
    clock.receive(timesync(7 * SECOND, SECOND), SECOND + delay_ns)
    assert clock.offset_ns(SECOND) is None
    assert clock.unmatched == 1


def test_an_answer_to_somebody_elses_question_is_not_used() -> None:
    clock = AutopilotClock(PERIOD, OWN)
    clock.request(SECOND)
    clock.receive(timesync(7 * SECOND, SECOND - 1), SECOND + MS)
    assert clock.offset_ns(SECOND) is None


def test_an_answer_addressed_to_another_companion_is_not_used() -> None:
    clock = AutopilotClock(PERIOD, OWN)
    clock.request(SECOND)
    answer = timesync(7 * SECOND, SECOND)
    answer.fields.update(target_system=1, target_component=195)
    clock.receive(answer, SECOND + MS)
    assert clock.offset_ns(SECOND + MS) is None
    answer.fields.update(target_component=191)
    clock.receive(answer, SECOND + MS)
    assert clock.offset_ns(SECOND + MS) is not None


def test_an_answer_counts_once(autopilot: SlowAutopilot) -> None:
    clock = AutopilotClock(PERIOD, OWN)
    clock.request(SECOND)
    clock.receive(timesync(7 * SECOND, SECOND), SECOND + MS)
    clock.receive(timesync(7 * SECOND, SECOND), SECOND + 2 * MS)
    assert clock.unmatched == 1
    assert clock.round_trip_ns == MS


def test_the_estimate_expires(autopilot: SlowAutopilot) -> None:
    clock = AutopilotClock(PERIOD, OWN)
    autopilot.ask(clock, SECOND)
    assert clock.offset_ns(10 * SECOND) is not None
    assert clock.offset_ns(12 * SECOND) is None


def test_an_autopilot_that_starts_anew_is_noticed_after_three_answers(autopilot: SlowAutopilot) -> None:
    clock = AutopilotClock(PERIOD, OWN)
    for step in range(10):
        assert not autopilot.ask(clock, SECOND + step * PERIOD)
    autopilot.start_ns = -SECOND
    reports = [autopilot.ask(clock, 3 * SECOND + step * PERIOD) for step in range(4)]
    assert reports == [False, False, True, False]
    now = 4 * SECOND
    assert abs((clock.autopilot_ns(now, now) or 0) - autopilot.time_ns(now)) < 10 * MS


def test_a_restart_is_noticed_even_after_a_long_silence(autopilot: SlowAutopilot) -> None:
    clock = AutopilotClock(PERIOD, OWN)
    autopilot.ask(clock, SECOND)
    autopilot.start_ns = -60 * SECOND
    assert [autopilot.ask(clock, 61 * SECOND + step * PERIOD) for step in range(3)] == [False, False, True]


def test_one_forged_answer_moves_nothing_but_is_doubted(autopilot: SlowAutopilot) -> None:
    clock = AutopilotClock(PERIOD, OWN)
    autopilot.ask(clock, SECOND)
    before = clock.offset_ns(SECOND + 50 * MS)
    clock.request(SECOND + PERIOD)
    clock.receive(timesync(2**60, SECOND + PERIOD), SECOND + PERIOD + MS)
    assert clock.offset_ns(SECOND + PERIOD + MS) is None
    assert not autopilot.ask(clock, SECOND + 2 * PERIOD)
    after = clock.offset_ns(SECOND + 2 * PERIOD + 4 * MS)
    assert before is not None
    assert after is not None
    assert abs(after - before) < 5 * MS


@pytest.mark.parametrize("value", [None, "1", 1.5, float("nan"), True, 2**63, -(2**63)])
def test_what_is_no_time_is_refused(value: object) -> None:
    with pytest.raises(ProtocolError):
        AutopilotClock(PERIOD, OWN).receive(timesync(value, 1), 0)
