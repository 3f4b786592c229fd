"""What leaves for the autopilot and what must not: setpoints, odometry, texts."""

import math

import numpy as np
import pytest

from companion.drivers.mavlink_codec import MavlinkEncoder, MavlinkParser
from companion.drivers.px4_session import Px4Session
from companion.messages import (
    OdometryStatus,
    Severity,
    StatusText,
)
from tests.drivers.px4_peer import (
    MS,
    SECOND,
    T0,
    a_setpoint,
    an_odometry,
    answer_clock,
    connected,
    heartbeat,
    settings,
)


def test_a_fresh_setpoint_leaves() -> None:
    session = connected()
    sent = session.setpoint(a_setpoint(T0), T0 + 10 * MS)
    assert sent is not None
    assert sent.name == "SET_POSITION_TARGET_LOCAL_NED"
    assert sent.fields["time_boot_ms"] == 5010
    assert session.statistics(T0).sent == {"setpoint": 1}


@pytest.mark.parametrize(("age_ms", "leaves"), [(0, True), (200, True), (201, False), (-51, False)])
def test_old_data_moves_nothing(age_ms: int, leaves: bool) -> None:
    session = connected()
    setpoint = a_setpoint(T0)
    assert (session.setpoint(setpoint, T0 + age_ms * MS) is not None) is leaves


def test_standing_still_needs_no_fresh_data_but_a_fresh_decision() -> None:
    session = connected()
    now = T0 + SECOND
    still = a_setpoint(now, (0.0, 0.0, 0.0), 0.0)
    brake = type(still)(now, T0, 0, still.v_map, 0.0, "hold: odometry stale")
    assert session.setpoint(brake, now) is not None
    turning = type(still)(now, T0, 0, still.v_map, 0.1, "turn")
    assert session.setpoint(turning, now) is None
    assert session.setpoint(brake, now + 201 * MS) is None
    assert session.statistics(now).refused == {"setpoint on stale data": 1, "setpoint stale": 1}


def test_a_setpoint_that_is_not_finite_is_counted() -> None:
    session = connected()
    assert session.setpoint(a_setpoint(T0, (math.nan, 0.0, 0.0)), T0) is None
    assert session.statistics(T0).refused == {"setpoint not finite": 1}


def test_no_setpoint_goes_to_an_autopilot_that_is_not_heard() -> None:
    session = Px4Session(settings())
    assert session.setpoint(a_setpoint(T0), T0) is None
    assert session.statistics(T0).refused == {"setpoint not connected": 1}


def test_odometry_carries_the_autopilots_time() -> None:
    session = connected(autopilot_ns=5 * SECOND)
    sent = session.odometry(an_odometry(T0 + 100 * MS), T0 + 140 * MS)
    assert sent is not None
    assert sent.fields["time_usec"] == 5_100_000
    (read,) = MavlinkParser().feed(MavlinkEncoder().encode(sent))
    assert read.fields["x"] == 1.0


def test_odometry_waits_for_the_autopilots_clock() -> None:
    session = Px4Session(settings())
    session.receive(heartbeat(), T0)
    assert session.odometry(an_odometry(T0), T0) is None
    answer_clock(session, T0, 5 * SECOND)
    assert session.odometry(an_odometry(T0), T0) is not None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"status": OdometryStatus.LOST}, "lost"),
        ({"status": OdometryStatus.INITIALISING}, "initialising"),
        ({"quality": 9}, "poor"),
        ({"t_ns": T0 - 201 * MS}, "stale"),
        ({"t_ns": T0 + 51 * MS}, "stale"),
        ({"p_map": np.array([np.nan, 0.0, 0.0])}, "not finite"),
    ],
)
def test_odometry_that_is_not_to_be_trusted_is_not_sent(changes: dict[str, object], reason: str) -> None:
    session = connected()
    assert session.odometry(an_odometry(**{"t_ns": T0, **changes}), T0) is None  # type: ignore[arg-type]
    assert session.statistics(T0).refused == {f"odometry {reason}": 1}


def test_degraded_odometry_is_sent_with_its_quality() -> None:
    sent = connected().odometry(an_odometry(T0, status=OdometryStatus.DEGRADED, quality=30), T0)
    assert sent is not None
    assert sent.fields["quality"] == 30


@pytest.mark.parametrize(("source_hz", "expected"), [(200, 50), (50, 50), (40, 40)])
def test_odometry_leaves_at_its_rate_and_no_faster(source_hz: int, expected: int) -> None:
    session = connected()
    sent = 0
    for step in range(source_hz * 2):
        t = T0 + step * SECOND // source_hz
        sent += session.odometry(an_odometry(t), t) is not None
    assert abs(sent - 2 * expected) <= 2


def test_a_jump_of_the_map_is_never_thinned_out() -> None:
    session = connected()
    assert session.odometry(an_odometry(T0), T0) is not None
    assert session.odometry(an_odometry(T0 + MS), T0 + MS) is None
    sent = session.odometry(an_odometry(T0 + 2 * MS, reset_counter=1), T0 + 2 * MS)
    assert sent is not None


def test_odometry_never_goes_back_in_time() -> None:
    session = connected()
    assert session.odometry(an_odometry(T0), T0) is not None
    assert session.odometry(an_odometry(T0), T0 + 40 * MS) is None


def test_texts_are_limited_in_rate_and_repetition() -> None:
    session = connected()
    sent = [session.status_text(StatusText(T0 + i, Severity.INFO, f"line {i}")) for i in range(20)]
    assert sum(map(len, sent)) == 8
    assert session.status_text(StatusText(T0 + 2 * SECOND, Severity.INFO, "line 0")) == []
    assert len(session.status_text(StatusText(T0 + 2 * SECOND, Severity.INFO, "other"))) == 1
    assert len(session.status_text(StatusText(T0 + 6 * SECOND, Severity.INFO, "line 0"))) == 1
