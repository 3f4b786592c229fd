"""Which sensor events perception sees in a replay, in which order, and when."""

from collections.abc import Sequence
from typing import cast

import numpy as np

from companion.drivers.livox_framing import LivoxReceiver
from companion.geometry import rotation
from companion.logs.records import QueuePlace
from companion.messages import (
    Datagram,
    ExternalOdometry,
    ImuSample,
    Odometry,
    OdometryStatus,
    PerceptionUpdate,
    SensorEvent,
)
from companion.replay import perception
from companion.replay.perception import PerceptionReplay, key_of
from tests.drivers.px4_peer import MS, an_odometry


def sample(index: int) -> ImuSample:
    return ImuSample(index * 5 * MS, index, np.zeros(3), np.zeros(3))


def external(t_ns: int) -> ExternalOdometry:
    return ExternalOdometry(
        t_ns=t_ns,
        t_source_ns=t_ns + 7,
        clock_offset_ns=-7,
        on_lidar_clock=False,
        session=0,
        p_map=np.zeros(3),
        q_map_body=rotation.IDENTITY,
        v_map=np.zeros(3),
        omega_body=np.zeros(3),
        covariance_pose=np.eye(6),
        covariance_velocity=np.eye(3),
        quality=50,
        reset_counter=0,
    )


class SampleReceiver:
    """Makes of every datagram one sample, numbered by its time."""

    def receive(self, datagram: Datagram) -> list[SensorEvent]:
        return [sample(datagram.t_ns // (5 * MS))]


class Bench:
    """A replay whose estimator answers every event with one estimate, and remembers what it saw."""

    def __init__(self) -> None:
        self.seen: list[SensorEvent] = []
        self.told: list[SensorEvent] = []
        receiver = cast(LivoxReceiver, SampleReceiver())
        self.replay = PerceptionReplay(receiver, self._perceive, self.told.append)

    def _perceive(self, event: SensorEvent) -> Sequence[PerceptionUpdate]:
        self.seen.append(event)
        number = event.t_sensor_ns if isinstance(event, ImuSample) else -1
        return [_numbered(event.t_ns, number)]

    def datagrams(self, *indices: int) -> None:
        self.replay.take_datagrams(
            [Datagram(index * 5 * MS, ("127.0.0.2", 1), ("127.0.0.1", 1), b"") for index in indices]
        )

    def until(self, index: int, t_ns: int) -> list[int]:
        found = self.replay.until(("odometry", index), t_ns)
        return [update.t_sensor_ns for update in found if isinstance(update, Odometry)]

    def order(self) -> list[int | str]:
        return [event.t_sensor_ns if isinstance(event, ImuSample) else "external" for event in self.seen]


def _numbered(t_ns: int, number: int) -> Odometry:
    odometry = an_odometry(t_ns, status=OdometryStatus.TRACKING)
    return Odometry(
        **{name: getattr(odometry, name) for name in odometry.__slots__} | {"t_sensor_ns": number}
    )


def test_events_are_worked_on_only_when_their_estimates_are_asked_for() -> None:
    bench = Bench()
    bench.datagrams(0, 1, 2, 3)
    assert [event.t_ns for event in bench.told] == [0, 5 * MS, 10 * MS, 15 * MS]
    assert bench.seen == []
    assert bench.until(1, 100 * MS) == [0, 1]
    assert bench.order() == [0, 1]
    assert [update.t_ns for update in bench.replay.rest()] == [10 * MS, 15 * MS]


def test_a_mark_read_after_the_packets_still_leaves_its_event_out() -> None:
    bench = Bench()
    bench.datagrams(0, 1, 2)
    bench.replay.take_place(QueuePlace(5 * MS, "imu", 1, -1))
    assert bench.until(2, 100 * MS) == [0, 2]
    assert bench.replay.skipped == 1


def test_what_never_comes_stops_at_the_time_at_which_it_was_handled() -> None:
    bench = Bench()
    bench.datagrams(0, 1, 2, 3, 4)
    assert bench.until(77, 12 * MS) == [0, 1, 2]
    assert bench.until(3, 100 * MS) == [3]


def test_estimates_of_another_process_go_where_they_stood_in_the_queue() -> None:
    bench = Bench()
    bench.datagrams(0, 1)
    # It came before the second sample, and was taken into the queue after it.
    early, late = external(4 * MS), external(11 * MS)
    bench.replay.take_external(early)
    bench.replay.take_place(QueuePlace(early.t_ns, "external", early.t_source_ns, 2))
    bench.replay.take_external(late)
    bench.replay.take_place(QueuePlace(late.t_ns, "external", late.t_source_ns, 4))
    bench.datagrams(2, 3)
    list(bench.replay.rest())
    assert bench.order() == [0, 1, "external", 2, "external", 3]


def test_one_that_was_left_out_is_left_out_again_and_takes_no_place() -> None:
    bench = Bench()
    bench.datagrams(0, 1)
    first, second = external(1 * MS), external(2 * MS)
    bench.replay.take_external(first)
    bench.replay.take_place(QueuePlace(first.t_ns, "external", first.t_source_ns, -1))
    bench.replay.take_external(second)
    bench.replay.take_place(QueuePlace(second.t_ns, "external", second.t_source_ns, 1))
    list(bench.replay.rest())
    assert bench.order() == [0, "external", 1]


def test_without_a_place_the_times_decide() -> None:
    bench = Bench()
    bench.datagrams(0, 1)
    bench.replay.take_external(external(4 * MS))
    list(bench.replay.rest())
    assert bench.order() == [0, "external", 1]


def test_one_whose_place_never_comes_is_not_waited_for_at_the_end() -> None:
    bench = Bench()
    bench.datagrams(0)
    lonely = external(1 * MS)
    bench.replay.take_external(lonely)
    bench.replay.take_place(QueuePlace(lonely.t_ns, "external", lonely.t_source_ns, 50))
    assert bench.until(-1, 100 * MS) == [0]
    list(bench.replay.rest())
    assert bench.order() == [0, "external"]


def test_packets_for_which_nobody_asks_do_not_pile_up() -> None:
    bench = Bench()
    bench.datagrams(*range(perception._MAX_WAITING + 50))
    assert len(bench.seen) == 50
    for index in range(perception._MAX_MARKS + 10):
        bench.replay.take_place(QueuePlace(index, "imu", -index - 1, -1))
    assert len(bench.replay._places) == perception._MAX_MARKS


def test_estimates_have_the_same_name_in_both_flights() -> None:
    assert key_of(_numbered(1, 5)) == ("odometry", 5)
