"""The emulated cable loses, doubles and delays as much as it is told to, and the same each time."""

from collections import Counter

import numpy as np
import pytest

from companion.messages import Datagram
from sitl.network import Network, NetworkSettings

LIDAR, HOST = ("127.0.0.2", 56300), ("127.0.0.1", 56301)
MS = 1_000_000
PERIOD_NS = 480_000
COUNT = 20_000
FOREVER_NS = 10**18


def sent(count: int = COUNT) -> list[Datagram]:
    return [Datagram(i * PERIOD_NS, LIDAR, HOST, i.to_bytes(4, "little")) for i in range(count)]


def network(*, seed: int = 1, start_ns: int = 0, **faults: float) -> Network:
    return Network(NetworkSettings.model_validate(faults), np.random.default_rng(seed), start_ns)


def arrivals(through: Network, datagrams: list[Datagram]) -> list[Datagram]:
    for datagram in datagrams:
        through.send(datagram)
    return through.deliver(FOREVER_NS)


def index_of(datagram: Datagram) -> int:
    return int.from_bytes(datagram.payload, "little")


def test_a_perfect_cable_changes_nothing_but_the_time() -> None:
    arrived = arrivals(network(latency_ms=3.0, jitter_ms=0.0), sent(500))
    assert arrived == [Datagram(d.t_ns + 3 * MS, LIDAR, HOST, d.payload) for d in sent(500)]


@pytest.mark.parametrize("loss", [0.05, 0.5])
def test_the_share_that_is_lost_is_the_share_asked_for(loss: float) -> None:
    arrived = arrivals(network(loss=loss), sent())
    assert len(arrived) / COUNT == pytest.approx(1.0 - loss, abs=0.015)
    assert max(Counter(map(index_of, arrived)).values()) == 1


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_of_what_arrives_the_share_asked_for_arrives_twice(loss: float) -> None:
    copies = Counter(map(index_of, arrivals(network(loss=loss, duplication=0.2), sent())))
    assert set(copies.values()) == {1, 2}
    assert sum(count == 2 for count in copies.values()) / len(copies) == pytest.approx(0.2, abs=0.015)
    assert len(copies) / COUNT == pytest.approx(1.0 - loss, abs=0.015)


def test_everything_may_be_lost_or_doubled() -> None:
    assert arrivals(network(loss=1.0), sent(100)) == []
    assert len(arrivals(network(duplication=1.0), sent(100))) == 200


def test_delays_fill_the_range_between_latency_and_latency_plus_jitter() -> None:
    arrived = arrivals(network(latency_ms=2.0, jitter_ms=5.0), sent())
    delays_ms = np.array([d.t_ns - index_of(d) * PERIOD_NS for d in arrived]) / MS
    assert 2.0 <= delays_ms.min() < 2.01
    assert 6.99 < delays_ms.max() <= 7.0
    assert delays_ms.mean() == pytest.approx(4.5, abs=0.05)


def test_a_doubled_datagram_takes_two_ways_of_different_length() -> None:
    through = network(duplication=1.0, jitter_ms=5.0)
    pairs = [through.carry(datagram) for datagram in sent(200)]
    assert all(len(pair) == 2 and pair[0].t_ns != pair[1].t_ns for pair in pairs)


def test_datagrams_overtake_each_other_and_are_delivered_in_the_order_of_arrival() -> None:
    arrived = arrivals(network(jitter_ms=5.0), sent(2_000))
    times = [datagram.t_ns for datagram in arrived]
    assert times == sorted(times)
    order = [index_of(datagram) for datagram in arrived]
    assert order != sorted(order)
    assert sorted(order) == list(range(2_000))


def test_nothing_is_delivered_before_it_arrives_and_nothing_twice() -> None:
    through = network(latency_ms=10.0, jitter_ms=0.0)
    first, second = sent(2)
    through.send(first)
    through.send(second)
    assert through.deliver(first.t_ns + 10 * MS - 1) == []
    assert [d.payload for d in through.deliver(first.t_ns + 10 * MS)] == [first.payload]
    assert [d.payload for d in through.deliver(FOREVER_NS)] == [second.payload]
    assert through.deliver(FOREVER_NS) == []


def test_datagrams_that_arrive_together_keep_the_order_of_sending() -> None:
    together = [Datagram(0, LIDAR, HOST, bytes([i])) for i in range(20)]
    arrived = arrivals(network(latency_ms=1.0, jitter_ms=0.0), together)
    assert [d.payload for d in arrived] == [d.payload for d in together]


def test_an_outage_swallows_exactly_what_is_sent_during_it() -> None:
    start_ns = 7_000 * MS
    datagrams = [Datagram(start_ns + i * 100 * MS, LIDAR, HOST, i.to_bytes(4, "little")) for i in range(30)]
    through = network(start_ns=start_ns, outage_at_s=1.0, outage_s=0.5)
    assert [index_of(d) for d in arrivals(through, datagrams)] == [*range(10), *range(15, 30)]


def test_an_outage_of_no_length_swallows_nothing() -> None:
    assert len(arrivals(network(outage_at_s=0.0, outage_s=0.0), sent(10))) == 10


def test_equal_generators_give_equal_fates_and_others_others() -> None:
    def fates(seed: int) -> list[Datagram]:
        return arrivals(network(seed=seed, loss=0.3, duplication=0.3, jitter_ms=4.0), sent(5_000))

    assert fates(5) == fates(5)
    assert fates(5) != fates(6)


def test_carrying_and_sending_decide_the_same_fate() -> None:
    def cable() -> Network:
        return network(loss=0.2, duplication=0.2, jitter_ms=4.0, outage_at_s=0.5, outage_s=0.1)

    by_sending = arrivals(cable(), sent(5_000))
    carrier = cable()
    carried = [copy for datagram in sent(5_000) for copy in carrier.carry(datagram)]
    assert sorted(carried, key=lambda copy: copy.t_ns) == by_sending
