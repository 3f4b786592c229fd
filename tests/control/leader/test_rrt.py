from itertools import pairwise

import numpy as np
import pytest

from companion.control.leader.rrt import RrtPlanner, SearchStatus
from companion.control.leader.settings import RrtSettings
from tests.control.leader.fields import field_of, wall

RADIUS = 0.3
START = np.zeros(2)
NOWHERE = np.zeros((0, 2))


def planner(seed: int = 0, settings: RrtSettings | None = None) -> RrtPlanner:
    return RrtPlanner(settings or RrtSettings(), RADIUS, np.random.default_rng(seed))


def least_gap(path: np.ndarray, discs: np.ndarray) -> float:
    line = np.concatenate([np.linspace(a, b, 60) for a, b in pairwise(path)])
    return float(np.hypot(*(line[:, None] - discs[None]).transpose(2, 0, 1)).min())


def test_in_the_open_the_path_is_the_straight_line() -> None:
    found = planner().search(field_of(NOWHERE, 0.3), START, np.array([8.0, 0.0]), NOWHERE, None)
    assert found.status is SearchStatus.REACHED
    assert found.points.tolist() == [[0.0, 0.0], [8.0, 0.0]]
    assert found.clearance == pytest.approx(1.1)
    assert found.nodes == 0


@pytest.mark.parametrize("seed", range(10))
def test_a_pillar_is_passed_with_the_whole_margin(seed: int) -> None:
    discs = np.array([[4.0, 0.0]])
    found = planner(seed).search(field_of(discs, 0.3), START, np.array([8.0, 0.0]), NOWHERE, None)
    assert found.status is SearchStatus.REACHED
    assert found.clearance == pytest.approx(1.1)
    assert least_gap(found.points, discs) > 0.3 + 1.0
    assert np.hypot(*np.diff(found.points, axis=0).T).sum() < 10.0


@pytest.mark.parametrize(("gap", "clearance"), [(2.4, 1.1), (1.6, 0.7), (1.4, 0.54)])
def test_the_margin_is_relaxed_only_as_far_as_a_gate_demands(gap: float, clearance: float) -> None:
    half = gap / 2.0 + 0.1
    discs = np.concatenate([wall((4.0, -12.0), (4.0, -half)), wall((4.0, half), (4.0, 12.0))])
    found = planner().search(field_of(discs, 0.1), START, np.array([8.0, 0.0]), NOWHERE, None)
    assert found.status is SearchStatus.REACHED
    assert found.clearance == pytest.approx(clearance)
    assert least_gap(found.points, discs) > 0.1 + RADIUS


def test_a_closed_room_gives_no_path() -> None:
    room = wall((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0), (-3.0, -3.0))
    found = planner().search(field_of(room, 0.1), START, np.array([8.0, 0.0]), NOWHERE, None)
    assert found.status is SearchStatus.NO_PATH
    assert found.points.shape == (0, 2)
    assert found.nodes <= 4 * 600


def test_a_wide_wall_gives_a_detour_and_one_flown_in_vain_another() -> None:
    field = field_of(wall((5.0, -14.0), (5.0, 14.0)), 0.1)
    first = planner().search(field, START, np.array([8.0, 0.0]), NOWHERE, None)
    assert first.status is SearchStatus.DETOUR
    end = first.points[-1]
    assert np.hypot(*end) > 0.6 * 8.0
    again = planner().search(field, START, np.array([8.0, 0.0]), np.repeat(end[None], 9, axis=0), None)
    assert again.status is SearchStatus.DETOUR
    assert np.hypot(*(again.points[-1] - end)) > 2.0


def test_a_far_goal_is_brought_onto_the_circle() -> None:
    goal = planner().local_goal(field_of(NOWHERE, 0.3), START, np.array([30.0, 40.0]), NOWHERE, None)
    assert goal == pytest.approx([4.8, 6.4])


def test_a_local_goal_inside_an_obstacle_moves_along_the_circle() -> None:
    discs = np.array([[8.0, 0.0]])
    goal = planner().local_goal(field_of(discs, 0.5), START, np.array([30.0, 0.0]), NOWHERE, None)
    assert np.hypot(*goal) == pytest.approx(8.0)
    assert 1.5 < np.hypot(*(goal - discs[0])) < 2.5


def test_the_side_once_chosen_is_preferred() -> None:
    field = field_of(np.array([[8.0, 0.0]]), 0.5)
    for side in (-1.0, 1.0):
        previous = np.array([7.0, 2.0 * side])
        goal = planner().local_goal(field, START, np.array([30.0, 0.0]), NOWHERE, previous)
        assert goal[1] * side > 0.0


def test_a_waypoint_in_an_obstacle_gets_a_free_stand_in_on_this_side() -> None:
    field = field_of(np.array([[5.0, 0.0]]), 0.5)
    waypoint = np.array([5.0, 0.0])
    stand_in = planner().reachable_goal(field, START, waypoint, waypoint)
    assert 1.0 < np.hypot(*(stand_in - waypoint)) < 1.6
    assert stand_in[0] < 4.2
    assert np.array_equal(planner().reachable_goal(field, START, waypoint, stand_in), stand_in)
    free = np.array([2.0, 2.0])
    assert np.array_equal(planner().reachable_goal(field, START, free, free), free)


def test_the_nearest_reachable_place_is_refused_when_too_far() -> None:
    room = wall((3.0, -3.0), (9.0, -3.0), (9.0, 3.0), (3.0, 3.0), (3.0, -3.0))
    field = field_of(room, 0.1)
    near = planner().nearest_reachable(field, START, np.array([4.0, 0.0]))
    assert near is not None
    assert near[0] < 3.0
    assert planner().nearest_reachable(field, START, np.array([7.0, 0.0])) is None


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_pillar_is_passed_on_the_same_side_as_before(seed: int, side: float) -> None:
    field = field_of(np.array([[4.0, 0.0]]), 0.3)
    previous = np.array([[0.0, 0.0], [4.0, 1.3 * side], [8.0, 0.0]])
    found = planner(seed).search(field, START, np.array([8.0, 0.0]), NOWHERE, previous)
    crossing = np.interp(4.0, found.points[:, 0], found.points[:, 1])
    assert crossing * side > 1.0


def test_equal_generators_give_equal_paths() -> None:
    field = field_of(np.array([[4.0, 0.2], [6.0, -1.0]]), 0.4)
    goal = np.array([8.0, 0.0])
    one, two, other = (planner(seed).search(field, START, goal, NOWHERE, None).points for seed in (1, 1, 2))
    assert one.tobytes() == two.tobytes()
    assert one.tobytes() != other.tobytes()
