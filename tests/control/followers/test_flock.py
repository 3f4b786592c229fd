import numpy as np
import pytest

from companion.control.followers.settings import FollowerSettings, gains_of, with_gains
from tests.control.followers.flock_oracle import Flock
from tests.control.followers.oracles import Shared
from tests.control.followers.situations import Follower, column, drawn, free, others, own


@pytest.mark.parametrize("seed", range(8))
def test_it_agrees_with_its_oracle_on_random_flights_with_random_gains(seed: int) -> None:
    """Neighbours come and go and change their numbers; obstacles jump; the vehicle turns."""
    rng = np.random.default_rng(seed)
    gains = {
        gain.name: float(rng.uniform(max(gain.low, 0.5 * gain.default), 1.5 * max(gain.default, 0.05)))
        for gain in gains_of("flock")
    }
    gains["top_weight"] = float(rng.uniform(0.0, 1.0))
    settings = with_gains(FollowerSettings(), "flock", gains)
    follower, oracle, shared = (
        Follower("flock", settings),
        Flock(settings.flock, settings.command),
        Shared(settings.command),
    )
    p, yaw = np.array([3.0, -2.0, 1.5]), 0.3
    for step in range(60):
        ego, neighbours, ranges = drawn(rng)
        p[:2] += rng.normal(0.0, 0.05, 2)
        p[2] += rng.normal(0.0, 0.02)
        yaw += rng.normal(0.0, 0.02)
        ego[:3], ego[6], ego[7] = p, yaw, p[2]
        neighbours[:, 7] = rng.permutation(6) + 6.0 * (step // 20)
        if step % 7 == 3:
            neighbours[:] = 0.0
        expected = shared.finish(ego, oracle(ego, neighbours, ranges))
        assert follower.steer(ego, neighbours, ranges) == pytest.approx(expected, abs=1e-7), step


def test_it_flies_along_with_neighbours_that_fly() -> None:
    marching = others((1.4, 0.0, 0.0, 0.0, 0.0, 0.0), (-1.4, 0.0, 0.0, 0.0, 0.0, 0.0))
    v = Follower("flock").settle(own(v=(1.0, 0.5, 0.0)), marching)
    share = FollowerSettings().flock.feed_forward
    assert v[:2] == pytest.approx([share * 1.0, share * 0.5], abs=1e-6)


def test_the_one_that_flies_away_weighs_more_than_those_left_behind() -> None:
    """One of four neighbours leaves at 1.5 m/s: it is followed with far more than a quarter of its speed."""
    rest = [(-2.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, -2.0, 0.0)]
    leaving = Follower("flock").settle(own(), others((2.0, 0.0, 0.0, 1.5, 0.0, 0.0), *rest))
    coming = Follower("flock").settle(own(), others((2.0, 0.0, 0.0, -0.5, 0.0, 0.0), *rest))
    assert leaving[0] > 0.75
    assert coming[0] < 0.0


def test_everybody_left_behind_alike_does_not_turn_it_round() -> None:
    """Neighbours that stand behind recede as well, but by the own flight."""
    v_own = np.array([1.0, 0.0, 0.0])
    standing = others(
        (-2.5, 0.5, 0.0, -1.0, 0.0, 0.0), (-2.5, -0.5, 0.0, -1.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.5, 0.0, 0.0)
    )
    v = Follower("flock").settle(own(v=tuple(v_own)), standing)
    assert v[0] > 0.3


@pytest.mark.parametrize("side", [0.4, -0.4])
def test_it_steps_out_of_the_way_of_one_that_comes_at_it(side: float) -> None:
    settings = with_gains(
        FollowerSettings(), "flock", {"dodge_mps": 2.0, "dodge_time_s": 2.0, "dodge_room_m": 1.2}
    )
    v = Follower("flock", settings).settle(own(), others((2.0, side, 0.0, -1.5, 0.0, 0.0)))
    assert v[1] * side < 0.0


def test_two_that_meet_head_on_pass_on_the_same_hand() -> None:
    settings = with_gains(FollowerSettings(), "flock", {"dodge_mps": 2.0, "dodge_full_mps": 1.0})
    v = Follower("flock", settings).settle(own(v=(0.7, 0.0, 0.0)), others((2.5, 0.0, 0.0, -1.4, 0.0, 0.0)))
    w = Follower("flock", settings).settle(
        own(v=(0.7, 0.0, 0.0), yaw=np.pi), others((2.5, 0.0, 0.0, -1.4, 0.0, 0.0))
    )
    assert abs(v[1]) > 0.05
    assert w == pytest.approx(v)


def sideways(follower: Follower, first_mps: float, per_s: float, steps: int) -> float:
    """Return how fast it gives way at last, flying at 1 m/s behind one whose speed changes."""
    for step in range(steps):
        ahead = others((1.6, 0.0, 0.0, first_mps - 1.0 + 0.05 * step * per_s, 0.0, 0.0))
        v = follower.steer(own(v=(1.0, 0.0, 0.0)), ahead)
    return float(abs(v[1]))


def test_it_gives_way_to_one_that_turns_back_before_that_one_comes() -> None:
    """It still flies on at 0.1 m/s, but brakes so hard that it will soon come."""
    unforeseen = with_gains(FollowerSettings(), "flock", {"foresight_s": 0.0})
    assert sideways(Follower("flock"), 1.0, -1.5, 13) > 0.3
    assert sideways(Follower("flock", unforeseen), 1.0, -1.5, 13) < 0.1


def test_it_hardly_gives_way_to_one_that_merely_flies_slower() -> None:
    assert sideways(Follower("flock"), 0.6, 0.0, 20) < 0.05


def test_it_gives_way_a_little_to_a_leader_that_sets_out_slowly() -> None:
    coming = others((1.2, 0.0, 0.0, -0.6, 0.0, 0.0), (0.0, 1.6, 0.0, 0.0, 0.0, 0.0))
    v = Follower("flock").settle(own(), coming)
    assert 0.02 < abs(v[1]) < 0.5


def test_it_keeps_to_the_side_on_which_it_began_to_give_way() -> None:
    """Errors of the other's velocity change the side on which it seems to pass."""
    rng = np.random.default_rng(3)
    follower = Follower("flock")
    sides = []
    for _ in range(20):
        coming = others((1.6, 0.0, 0.0, -1.5, float(rng.normal(0.0, 0.1)), 0.0))
        sides.append(float(np.sign(follower.steer(own(), coming)[1])))
    assert set(sides[3:]) == {sides[-1]}


def test_it_never_flies_at_an_obstacle_faster_than_the_room_allows_unless_it_leaves_it_aside() -> None:
    g = FollowerSettings().flock
    rng = np.random.default_rng(5)
    left_aside = 0
    for _ in range(200):
        distance, azimuth = rng.uniform(0.5, 2.0), 5.0 * rng.integers(0, 72) + 2.5
        flock = others((4.0, rng.uniform(-3.0, 3.0), 0.0, 1.5, 0.0, 0.0))
        v = Follower("flock").settle(own(), flock, column(free(), azimuth, distance))
        n = np.array([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))])
        bound = g.obstacle_per_s * (distance - g.obstacle_margin_m - g.body_radius_m)
        if v[:2] @ n > max(bound, -1.0) + 1e-6:
            aside = distance * abs(n[0] * v[1] - n[1] * v[0]) / np.linalg.norm(v[:2])
            assert aside >= g.body_radius_m + g.obstacle_margin_m + g.pass_m - 1e-6
            left_aside += 1
    assert left_aside > 0


def test_a_pillar_beside_the_way_does_not_slow_it_down() -> None:
    flock = others((4.0, 0.0, 0.0, 1.5, 0.0, 0.0))
    free_way = Follower("flock").settle(own(v=(1.2, 0.0, 0.0)), flock)
    beside = column(free(), 37.5, 1.15)
    gains = {"flow_m2ps": 0.0, "pass_m": 0.05, "obstacle_margin_m": 0.15}
    passing = Follower("flock", with_gains(FollowerSettings(), "flock", gains))
    braking = Follower("flock", with_gains(FollowerSettings(), "flock", {**gains, "pass_m": 2.0}))
    assert passing.settle(own(v=(1.2, 0.0, 0.0)), flock, beside)[0] > 0.95 * free_way[0]
    assert braking.settle(own(v=(1.2, 0.0, 0.0)), flock, beside)[0] < 0.9 * free_way[0]


def test_a_fast_vehicle_brakes_earlier_than_a_slow_one() -> None:
    ahead = column(column(free(), 0.0, 1.6), -5.0, 1.6)
    flock = others((5.0, 0.0, 0.0, 1.0, 0.0, 0.0))
    slow = Follower("flock").settle(own(), flock, ahead)
    fast = Follower("flock").settle(own(v=(1.5, 0.0, 0.0)), others((5.0, 0.0, 0.0, -0.5, 0.0, 0.0)), ahead)
    assert fast[0] < slow[0]


def test_it_goes_round_a_pillar_that_stands_in_the_way_and_keeps_to_one_side() -> None:
    ranges = free()
    for azimuth in (-10.0, -5.0, 0.0, 5.0):
        column(ranges, azimuth, 0.7)
    follower = Follower("flock")
    flock = others((4.0, 0.0, 0.0))
    commands = [follower.steer(own(), flock, ranges) for _ in range(60)][20:]
    sides = {float(np.sign(v[1])) for v in commands}
    assert len(sides) == 1
    assert min(abs(v[1]) for v in commands) > 0.2


def test_obstacles_count_only_near_the_own_height() -> None:
    """A crown 1 m higher and a stone 1 m lower are flown under and over."""
    high = column(free(), 0.0, 1.0, rows=slice(10, 12))
    level = column(free(), 0.0, 1.0, rows=slice(1, 3))
    flock = others((4.0, 0.0, 0.0))
    open_field = Follower("flock").settle(own(), flock)
    assert Follower("flock").settle(own(), flock, high).tolist() == open_field.tolist()
    assert Follower("flock").settle(own(), flock, level).tolist() != open_field.tolist()


def test_an_obstacle_that_leaves_the_view_is_remembered_for_a_while_and_then_forgotten() -> None:
    settings = with_gains(FollowerSettings(), "flock", {"obstacle_memory_s": 2.0, "detour": 0.0})
    follower = Follower("flock", settings)
    flock = others((4.0, 0.0, 0.0))
    follower.settle(own(), flock, column(column(free(), 0.0, 0.6), -5.0, 0.6))
    just_out = follower.steer(own(), flock)
    for _ in range(60):
        later = follower.steer(own(), flock)
    assert just_out[0] < 0.5 * later[0]


def test_a_neighbour_out_of_sight_is_followed_for_a_while() -> None:
    settings = with_gains(FollowerSettings(), "flock", {"neighbour_memory_s": 2.0, "coast_s": 0.5})
    follower = Follower("flock", settings)
    follower.settle(own(), others((4.0, 0.0, 0.0)))
    for _ in range(10):
        soon = follower.steer(own(), others())
    for _ in range(200):
        long_after = follower.steer(own(alone=8.0), others())
    assert soon[0] > 0.3
    assert np.linalg.norm(long_after[:2]) < 0.01


def test_alone_it_returns_to_the_recovery_height_after_a_second() -> None:
    settled = Follower("flock").settle(own(p=(0.0, 0.0, 1.4), alone=0.5), others())
    assert settled[2] == 0.0
    settled = Follower("flock").settle(own(p=(0.0, 0.0, 1.4), alone=1.5), others())
    assert settled[2] == pytest.approx(-0.4)


def test_a_gap_is_closed_to_the_nearest_across_it_only() -> None:
    gains = {
        "cohesion_per_s": 0.0,
        "feed_forward": 0.0,
        "separation_m2ps": 0.0,
        "link_per_s": 0.5,
        "link_m": 2.0,
    }
    settings = with_gains(FollowerSettings(), "flock", gains)
    one = Follower("flock", settings).settle(own(), others((3.0, 0.0, 0.0)))
    two = Follower("flock", settings).settle(own(), others((3.0, 0.0, 0.0), (5.0, 0.5, 0.0)))
    assert one[:2] == pytest.approx([0.5, 0.0])
    assert two.tolist() == one.tolist()
