"""The laws of others agree with their oracles, and with cases worked out by hand."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from companion.control.followers.layout_kernels import PLAIN_STATE
from companion.control.followers.settings import METHODS, CommandSettings, FollowerSettings, with_gains
from companion.messages import FloatArray
from tests.control.followers.oracles import Lloyd, Reynolds, Shared, Vpf, VpfPolar
from tests.control.followers.situations import Follower, column, drawn, free, others, own

Oracle = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
ORACLES: dict[str, Callable[[Any, CommandSettings], Oracle]] = {
    "vpf": Vpf,
    "vpf_polar": VpfPolar,
    "reynolds_apf": Reynolds,
    "lloyd": Lloyd,
}


@pytest.mark.parametrize("method", ORACLES)
@pytest.mark.parametrize("seed", range(4))
def test_a_law_agrees_with_its_oracle_on_random_flights(method: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    settings = FollowerSettings()
    if method == "reynolds_apf":
        settings = with_gains(settings, method, {"low_pass_s": 0.3, "alignment": 0.4})
    follower = Follower(method, settings)
    oracle = ORACLES[method](getattr(settings, method), settings.command)
    shared = Shared(settings.command)
    for _ in range(40):
        ego, neighbours, ranges = drawn(rng)
        wish = np.append(oracle(ego, neighbours, ranges), shared.height(ego, neighbours))
        expected = shared.finish(ego, wish)
        assert follower.steer(ego, neighbours, ranges) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("method", [name for name in METHODS if name != "vpf_polar"])
def test_nobody_and_nothing_in_view_moves_nobody_sideways(method: str) -> None:
    assert Follower(method).settle(own(), others())[:2] == pytest.approx([0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("method", [name for name in METHODS if name != "flock"])
def test_a_follower_that_sees_nobody_goes_to_the_recovery_height(method: str) -> None:
    settled = Follower(method).settle(own(p=(0.0, 0.0, 1.3), alone=5.0), others())
    assert settled[2] == pytest.approx(-0.3)


@pytest.mark.parametrize("method", [name for name in METHODS if name != "flock"])
def test_height_follows_the_mean_of_the_neighbours_up_to_a_limit(method: str) -> None:
    near = others((3.0, 0.0, 0.1), (0.0, 3.0, 0.3))
    assert Follower(method).settle(own(), near)[2] == pytest.approx(0.2)
    assert Follower(method).settle(own(), others((3.0, 0.0, 2.0)))[2] == pytest.approx(0.5)


def test_two_reynolds_vehicles_settle_at_the_root_of_separation_over_cohesion() -> None:
    gains = {"separation_m2ps": 7.0, "cohesion_per_s": 1.0}
    settings = with_gains(FollowerSettings(), "reynolds_apf", gains)
    spacing = np.sqrt(7.0)
    for distance, sign in ((spacing - 0.1, -1.0), (spacing, 0.0), (spacing + 0.1, 1.0)):
        v = Follower("reynolds_apf", settings).settle(own(), others((distance, 0.0, 0.0)))
        assert np.sign(np.round(v[0], 9)) == sign
        assert v[1] == 0.0


def test_the_potential_field_repels_by_its_formula() -> None:
    gap, reach = 0.9 - 0.2, 2.5
    v = Follower("reynolds_apf").settle(own(), others(), column(free(), 0.0, 0.9))
    size = 0.6 * (1.0 / gap - 1.0 / reach) / gap**2
    assert np.linalg.norm(v[:2]) == pytest.approx(size)
    assert v[0] == pytest.approx(-size * np.cos(np.radians(2.5)))
    assert v[1] == pytest.approx(-size * np.sin(np.radians(2.5)))


def test_visual_neighbours_settle_where_the_edges_weigh_as_much_as_the_area() -> None:
    radius, edge = 0.2, 0.10
    distance = radius * np.sqrt(1.0 + 1.0 / edge**2)
    for offset, sign in ((-0.1, -1.0), (0.0, 0.0), (0.1, 1.0)):
        v = Follower("vpf").settle(own(), others((distance + offset, 0.0, 0.0)))
        assert np.sign(np.round(v[0], 9)) == sign


def test_a_hidden_neighbour_does_not_pull() -> None:
    alone = Follower("vpf").settle(own(), others((3.0, 0.0, 0.0)))
    behind = Follower("vpf").settle(own(), others((3.0, 0.0, 0.0), (6.0, 0.1, 0.0)))
    beside = Follower("vpf").settle(own(), others((3.0, 0.0, 0.0), (6.0, 1.0, 0.0)))
    assert behind.tolist() == alone.tolist()
    assert beside.tolist() != alone.tolist()


def test_a_near_trunk_pushes_a_visual_follower_no_more_than_a_far_one_of_the_same_width() -> None:
    near = Follower("vpf").settle(own(), others(), column(free(), 0.0, 0.5))
    far = Follower("vpf").settle(own(), others(), column(free(), 0.0, 2.5))
    assert near.tolist() == far.tolist()
    assert near[0] == pytest.approx(-2.0 * np.sin(np.radians(2.5)) * np.cos(np.radians(2.5)))


def test_walls_all_round_do_not_push_a_visual_follower_anywhere() -> None:
    assert Follower("vpf").settle(own(), others(), np.full((72, 12), 1.0)).tolist()[:2] == [0.0, 0.0]


def test_a_polar_follower_reaches_its_cruise_speed_along_its_heading() -> None:
    follower = Follower("vpf_polar")
    for _ in range(400):
        v = follower.steer(own(yaw=0.7), others())
    assert v[:2] == pytest.approx([1.0, 0.0], abs=1e-3)


def test_a_lloyd_follower_in_a_cell_without_goal_stays_in_its_middle() -> None:
    pair = others((2.0, 0.0, 0.0), (-2.0, 0.0, 0.0))
    assert Follower("lloyd").settle(own(), pair)[:2] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_a_lloyd_follower_gives_way_inside_the_spacing() -> None:
    v = Follower("lloyd").steer(own(dt=1.0), others((0.7, 0.0, 0.0)))
    assert v[0] < -0.4
    assert v[1] == pytest.approx(0.0, abs=1e-9)


def test_a_stuck_lloyd_follower_narrows_its_weight_and_turns_its_goal_to_the_right() -> None:
    """Walls all round: the goal turns away from the flock ahead; once they are gone all is as before."""
    settings = with_gains(FollowerSettings(), "lloyd", {"spread_m": 1.5, "least_spread_m": 0.5})
    follower, flock = Follower("lloyd", settings), others((4.0, 0.0, 0.0))
    for _ in range(45):
        follower.steer(own(), flock, np.full((72, 12), 0.6))
    spread, turn = follower.memory[PLAIN_STATE : PLAIN_STATE + 2]
    assert spread < 0.7
    assert turn > 1.3
    turned = follower.steer(own(dt=0.5), flock)
    assert turned[1] < -0.3
    for _ in range(100):
        follower.steer(own(), flock)
    assert follower.memory[PLAIN_STATE : PLAIN_STATE + 2] == pytest.approx([1.5, 0.0], abs=0.02)
