import numpy as np

from companion.clock import seconds_to_ns
from companion.control.leader.obstacle_map import ClearanceField
from companion.control.leader.route import Route
from companion.control.leader.rrt import SearchStatus
from companion.control.leader.settings import RrtSettings
from tests.control.leader.fields import field_of, wall

OPEN = field_of(np.zeros((0, 2)), 0.3)
FAR = np.array([20.0, 0.0])
ORIGIN = np.zeros(2)


def route(**more: float) -> Route:
    return Route(RrtSettings(**more), 0.3, np.random.default_rng(0))  # type: ignore[arg-type]


def update(
    present: Route, field: ClearanceField, p: tuple[float, float], t_s: float, waypoint: np.ndarray = FAR
) -> bool:
    return present.update(field, np.array(p), waypoint, seconds_to_ns(t_s))


def test_a_search_is_made_once_a_second_while_nothing_is_wrong() -> None:
    present = route()
    assert update(present, OPEN, (0.0, 0.0), 100.0)
    assert present.status == "planned"
    assert not update(present, OPEN, (0.5, 0.0), 100.5)
    assert update(present, OPEN, (1.0, 0.0), 101.0)
    assert present.status == "kept"
    assert present.remaining(np.array([1.0, 0.0])).tolist() == [[1.0, 0.0], [9.0, 0.0]]


def test_an_obstacle_within_three_metres_on_the_path_is_answered_at_once() -> None:
    present = route()
    update(present, OPEN, (0.0, 0.0), 100.0)
    assert not update(present, field_of(np.array([[6.0, 0.0]]), 0.3), (0.0, 0.0), 100.3)
    blocked = field_of(np.array([[3.0, 0.0]]), 0.3)
    assert update(present, blocked, (0.0, 0.0), 100.4)
    assert present.status == "planned"
    assert np.abs(present.remaining(ORIGIN)[:, 1]).max() > 1.0


def test_straying_more_than_a_metre_is_answered_at_once() -> None:
    present = route()
    update(present, OPEN, (0.0, 0.0), 100.0)
    assert not update(present, OPEN, (0.5, 0.9), 100.3)
    assert update(present, OPEN, (0.5, 1.1), 100.4)
    assert present.status == "planned"
    assert present.remaining(np.array([0.5, 1.1]))[0].tolist() == [0.5, 1.1]


def test_another_waypoint_is_answered_at_once() -> None:
    present = route()
    update(present, OPEN, (0.0, 0.0), 100.0)
    assert update(present, OPEN, (0.0, 0.0), 100.02, np.array([0.0, 5.0]))
    assert present.remaining(ORIGIN)[-1].tolist() == [0.0, 5.0]


def test_a_path_that_is_free_and_not_much_longer_is_kept() -> None:
    field = field_of(np.array([[4.0, 0.05]]), 0.3)
    present = route()
    update(present, field, (0.0, 0.0), 100.0)
    side = np.sign(present.beyond(4.0)[1])
    for second in range(1, 4):
        update(present, field, (0.0, 0.0), 100.0 + second)
        assert present.status == "kept"
        assert np.sign(present.beyond(4.0)[1]) == side


def test_a_path_much_longer_than_a_new_one_is_given_up() -> None:
    present = route()
    update(present, field_of(wall((4.0, -3.0), (4.0, 3.0)), 0.1), (0.0, 0.0), 100.0)
    assert np.abs(present.remaining(ORIGIN)[:, 1]).max() > 3.0
    update(present, OPEN, (0.0, 0.0), 101.0)
    assert present.status == "planned"
    assert present.remaining(ORIGIN).tolist() == [[0.0, 0.0], [8.0, 0.0]]


def test_without_a_path_searches_go_on_at_the_retry_period() -> None:
    room = field_of(wall((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0), (-3.0, -3.0)), 0.1)
    present = route()
    update(present, room, (0.0, 0.0), 100.0)
    assert present.status == "no path"
    assert present.remaining(ORIGIN).shape == (0, 2)
    assert not update(present, room, (0.0, 0.0), 100.1)
    assert update(present, room, (0.0, 0.0), 100.2)
    assert update(present, OPEN, (0.0, 0.0), 100.4)
    assert present.status == "planned"


def test_the_way_out_of_a_dead_end_is_flown_to_its_end() -> None:
    trap = field_of(wall((-2.0, -2.0), (3.0, -2.0), (3.0, 2.0), (-2.0, 2.0)), 0.1)
    present = route()
    assert update(present, trap, (1.0, 0.0), 100.0, np.array([8.0, 0.0]))
    assert present.path is not None
    assert present.path.status is SearchStatus.REACHED
    way_out = present.path.points
    p = np.array([1.0, 0.0])
    for second in range(1, 4):
        p = present.beyond(1.0)
        update(present, trap, (p[0], p[1]), 100.0 + second, np.array([8.0, 0.0]))
        assert present.status == "kept"
        assert np.array_equal(present.remaining(p)[-3:], way_out[-3:])


def test_after_long_vain_attempts_no_more_detours_are_made() -> None:
    barrier = field_of(wall((5.0, -14.0), (5.0, 14.0)), 0.1)
    present = route(patience_s=30.0)
    update(present, barrier, (0.0, 0.0), 100.0)
    assert present.path is not None
    assert present.path.status is SearchStatus.DETOUR
    update(present, barrier, (0.0, 0.0), 129.0)
    assert present.path is not None
    update(present, barrier, (0.0, 0.0), 131.0)
    assert present.status == "no path"


def test_a_waypoint_that_cannot_be_reached_is_in_the_end_replaced_by_a_place_near_it() -> None:
    around = wall((4.0, -1.0), (6.0, -1.0), (6.0, 1.0), (4.0, 1.0), (4.0, -1.0))
    inside = np.array([5.0, 0.0])
    present = route(patience_s=30.0)
    update(present, field_of(around, 0.1), (0.0, 0.0), 100.0, inside)
    assert np.array_equal(present.goal, inside)
    update(present, field_of(around, 0.1), (0.0, 0.0), 131.0, inside)
    assert 1.0 < np.hypot(*(present.goal - inside)) <= 3.0
    assert present.remaining(ORIGIN)[-1].tolist() == present.goal.tolist()


def test_the_point_ahead_comes_nearer_where_the_line_to_it_would_cut_a_corner() -> None:
    corner = field_of(wall((2.0, -6.0), (2.0, 0.0), (9.0, 0.0)), 0.1)
    present = route()
    update(present, corner, (0.9, -1.5), 100.0, np.array([7.0, 2.0]))
    straight, _ = present.ahead(OPEN, np.array([0.9, -1.5]), 6.0)
    point, is_open = present.ahead(corner, np.array([0.9, -1.5]), 6.0)
    assert is_open
    assert np.hypot(*(point - [0.9, -1.5])) < np.hypot(*(straight - [0.9, -1.5])) - 0.5
