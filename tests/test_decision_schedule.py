"""Regular decisions and those that answer a scan."""

from companion.decision_schedule import DecisionSchedule

PERIOD_NS = 20


def test_decisions_are_due_at_a_steady_rate_even_when_each_comes_a_little_late() -> None:
    schedule = DecisionSchedule(PERIOD_NS, 100)
    made = []
    for t_ns in range(100, 200):
        if schedule.due(t_ns - 3):  # three late each time
            made.append(t_ns)
            schedule.decided(t_ns)
    assert made == [103, 123, 143, 163, 183]


def test_missed_decisions_are_not_made_up_for_in_a_burst() -> None:
    schedule = DecisionSchedule(PERIOD_NS, 100)
    schedule.decided(175)
    assert not schedule.due(194)
    assert schedule.due(195)


def test_regular_decisions_fall_in_step_with_the_one_that_answered_a_scan() -> None:
    schedule = DecisionSchedule(PERIOD_NS, 100)
    schedule.decided(100)
    schedule.seen(107)
    assert not schedule.due(126)
    assert schedule.due(127)
