import math

import numpy as np
import pytest

from companion.messages import FloatArray
from sitl.training.environment_settings import EnvironmentSettings
from sitl.training.grid_tables import grid_tables
from sitl.training.reward_kernels import reward_terms
from sitl.training.reward_settings import TERMS, RewardSettings

LEVEL = (1.0, 0.0, 0.0, 0.0)
FREE = np.full((72, 12), np.inf)
DIRECTIONS = grid_tables(EnvironmentSettings())[4]


def _state(x: float, y: float, z: float, v: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[float]:
    return [x, y, z, *v, *LEVEL]


def _terms(
    states: list[list[float]],
    *,
    room: float = math.inf,
    perceived: int = 1,
    ranges: FloatArray = FREE,
    settings: RewardSettings | None = None,
) -> dict[str, float]:
    """Return the terms of vehicle 1 over ground at height 0."""
    terms = np.zeros(len(TERMS))
    numbers = (settings or RewardSettings()).packed(0.2)
    reward_terms(1, np.array(states), room, 0.0, perceived, ranges, DIRECTIONS, numbers, terms)
    return dict(zip(TERMS, terms, strict=True))


def test_separation_costs_one_where_bodies_touch_and_nothing_at_the_safety_distance() -> None:
    assert _terms([_state(0.4, 0, 1), _state(0, 0, 1)])["separation"] == pytest.approx(-1.0)
    assert _terms([_state(1.6, 0, 1), _state(0, 0, 1)])["separation"] == 0.0


def test_separation_is_summed_over_all_others() -> None:
    # (1.6 - 1) / 1.2 and (1.6 - 1.3) / 1.2.
    states = [_state(1.0, 0, 1), _state(0, 0, 1), _state(-1.3, 0, 1), _state(0, 5, 1)]
    assert _terms(states)["separation"] == pytest.approx(-0.75)


def test_cohesion_costs_the_distance_from_the_middle_beyond_its_threshold_up_to_a_bound() -> None:
    # The middle of (0, 0), (6, 0) is 3 m away: 1 m too far.
    states = [_state(6, 0, 1), _state(0, 0, 1)]
    assert _terms(states)["cohesion"] == pytest.approx(-1.0)
    assert _terms([_state(40, 0, 1), _state(0, 0, 1)])["cohesion"] == -5.0
    assert _terms([_state(3, 0, 1), _state(0, 0, 1)])["cohesion"] == 0.0


def test_spread_and_leash_have_thresholds_of_their_own() -> None:
    terms = _terms([_state(6, 0, 1), _state(0, 0, 1)], settings=RewardSettings(spread_m=1.0, leash_m=4.5))
    assert terms["spread"] == pytest.approx(-2.0)
    assert terms["leash"] == pytest.approx(-1.5)


def test_proximity_grows_with_the_fourth_power_and_is_one_at_contact() -> None:
    states = [_state(2, 0, 1), _state(0, 0, 1)]
    assert _terms(states, room=0.2)["proximity"] == pytest.approx(-1.0)
    # ((3 - 1) / 2.8)^4.
    assert _terms(states, room=1.0)["proximity"] == pytest.approx(-0.260308, abs=1e-6)
    assert _terms(states, room=3.0)["proximity"] == 0.0


def _wall(distance: float) -> FloatArray:
    """Return the grid of a wall across the way ahead."""
    with np.errstate(divide="ignore"):
        ranges = distance / DIRECTIONS[..., 0]
    return np.where((ranges > 0.0) & (ranges < 10.0), ranges, np.inf)


def test_direction_towards_a_wall_is_what_was_worked_out_by_hand() -> None:
    states = [_state(2, 0, 1), _state(0, 0, 1, (1.0, 0.0, 0.0))]
    # At 1 m/s at a wall 2 m ahead: a little less than 1 on average over the cone, about 36 cells together.
    mean = _terms(states, ranges=_wall(2.0))["direction"]
    total = _terms(states, ranges=_wall(2.0), settings=RewardSettings(direction="sum"))["direction"]
    share = _terms(states, ranges=_wall(2.0), settings=RewardSettings(direction="mean_all"))["direction"]
    assert mean == pytest.approx(-0.94, abs=0.02)
    assert total == pytest.approx(-34.0, abs=1.0)
    assert round(total / mean) == 36
    assert share == pytest.approx(total / 864.0)


def test_direction_is_proportional_to_speed_and_looks_along_the_velocity_only() -> None:
    def towards(v: tuple[float, float, float]) -> float:
        return _terms([_state(2, 0, 1), _state(0, 0, 1, v)], ranges=_wall(2.0))["direction"]

    assert towards((2.0, 0.0, 0.0)) == pytest.approx(2.0 * towards((1.0, 0.0, 0.0)))
    assert towards((-1.0, 0.0, 0.0)) == 0.0
    assert towards((0.04, 0.0, 0.0)) == 0.0


def test_direction_is_seen_from_the_own_heading() -> None:
    half = 0.25 * math.pi
    turned = [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, math.cos(half), 0.0, 0.0, math.sin(half)]
    ahead = _terms([_state(2, 0, 1), _state(0, 0, 1, (1.0, 0.0, 0.0))], ranges=_wall(2.0))["direction"]
    assert _terms([_state(2, 0, 1), turned], ranges=_wall(2.0))["direction"] == pytest.approx(ahead)


def test_altitude_is_worth_one_at_the_leaders_and_falls_off_as_a_bell() -> None:
    assert _terms([_state(2, 0, 1.5), _state(0, 0, 1.5)])["altitude"] == 1.0
    assert _terms([_state(2, 0, 1.5), _state(0, 0, 1.4)])["altitude"] == pytest.approx(math.exp(-1.0))
    assert _terms([_state(2, 0, 1.5), _state(0, 0, 1.7)])["altitude"] == pytest.approx(math.exp(-4.0))


def test_attitude_is_worth_one_upright_and_falls_off_with_the_upward_axis() -> None:
    angle = math.acos(0.9)
    tilted = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0]
    assert _terms([_state(2, 0, 1), _state(0, 0, 1)])["attitude"] == 1.0
    assert _terms([_state(2, 0, 1), tilted])["attitude"] == pytest.approx(math.exp(-1.0))


def test_visibility_is_the_share_of_the_others_and_six_are_enough() -> None:
    five = [_state(2.0 * k, 0, 1) for k in range(5)]
    eleven = [_state(2.0 * k, 0, 1) for k in range(11)]
    assert _terms(five, perceived=3)["visibility"] == pytest.approx(0.75)
    assert _terms(eleven, perceived=3)["visibility"] == pytest.approx(0.5)
    assert _terms(eleven, perceived=9)["visibility"] == 1.0


def test_recovery_costs_height_only_where_nobody_is_perceived() -> None:
    states = [_state(2, 0, 1), _state(0, 0, 2.5)]
    assert _terms(states, perceived=0)["recovery"] == pytest.approx(-1.5)
    assert _terms(states, perceived=1)["recovery"] == 0.0


def test_alignment_is_what_the_cosine_to_the_flocks_velocity_lacks_while_both_move() -> None:
    states = [_state(2, 0, 1, (1.0, 0.0, 0.0)), _state(0, 0, 1, (0.0, 1.0, 0.0))]
    assert _terms(states)["alignment"] == pytest.approx(math.sqrt(0.5) - 1.0)
    together = [_state(2, 0, 1, (1.0, 0.0, 0.0)), _state(0, 0, 1, (1.0, 0.0, 0.0))]
    assert _terms(together)["alignment"] == pytest.approx(0.0)
    assert _terms([_state(2, 0, 1), _state(0, 0, 1)])["alignment"] == 0.0


def test_weights_are_the_papers_and_our_own_terms_weigh_nothing_unless_asked() -> None:
    weights = dict(zip(TERMS, RewardSettings().weights, strict=True))
    assert weights["separation"] == weights["cohesion"] == 1.5
    assert weights["proximity"] == weights["direction"] == 2.0
    assert weights["altitude"] == weights["attitude"] == weights["visibility"] == weights["recovery"] == 1.0
    assert weights["collision"] == 10.0
    own = ("loss", "smoothness", "residual", "spread", "leash", "alignment")
    assert all(weights[name] == 0.0 for name in own)
    asked = dict(zip(TERMS, RewardSettings(loss=3.0, spread=0.5).weights, strict=True))
    assert asked["loss"] == 3.0
    assert asked["spread"] == 0.5
