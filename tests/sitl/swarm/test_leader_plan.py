import numpy as np
import pytest

from companion.messages import FloatArray
from sitl.swarm.leader_plan import LeaderPlan, plan_leader
from sitl.swarm.settings import Behaviour, LeaderBehaviourSettings

START = np.array([2.0, 1.0])
GOAL = np.array([[32.0, 1.0]])


def _plan(
    behaviour: Behaviour, seed: int = 0, way: FloatArray = GOAL, *, own_way: bool = False
) -> LeaderPlan:
    settings = LeaderBehaviourSettings(behaviour=behaviour)
    return plan_leader(settings, START, way, np.random.default_rng(seed), own_way=own_way)


def test_straight_is_the_way_as_given() -> None:
    way = np.array([[10.0, 0.0], [20.0, 5.0]])
    plan = _plan("straight", way=way)
    np.testing.assert_array_equal(plan.waypoints_world, way)
    np.testing.assert_array_equal(plan.holds_s, [0.0, 3.0])


def test_hover_pauses_for_long_on_the_first_stretch() -> None:
    for seed in range(20):
        plan = _plan("hover", seed)
        (x, y), goal = plan.waypoints_world
        assert 12.0 <= x <= 22.0
        assert y == 1.0
        np.testing.assert_array_equal(goal, GOAL[0])
        assert 5.0 <= plan.holds_s[0] <= 12.0


def test_reverse_goes_back_several_metres_before_it_goes_on() -> None:
    for seed in range(20):
        plan = _plan("reverse", seed)
        turned, back, goal = plan.waypoints_world
        assert 4.0 <= turned[0] - back[0] <= 8.0
        np.testing.assert_array_equal(goal, GOAL[0])
        np.testing.assert_array_equal(plan.holds_s, [0.0, 0.0, 3.0])


def test_turn_leaves_for_a_goal_as_far_away_at_a_sharp_angle_to_either_side() -> None:
    sides = set()
    for seed in range(20):
        plan = _plan("turn", seed)
        middle, goal = plan.waypoints_world
        before, after = middle - START, goal - middle
        assert np.linalg.norm(before) + np.linalg.norm(after) == pytest.approx(30.0)
        angle = np.arctan2(before[0] * after[1] - before[1] * after[0], before @ after)
        assert np.radians(60.0) <= abs(angle) <= np.radians(150.0)
        sides.add(bool(angle > 0.0))
    assert sides == {True, False}


def test_mixed_draws_every_behaviour_but_no_turn_where_the_way_is_the_worlds() -> None:
    assert {_plan("mixed", seed).behaviour for seed in range(60)} == {"straight", "hover", "reverse", "turn"}
    own = {_plan("mixed", seed, own_way=True).behaviour for seed in range(60)}
    assert own == {"straight", "hover", "reverse"}
    with pytest.raises(ValueError, match="cannot turn"):
        _plan("turn", own_way=True)
