import numpy as np
import pytest

from companion.control.leader.obstacle_map import ClearanceField, ObstacleMap
from companion.control.leader.settings import ObstacleMapSettings
from tests.control.leader.flight import Pillars, odometry_at, scan_of

P = np.array([0.0, 0.0, 1.5])
PILLAR = Pillars(np.array([[4.0, 1.0]]), np.array([0.3]))
OPEN = Pillars(np.zeros((0, 2)), np.zeros(0))


def feed(
    obstacles: ObstacleMap, world: Pillars, p: np.ndarray = P, scans: int = 1, seed: int = 0
) -> ClearanceField:
    rng = np.random.default_rng(seed)
    for sequence in range(scans):
        scan = scan_of(world.returns(p, rng, 4000), odometry_at(sequence, p), sequence)
        obstacles.add(scan, p[2] - 0.5, p[2] + 0.5)
    return obstacles.field


def test_a_pillar_is_known_after_two_scans_where_it_stands() -> None:
    field = feed(ObstacleMap(ObstacleMapSettings()), PILLAR, scans=2)
    assert field.clearance(np.array([2.0, 1.0])) == pytest.approx(1.7, abs=0.2)
    assert field.clearance(np.array([3.75, 0.9])) < 0.2
    assert field.clearance(np.array([-4.0, 1.0])) == 3.0


def test_ground_and_own_body_are_no_obstacles() -> None:
    rng = np.random.default_rng(0)
    own = P + 0.3 * rng.uniform(-0.5, 0.5, (500, 3))
    ground = np.column_stack([rng.uniform(-8.0, 8.0, (5000, 2)), rng.normal(-0.15, 0.05, 5000)])
    obstacles = ObstacleMap(ObstacleMapSettings())
    low = np.array([0.0, 0.0, 0.3])
    for sequence in range(5):
        obstacles.add(scan_of(np.concatenate([own - P + low, ground]), odometry_at(sequence, low)), -0.2, 0.8)
    assert not obstacles.field.blocked.any()


def test_only_the_heights_to_be_flown_matter() -> None:
    rng = np.random.default_rng(0)
    crown = np.array([3.0, 0.0, 2.6]) + rng.uniform(-0.2, 0.2, (400, 3))
    obstacles = ObstacleMap(ObstacleMapSettings())
    obstacles.add(scan_of(crown, odometry_at(0, P)), 1.0, 2.0)
    assert not obstacles.field.blocked.any()
    obstacles.add(scan_of(crown, odometry_at(0, P)), 1.0, 3.0)
    assert obstacles.field.blocked.any()


def test_spurious_returns_block_nothing() -> None:
    rng = np.random.default_rng(3)
    obstacles = ObstacleMap(ObstacleMapSettings())
    for sequence in range(50):
        spurious = P + rng.uniform([-9.0, -9.0, -1.0], [9.0, 9.0, 2.0], (60, 3))
        points = np.concatenate([OPEN.returns(P, rng, 4000), spurious])
        obstacles.add(scan_of(points, odometry_at(sequence, P), sequence), 1.0, 2.0)
        assert np.count_nonzero(obstacles.field.blocked) <= 2


def test_what_moved_away_is_forgotten_once_seen_through() -> None:
    obstacles = ObstacleMap(ObstacleMapSettings())
    wall = Pillars(np.column_stack([np.full(60, 9.0), np.linspace(-6.0, 6.0, 60)]), np.full(60, 0.15))
    both = Pillars(np.concatenate([wall.centres, [[4.0, 0.0]]]), np.append(wall.radii, 0.3))
    there = np.array([3.0, 0.0])
    assert feed(obstacles, both, scans=40).clearance(there) < 1.0
    assert feed(obstacles, wall, scans=60, seed=1).clearance(there) == 3.0


def test_what_nothing_returns_behind_fades_and_what_is_hidden_stays() -> None:
    settings = ObstacleMapSettings(memory_scans=30)
    near, far = np.array([[2.0, 0.0]]), np.array([[6.0, 0.0]])
    obstacles = ObstacleMap(settings)
    assert feed(obstacles, Pillars(far, np.array([0.2])), scans=20).clearance(np.array([5.0, 0.0])) < 1.2
    hidden = feed(obstacles, Pillars(near, np.array([0.6])), scans=60, seed=1)
    assert hidden.clearance(np.array([5.0, 0.0])) < 1.2
    gone = feed(obstacles, OPEN, scans=60, seed=2)
    assert gone.clearance(np.array([5.0, 0.0])) == 3.0


def test_memory_slides_with_the_vehicle_and_stays_bounded() -> None:
    obstacles = ObstacleMap(ObstacleMapSettings())
    side = feed(obstacles, PILLAR, scans=5).blocked.shape
    p = P.copy()
    for sequence in range(40):
        p = p + np.array([0.5, 0.0, 0.0])
        obstacles.add(scan_of(np.zeros((0, 3)), odometry_at(sequence, p)), 1.0, 2.0)
        if sequence == 15:
            assert obstacles.field.clearance(np.array([4.0, 0.4])) < 0.6
    assert obstacles.field.blocked.shape == side
    assert not obstacles.field.blocked.any()
    feed(obstacles, PILLAR, P)
    assert obstacles.field.clearance(np.array([4.0, 0.4])) < 0.6


def test_a_scan_without_points_or_with_bad_ones_does_no_harm() -> None:
    obstacles = ObstacleMap(ObstacleMapSettings())
    for points in (
        np.zeros((0, 3)),
        np.full((100, 3), np.nan),
        np.full((100, 3), np.inf),
        np.full((9, 3), 1e30),
    ):
        obstacles.add(scan_of(points, odometry_at(0, P)), 1.0, 2.0)
        assert not obstacles.field.blocked.any()
    obstacles.add(scan_of(np.ones((10, 3)), odometry_at(0, np.full(3, np.nan))), 1.0, 2.0)
    assert np.all(np.isfinite(obstacles.field.distance))
