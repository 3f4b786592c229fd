import numpy as np
import pytest

from companion.control.leader import field_kernels
from companion.control.leader.potential_field import CommandFilter, PotentialField
from companion.control.leader.settings import PotentialFieldSettings
from tests.control.leader import oracles
from tests.control.leader.fields import CELL, SIDE, field_of, wall

OPEN = field_of(np.zeros((0, 2)), 0.3)
ORIGIN = np.zeros(2)


def velocity(
    discs: np.ndarray, ahead: tuple[float, float] = (1.5, 0.0), goal_distance: float = 10.0, **more: object
) -> np.ndarray:
    settings = PotentialFieldSettings()
    beyond = np.array(more.get("beyond", (4.5, 0.0)))
    return PotentialField(settings, 0.3).velocity(
        field_of(discs, 0.3), ORIGIN, np.array(ahead), beyond, 1.0, goal_distance, bool(more.get("is_open"))
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_obstacles_equal_the_oracle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    blocked = (rng.random((SIDE, SIDE)) < 0.05).astype(np.uint8)
    surface = rng.uniform(-0.1, 0.1, (SIDE, SIDE, 2)).astype(np.float32)
    first = np.array([-30, 17, 4], np.int64)
    p = (first[:2] + SIDE // 2) * CELL + rng.uniform(-1.0, 1.0, 2)
    sectors = np.zeros((24, 3))
    field_kernels.find_nearest(blocked, surface, first, CELL, p[0], p[1], 2.3, sectors)
    cells = first[:2] + np.argwhere(blocked)
    points = (cells + 0.5) * CELL + surface[cells[:, 0] % SIDE, cells[:, 1] % SIDE]
    assert np.allclose(sectors, oracles.nearest_per_sector(points, p, 2.3, 24), atol=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_the_repulsion_equals_the_oracle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = (np.arange(24) + rng.random(24)) * 2.0 * np.pi / 24
    ranges = np.where(rng.random(24) < 0.5, np.inf, rng.uniform(0.0, 3.0, 24))
    sectors = np.column_stack([np.cos(angles), np.sin(angles), ranges])
    expected = oracles.repulsion_of(sectors, 0.3, 0.3, 2.0, 1.5)
    assert np.allclose(field_kernels.repulsion(sectors, 0.3, 0.3, 2.0, 1.5), expected)
    assert np.hypot(*expected) <= 1.5 + 1e-12


def test_one_sector_repels_with_the_documented_strength() -> None:
    sectors = np.zeros((24, 3))
    sectors[:, 2] = np.inf
    sectors[0] = [1.0, 0.0, 1.3]
    expected = -0.3 * (1.0 / 1.0 - 1.0 / 2.0) / 1.0**2
    assert field_kernels.repulsion(sectors, 0.3, 0.3, 2.0, 1.5) == pytest.approx((expected, 0.0))


def test_in_the_open_the_velocity_points_ahead_at_full_speed() -> None:
    assert velocity(np.zeros((0, 2))) == pytest.approx([1.0, 0.0])
    assert velocity(np.zeros((0, 2)), ahead=(0.0, -0.2)) == pytest.approx([0.0, -1.0])


def test_at_the_point_ahead_the_velocity_is_zero_and_finite() -> None:
    assert velocity(np.zeros((0, 2)), ahead=(0.0, 0.0)) == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize("x", [0.0, 1e-9, 0.05, 0.3, 0.5])
def test_contact_with_an_obstacle_gives_a_finite_velocity(x: float) -> None:
    v = velocity(np.array([[x, 0.0]]))
    assert np.all(np.isfinite(v))
    assert np.hypot(*v) <= 1.0 + 1e-12


def test_an_obstacle_beside_the_path_pushes_away() -> None:
    v = velocity(np.array([[0.5, 1.2]]))
    assert v[1] < -0.1
    assert v[0] > 0.3


def test_a_pillar_dead_ahead_is_passed_on_the_side_of_the_path() -> None:
    pillar = np.array([[1.0, 0.0]])
    left = velocity(pillar, beyond=(4.0, 1.0))
    right = velocity(pillar, beyond=(4.0, -1.0))
    assert left[1] > 0.3
    assert right[1] < -0.3
    assert abs(velocity(pillar)[1]) > 0.3


def test_the_side_does_not_flicker_while_escaping() -> None:
    field, law = field_of(np.array([[1.0, 0.0]]), 0.3), PotentialField(PotentialFieldSettings(), 0.3)
    ahead = np.array([1.5, 0.0])
    sides = [
        law.velocity(field, ORIGIN, ahead, np.array([4.0, wobble]), 1.0, 10.0, False)[1]
        for wobble in (0.1, -0.1, -0.1, 0.1)
    ]
    assert min(sides) > 0.0


def test_a_gate_that_is_open_does_not_stop_the_vehicle() -> None:
    gate = np.concatenate([wall((0.7, 1.0), (0.7, 5.0)), wall((0.7, -5.0), (0.7, -1.0))])
    assert velocity(gate, is_open=True)[0] >= 0.5 - 1e-9


def test_between_two_walls_the_force_leads_gently_to_the_middle() -> None:
    corridor = np.concatenate([wall((-4.0, 1.55), (4.0, 1.55)), wall((-4.0, -1.55), (4.0, -1.55))])
    law = PotentialField(PotentialFieldSettings(), 0.3)
    field = field_of(corridor, 0.3)
    offsets = np.array([-0.2, -0.1, 0.0, 0.1, 0.2])
    drift = [
        law.velocity(field, np.array([0.0, y]), np.array([1.5, y]), np.array([4.0, y]), 1.0, 10.0, True)[1]
        for y in offsets
    ]
    assert abs(drift[2]) < 0.05
    assert drift[0] > drift[2] > drift[4]
    # A velocity loop that needs about a second follows no steeper law than some 1/s without swinging.
    assert -4.0 < np.polyfit(offsets, drift, 1)[0] < -0.3


def test_near_the_goal_an_obstacle_does_not_hold_the_vehicle_off() -> None:
    behind_goal = np.array([[0.9, 0.0]])
    assert velocity(behind_goal, ahead=(0.1, 0.0), goal_distance=0.1)[0] > 0.5


def test_speed_follows_the_room() -> None:
    field = field_of(np.array([[2.0, 0.0]]), 0.3)
    law = PotentialField(PotentialFieldSettings(), 0.3)
    wide, tight = np.array([-1.0, 0.0]), np.array([1.35, 0.0])
    assert law.speed_limit(field, wide, wide) > 3.0
    assert law.speed_limit(field, wide, tight) == pytest.approx(0.3)
    assert law.speed_limit(field, np.array([0.7, 0.0]), wide) == pytest.approx(1.5 * 0.7, abs=0.1)


def test_the_filter_limits_the_acceleration_and_settles() -> None:
    smooth = CommandFilter(0.25)
    target = np.array([2.0, 0.0, 0.0])
    previous = np.zeros(3)
    for _ in range(200):
        present = smooth.step(target, 0.02, 1.5)
        assert np.linalg.norm(present - previous) <= 1.5 * 0.02 + 1e-12
        previous = present
    assert previous == pytest.approx(target, abs=1e-3)
    smooth.reset()
    assert smooth.step(target, 0.0, 1.5) == pytest.approx(np.zeros(3))


def test_the_filter_is_first_order_below_the_limit() -> None:
    smooth = CommandFilter(0.25)
    for _ in range(25):
        present = smooth.step(np.array([0.1, 0.0, 0.0]), 0.01, 1.5)
    assert present[0] == pytest.approx(0.1 * (1.0 - np.exp(-1.0)))
    assert CommandFilter(0.0).step(np.array([0.01, 0.0, 0.0]), 0.02, 1.5) == pytest.approx([0.01, 0.0, 0.0])
