from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.control.leader import rrt_kernels
from tests.control.leader import oracles
from tests.control.leader.fields import field_of, wall

NO_ENDS = np.array([[0.0, 0.0, np.inf], [0.0, 0.0, np.inf]])


def test_clearance_is_that_of_the_discs_and_unknown_outside() -> None:
    discs = np.array([[3.0, 1.0], [-2.0, 0.5]])
    field = field_of(discs, 0.4)
    rng = np.random.default_rng(0)
    for point in rng.uniform(-10.0, 10.0, (200, 2)):
        exact = min(max(float(np.hypot(*(discs - point).T).min()) - 0.4, 0.0), 3.0)
        assert field.clearance(point) == pytest.approx(exact, abs=0.1)
    for outside in ([13.0, 0.0], [0.0, -13.0], [np.nan, 0.0]):
        assert field.clearance(np.array(outside)) == 100.0


def test_a_segment_is_free_exactly_if_it_keeps_its_distance() -> None:
    field = field_of(np.array([[3.0, 0.0]]), 0.4)
    a, b = np.array([0.0, 1.5]), np.array([6.0, 1.5])
    assert field.is_segment_free(a, b, 1.0, NO_ENDS)
    assert not field.is_segment_free(a, b, 1.2, NO_ENDS)
    assert field.is_segment_free(a, a, 1.2, NO_ENDS)


def test_a_vehicle_near_an_obstacle_may_leave_it_but_not_go_along_it() -> None:
    field = field_of(wall((-5.0, 1.0), (5.0, 1.0)), 0.1)
    near = np.array([0.0, 0.4])
    ends = np.array([[*near, field.clearance(near)], [0.0, -4.0, np.inf]])
    assert field.is_segment_free(near, np.array([0.0, -4.0]), 1.1, ends)
    assert not field.is_segment_free(near, np.array([3.0, 0.4]), 1.1, ends)
    assert not field.is_segment_free(near, np.array([0.0, 4.0]), 1.1, ends)


def test_the_tree_equals_the_oracle() -> None:
    field = field_of(np.array([[3.0, 0.3], [5.0, -1.5], [1.0, 3.0]]), 0.4)
    reached = []
    for seed in range(6):
        samples = np.random.default_rng(seed).random((200, 3))
        ends = np.array([[0.0, 0.0, np.inf], [7.0, 0.0, np.inf]])
        nodes, parents = np.zeros((120, 2)), np.zeros(120, np.int64)
        count, goal = rrt_kernels.grow_tree(
            field.distance, field.corner_map[0], field.corner_map[1], field.cell_m, 0.9, ends, samples, 9.0,
            0.15, 0.8, nodes, parents,
        )  # fmt: skip
        expected, expected_parents, expected_goal = oracles.tree_of(
            field.clearance, 0.9, ends[0, :2], ends[1, :2], samples, 9.0, 0.15, 0.8, 120
        )
        assert goal == expected_goal
        assert np.allclose(nodes[:count], expected)
        assert parents[:count].tolist() == expected_parents
        reached.append(goal)
    assert max(reached) > 0


def test_every_edge_of_a_tree_keeps_the_clearance_and_the_step() -> None:
    discs = np.concatenate([wall((3.0, -4.0), (3.0, 4.0)), np.array([[-2.0, 1.0]])])
    field = field_of(discs, 0.1)
    samples = np.random.default_rng(1).random((1200, 3))
    ends = np.array([[0.0, 0.0, np.inf], [7.0, 0.0, np.inf]])
    nodes, parents = np.zeros((600, 2)), np.zeros(600, np.int64)
    count, goal = rrt_kernels.grow_tree(
        field.distance,
        field.corner_map[0],
        field.corner_map[1],
        field.cell_m,
        1.0,
        ends,
        samples,
        9.0,
        0.15,
        0.8,
        nodes,
        parents,
    )
    assert goal == count - 1 > 0
    assert np.array_equal(nodes[goal], [7.0, 0.0])
    for child in range(1, count):
        line = np.linspace(nodes[parents[child]], nodes[child], 9)
        assert np.hypot(*(nodes[child] - nodes[parents[child]])) < 0.8 + 1e-9
        gaps = np.hypot(*(line[:, None] - discs[None]).transpose(2, 0, 1)) - 0.1
        assert gaps.min() > 0.9


def test_a_tree_in_a_closed_room_stops_at_its_limit() -> None:
    field = field_of(wall((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0), (-3.0, -3.0)), 0.1)
    samples = np.random.default_rng(1).random((5000, 3))
    ends = np.array([[0.0, 0.0, np.inf], [7.0, 0.0, np.inf]])
    nodes, parents = np.zeros((50, 2)), np.zeros(50, np.int64)
    count, goal = rrt_kernels.grow_tree(
        field.distance,
        field.corner_map[0],
        field.corner_map[1],
        field.cell_m,
        0.5,
        ends,
        samples,
        9.0,
        0.15,
        0.8,
        nodes,
        parents,
    )
    assert (count, goal) == (49, -1)
    assert np.abs(nodes[:count]).max() < 2.5


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_shortcuts_keep_ends_and_clearance_and_never_lengthen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    discs = np.array([[3.0, 0.0], [6.0, 1.0]])
    field = field_of(discs, 0.3)
    zigzag = np.array([[0.0, 0.0], [1.0, -2.0], [2.0, 2.0], [4.0, 2.2], [4.5, -2.0], [7.0, -1.5], [8.0, 0.0]])
    rows = np.zeros((zigzag.shape[0] + 100, 2))
    rows[: zigzag.shape[0]] = zigzag
    count = rrt_kernels.cut_corners(
        field.distance,
        field.corner_map[0],
        field.corner_map[1],
        field.cell_m,
        0.8,
        NO_ENDS,
        rng.random((50, 2)),
        rows,
        zigzag.shape[0],
    )
    path = rows[:count]
    assert np.array_equal(path[0], zigzag[0])
    assert np.array_equal(path[-1], zigzag[-1])
    lengths = np.hypot(*np.diff(path, axis=0).T)
    assert lengths.sum() <= np.hypot(*np.diff(zigzag, axis=0).T).sum() + 1e-9
    line = np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(path)])
    gaps = np.hypot(*(line[:, None] - discs[None]).transpose(2, 0, 1)) - 0.3
    assert gaps.min() > 0.65


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 6.0), st.floats(0.5, 6.0))
def test_the_nearest_point_of_a_path_equals_the_densely_sampled_one(
    seed: int, low: float, span: float
) -> None:
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.uniform(-1.0, 1.5, (8, 2)), axis=0)
    path[3] = path[2]
    x, y = rng.uniform(-2.0, 6.0, 2)
    s, gap, total = rrt_kernels.locate(path, x, y, low, low + span)
    assert total == pytest.approx(np.hypot(*np.diff(path, axis=0).T).sum())
    dense = np.linspace(min(low, total), min(low + span, total), 2000)
    gaps = [np.hypot(*(np.array(rrt_kernels.point_at(path, value)) - [x, y])) for value in dense]
    assert gap == pytest.approx(min(gaps), abs=0.01)
    assert low - 1e-9 <= s <= low + span + 1e-9 or s == pytest.approx(total)
    assert np.hypot(*(np.array(rrt_kernels.point_at(path, s)) - [x, y])) == pytest.approx(gap, abs=1e-9)


def test_a_path_is_free_up_to_the_obstacle_on_it() -> None:
    field = field_of(np.array([[5.0, 0.0]]), 0.3)
    path = np.array([[0.0, 0.0], [2.0, 0.0], [9.0, 0.0]])
    arguments = (field.distance, field.corner_map[0], field.corner_map[1], field.cell_m, 1.0, NO_ENDS, path)
    assert rrt_kernels.free_length(*arguments, 1.0, 9.0) == pytest.approx(2.7, abs=0.2)
    assert rrt_kernels.free_length(*arguments, 0.0, 3.0) == pytest.approx(3.0)
    assert rrt_kernels.free_length(*arguments, 5.0, 9.0) == 0.0
