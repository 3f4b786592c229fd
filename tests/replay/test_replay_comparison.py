"""Recorded against replayed messages: what is equal, different, missing, extra, and first."""

import numpy as np
import pytest

from companion.logs import channels
from companion.logs.codec import codec_of
from companion.logs.reader import EncodedEntry
from companion.messages import FlightState, MavlinkMessage, Odometry, Setpoint, StateChange, Tick
from companion.replay import comparison
from companion.replay.comparison import ChannelResult, Ends, NamedComparison, SentComparison
from companion.replay.difference import first_difference
from companion.replay.holes import Holes
from tests.drivers.px4_peer import an_odometry

ALL = Ends()


def entry(channel: channels.Channel, message: object, t_ns: int, sequence: int = 0) -> EncodedEntry:
    return EncodedEntry(channel, t_ns, sequence, codec_of(channel).encode(message))


def setpoint(t_ns: int, vx: float = 1.0) -> Setpoint:
    return Setpoint(t_ns, t_ns, 0, np.array([vx, 0.0, 0.0]), 0.0, "role")


def compared(recorded: list[Setpoint], replayed: list[Setpoint], ends: Ends = ALL) -> ChannelResult:
    found = NamedComparison(channels.SETPOINT)
    for message in recorded:
        found.take_recorded(entry(channels.SETPOINT, message, message.t_ns))
    for message in replayed:
        found.take_replayed(message, message.t_ns)
    return found.finish(ends)


def counts(result: ChannelResult) -> tuple[int, int, int, int, int]:
    return result.equal, result.different, result.missing, result.extra, result.cut_off


class TestNamed:
    def test_one_message_too_few_or_too_many_does_not_shift_the_others(self) -> None:
        recorded = [setpoint(t) for t in (10, 20, 30, 40)]
        replayed = [setpoint(t) for t in (10, 25, 30, 40)]
        result = compared(recorded, replayed)
        assert counts(result) == (3, 0, 1, 1, 0)
        assert result.first is not None
        assert (result.first.t_ns, result.first.replayed) == (20, "")

    def test_the_first_difference_is_the_earliest_whichever_comes_first(self) -> None:
        result = compared(
            [setpoint(30), setpoint(10), setpoint(20)],
            [setpoint(30, 2.0), setpoint(20, 3.0), setpoint(10)],
        )
        assert counts(result) == (1, 2, 0, 0, 0)
        assert result.first is not None
        assert (result.first.t_ns, result.first.field) == (20, "v_map[0]")
        assert (result.first.recorded, result.first.replayed) == ("1.0", "3.0")

    def test_the_last_bit_counts_and_the_sign_of_zero_too(self) -> None:
        assert compared([setpoint(1, 0.1)], [setpoint(1, np.nextafter(0.1, 1.0))]).different == 1
        assert compared([setpoint(1, 0.0)], [setpoint(1, -0.0)]).different == 1
        assert compared([setpoint(1, np.nan)], [setpoint(1, np.nan)]).equal == 1

    def test_messages_of_one_time_are_paired_in_their_order(self) -> None:
        result = compared([setpoint(1, 1.0), setpoint(1, 2.0)], [setpoint(1, 1.0), setpoint(1, 2.0)])
        assert counts(result) == (2, 0, 0, 0, 0)
        assert result.agrees

    def test_what_stands_alone_where_the_recording_ends_was_cut_off(self) -> None:
        recorded, replayed = [setpoint(1), setpoint(9)], [setpoint(1), setpoint(7), setpoint(8)]
        assert counts(compared(recorded, replayed, Ends(9, 8))) == (1, 0, 0, 1, 2)

    def test_estimates_are_paired_by_their_instant_not_by_their_handling(self) -> None:
        pairs: list[tuple[object, object]] = []
        found = NamedComparison(
            channels.ODOMETRY,
            lambda message: message.t_sensor_ns if isinstance(message, Odometry) else 0,
            lambda one, other: pairs.append((one, other)),
        )
        found.take_recorded(entry(channels.ODOMETRY, an_odometry(5), 100))
        found.take_replayed(an_odometry(5), 200)
        assert found.finish(ALL).equal == 1
        assert pairs == []

    def test_a_message_that_cannot_be_read_is_a_difference(self) -> None:
        found = NamedComparison(channels.SETPOINT)
        found.take_recorded(EncodedEntry(channels.SETPOINT, 5, 0, b"{"))
        found.take_replayed(setpoint(5), 5)
        assert found.finish(ALL).different == 1

    def test_neither_side_piles_up(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(comparison, "_MAX_AHEAD", 10)
        result = compared([setpoint(t) for t in range(15)], [])
        assert result.missing == 15
        found = NamedComparison(channels.TICK)
        for t_ns in range(15):
            found.take_replayed(Tick(t_ns), t_ns)
        assert found.finish(ALL).extra == 15


def message(name: str, value: int) -> MavlinkMessage:
    return MavlinkMessage(name, 1, 191, {"value": value})


class TestSent:
    def recorded(self, found: SentComparison, *messages: MavlinkMessage) -> None:
        for index, sent in enumerate(messages):
            found.take_recorded(entry(channels.MAVLINK_TX, sent, 1000 + index))

    def replayed(self, found: SentComparison, *messages: MavlinkMessage) -> None:
        for index, decided in enumerate(messages):
            found.take_replayed(decided, 900 + index)

    def test_messages_leave_later_and_in_their_order(self) -> None:
        found = SentComparison(channels.MAVLINK_TX)
        self.replayed(found, message("A", 1), message("B", 1), message("A", 2))
        self.recorded(found, message("A", 1), message("B", 1), message("A", 2))
        assert counts(found.finish(ALL)) == (3, 0, 0, 0, 0)

    def test_another_order_is_a_difference(self) -> None:
        found = SentComparison(channels.MAVLINK_TX)
        self.replayed(found, message("A", 1), message("B", 1))
        self.recorded(found, message("B", 1), message("A", 1))
        result = found.finish(ALL)
        assert (result.equal, result.different) == (1, 1)
        assert result.first is not None
        assert result.first.field == "left in another order"

    def test_what_never_left_is_known_by_its_number(self) -> None:
        found = SentComparison(channels.MAVLINK_TX)
        self.replayed(found, *(message("A", value) for value in range(6)))
        found.take_unsent(1, 2)
        self.recorded(found, message("A", 0), message("A", 3), message("A", 4))
        # The last one was still waiting when the flight ended.
        assert counts(found.finish(ALL)) == (3, 0, 0, 0, 1)

    def test_a_message_nobody_decided_on_is_missing_and_one_that_was_left_out_is_extra(self) -> None:
        found = SentComparison(channels.MAVLINK_TX)
        self.replayed(found, message("A", 1), message("B", 1))
        self.recorded(found, message("C", 1), message("B", 1))
        assert counts(found.finish(ALL)) == (1, 0, 1, 1, 0)

    def test_a_damaged_count_costs_nothing(self) -> None:
        found = SentComparison(channels.MAVLINK_TX)
        found.take_unsent(0, 2**62)
        self.replayed(found, message("A", 1))
        self.recorded(found, message("A", 1))
        assert found.finish(ALL).equal == 1


class TestDifference:
    def test_it_is_named_by_its_path(self) -> None:
        found = first_difference(7, message("A", 1), MavlinkMessage("A", 1, 191, {"value": 1, "more": [1]}))
        assert (found.field, found.recorded, found.replayed) == ("fields.more", "null", "[1]")
        found = first_difference(
            7,
            StateChange(7, FlightState.READY, FlightState.ACTIVE, "x"),
            StateChange(7, FlightState.READY, FlightState.HOLDING, "x"),
        )
        assert (found.field, found.recorded, found.replayed) == ("current", "active", "holding")

    def test_long_values_are_cut(self) -> None:
        found = first_difference(
            7,
            StateChange(7, FlightState.READY, FlightState.ACTIVE, "a" * 500),
            StateChange(7, FlightState.READY, FlightState.ACTIVE, "b" * 500),
        )
        assert len(found.recorded) == len(found.replayed) == 60


class TestHoles:
    def test_a_gap_explains_what_differs_after_it_and_nothing_before(self) -> None:
        holes = Holes()
        holes.observe(entry(channels.MAVLINK_RX, message("A", 1), 100, 0))
        holes.observe(entry(channels.MAVLINK_RX, message("A", 1), 300, 2))
        assert holes.missing == {"/mavlink/rx": 1}
        early = compared([setpoint(50)], [setpoint(50, 2.0)])
        late = compared([setpoint(150)], [setpoint(150, 2.0)])
        assert not holes.explain(early)
        assert holes.explain(late)

    def test_lost_telemetry_explains_nothing_about_perception(self) -> None:
        holes = Holes()
        holes.observe(entry(channels.MAVLINK_RX, message("A", 1), 100, 5))
        found = NamedComparison(channels.ODOMETRY)
        found.take_replayed(an_odometry(500), 500)
        assert not holes.explain(found.finish(ALL))

    def test_a_message_that_the_log_lost_is_extra_in_the_replay(self) -> None:
        holes = Holes()
        holes.observe(entry(channels.SETPOINT, setpoint(1), 1, 0))
        holes.observe(entry(channels.SETPOINT, setpoint(3), 3, 2))
        assert holes.explain(compared([setpoint(1), setpoint(3)], [setpoint(t) for t in (1, 2, 3)]))
        assert not holes.explain(compared([setpoint(1)], [setpoint(t) for t in (1, 2, 3)]))
