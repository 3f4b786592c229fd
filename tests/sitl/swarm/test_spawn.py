import numpy as np
import pytest

from sitl.swarm.settings import SwarmSettings
from sitl.swarm.spawn import cells, spawn
from sitl.worlds.primitives import World

NOTHING = World.of([])


@pytest.mark.parametrize(("vehicles", "count"), [(2, 9), (9, 9), (10, 16), (17, 25), (21, 25)])
def test_cells_are_a_square_about_the_middle_with_room_for_all(vehicles: int, count: int) -> None:
    grid = cells(vehicles, 1.6)
    assert grid.shape == (count, 2)
    np.testing.assert_allclose(grid.mean(axis=0), 0.0, atol=1e-12)
    gaps = np.linalg.norm(grid[:, None] - grid[None], axis=2)[np.triu_indices(count, 1)]
    assert gaps.min() == pytest.approx(1.6)


def test_everybody_gets_a_cell_of_his_own_and_the_leader_any_of_them() -> None:
    settings = SwarmSettings(followers=8)
    leaders = set()
    for seed in range(60):
        starts, yaws = spawn(settings, NOTHING, np.array([5.0, -3.0]), np.random.default_rng(seed))
        cell = np.round((starts[:, :2] - [5.0, -3.0]) / 1.6).astype(int)
        assert len({(int(x), int(y)) for x, y in cell}) == 9
        assert np.abs(starts[:, :2] - [5.0, -3.0] - 1.6 * cell).max() <= 0.1
        assert np.all(np.abs(yaws) <= np.pi)
        leaders.add((int(cell[0, 0]), int(cell[0, 1])))
    assert len(leaders) == 9


def test_nobody_starts_outside_the_altitudes_that_end_a_trial() -> None:
    settings = SwarmSettings(cruise_height_m=(0.6, 0.6), height_jitter_m=0.3)
    for seed in range(10):
        starts, _ = spawn(settings, NOTHING, np.zeros(2), np.random.default_rng(seed))
        assert starts[1:, 2].min() >= 0.7
