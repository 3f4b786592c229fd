import math

import numpy as np
import pytest

from companion.messages import Float32Array
from sitl.training import privileged_kernels as place
from sitl.training.privileged_kernels import disclose
from sitl.worlds.primitives import Cylinder, World

NOTHING = World.of(())
PILLAR = World.of([Cylinder(start_world_m=(2.0, 0.0, 0.0), end_world_m=(2.0, 0.0, 5.0), radius_m=0.5)])


def _state(
    x: float, y: float, z: float, v: tuple[float, float, float] = (0.0, 0.0, 0.0), yaw: float = 0.0
) -> list[float]:
    return [x, y, z, *v, math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)]


def _truth(states: list[list[float]], world: World = NOTHING, room: float = math.inf) -> Float32Array:
    out = np.full(place.PRIVILEGED_SIZE, np.nan, np.float32)
    every = np.arange(len(world.kinds), dtype=np.int32)
    disclose(
        1, np.array(states), room, 0.5, 15.0, world.kinds, world.rows, world.discs, every, len(every), out
    )  # fmt: skip
    return out


def test_the_leader_is_seen_from_the_own_heading() -> None:
    # Facing north, a leader in the east is on the right.
    truth = _truth([_state(5, 0, 2, (1.0, 0.0, 0.0)), _state(0, 0, 1.5, yaw=0.5 * math.pi)])
    np.testing.assert_allclose(truth[place.LEADER_P : place.LEADER_P + 3], [0.0, -1.0, 0.1], atol=1e-6)
    np.testing.assert_allclose(truth[place.LEADER_V : place.LEADER_V + 3], [0.0, -0.5, 0.0], atol=1e-6)


def test_others_are_told_nearest_first_with_how_fast_they_come() -> None:
    states = [_state(4, 0, 1), _state(0, 0, 1), _state(0, 2, 1, (0.0, -1.0, 0.0)), _state(-9, 0, 1)]
    rows = _truth(states)[place.OTHERS : place.MIDDLE].reshape(4, 4)
    np.testing.assert_allclose(rows[0], [0.0, 0.4, 0.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(rows[1], [0.8, 0.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(rows[2], [-1.8, 0.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_array_equal(rows[3], 0.0)


def test_the_middle_of_the_flock_the_height_the_time_and_the_size_are_told() -> None:
    truth = _truth([_state(4, 0, 1.5), _state(0, 0, 1.5), _state(2, 6, 1.5)])
    np.testing.assert_allclose(truth[place.MIDDLE : place.MIDDLE + 3], [0.4, 0.4, 0.0], atol=1e-6)
    assert truth[place.HEIGHT] == pytest.approx(-0.5)
    assert truth[place.TIME_LEFT] == pytest.approx(0.5)
    assert truth[place.SIZE] == pytest.approx(0.2)


def test_the_nearest_surface_is_told_with_its_direction() -> None:
    truth = _truth([_state(0, 9, 1), _state(0, 0, 1)], PILLAR, 1.5)
    np.testing.assert_allclose(truth[place.SURFACE : place.SURFACE + 3], [1.0, 0.0, 0.0], atol=1e-3)
    assert truth[place.ROOM] == pytest.approx(0.5)


def test_everything_is_told_and_finite_without_obstacles() -> None:
    truth = _truth([_state(0, 9, 1), _state(0, 0, 1)])
    assert np.isfinite(truth).all()
    np.testing.assert_array_equal(truth[place.SURFACE : place.ROOM + 1], 0.0)
