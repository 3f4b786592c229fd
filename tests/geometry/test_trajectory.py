"""Poses between poses."""

import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.trajectory import Trajectory


def turning(n: int = 5) -> Trajectory:
    t_ns = np.arange(n, dtype=np.int64) * 100
    p = np.column_stack([np.arange(n, dtype=float), np.zeros(n), np.zeros(n)])
    return Trajectory(t_ns, p, rotation.from_yaw(0.1 * np.arange(n)))


def test_poses_between_two_poses_lie_on_the_straight_line_and_the_shortest_arc() -> None:
    between = turning().at(np.array([50, 150, 400]))
    assert np.allclose(between.p[:, 0], [0.5, 1.5, 4.0])
    assert np.allclose(rotation.yaw_of(between.q), [0.05, 0.15, 0.4])


def test_an_instant_outside_is_refused() -> None:
    assert turning().covers(np.array([-1, 0, 400, 401])).tolist() == [False, True, True, False]
    with pytest.raises(ValueError, match="outside"):
        turning().at(np.array([401]))


def test_times_that_do_not_ascend_are_refused() -> None:
    with pytest.raises(ValueError, match="ascend"):
        Trajectory(np.array([1, 1]), np.zeros((2, 3)), np.tile(rotation.IDENTITY, (2, 1)))


def test_the_length_of_a_path_is_the_sum_of_its_steps() -> None:
    assert turning().length_m == pytest.approx(4.0)
