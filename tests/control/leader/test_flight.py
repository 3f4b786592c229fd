import numpy as np
import pytest

from companion.control.leader.settings import LeaderSettings
from tests.control.leader.fields import wall
from tests.control.leader.flight import Flight, Pillars, fly, mission_to, pillar_field

OPEN = Pillars(np.zeros((0, 2)), np.zeros(0))
RADIUS = LeaderSettings().vehicle_radius_m


def through_pillars(
    seed: int, gap_m: float, speed_mps: float, spurious: int = 0
) -> tuple[Flight, np.ndarray]:
    rng = np.random.default_rng([seed, 0])
    bearing = rng.uniform(-np.pi, np.pi)
    goal = np.array([30.0 * np.cos(bearing), 30.0 * np.sin(bearing), 1.5])
    world = pillar_field(rng, gap_m, goal, extent_m=8.0, tries=500)
    settings = mission_to((goal[0], goal[1], goal[2]), speed_mps=speed_mps)
    flight = fly(settings, world, seed, limit_s=60.0 / speed_mps + 20.0, rays=1500, spurious=spurious)
    return flight, goal


def walls(*corners: tuple[float, float]) -> Pillars:
    centres = wall(*corners)
    return Pillars(centres, np.full(len(centres), 0.12))


def closed(*pieces: Pillars) -> Pillars:
    return Pillars(np.concatenate([p.centres for p in pieces]), np.concatenate([p.radii for p in pieces]))


@pytest.mark.parametrize("seed", range(20))
def test_pillars_five_metres_apart_are_passed_with_half_a_metre_to_spare(seed: int) -> None:
    flight, goal = through_pillars(seed, 5.0, 1.0)
    assert flight.finished
    assert flight.least_distance_m - RADIUS > 0.5
    assert np.linalg.norm(flight.track[-1] - goal) < 0.5
    assert flight.time_s < 45.0


@pytest.mark.parametrize("seed", range(3))
def test_pillars_are_passed_at_two_metres_a_second(seed: int) -> None:
    flight, _ = through_pillars(100 + seed, 5.0, 2.0)
    assert flight.finished
    assert flight.least_distance_m - RADIUS > 0.5
    assert flight.time_s < 30.0


def test_spurious_returns_change_little() -> None:
    flight, _ = through_pillars(7, 5.0, 1.0, spurious=40)
    assert flight.finished
    assert flight.least_distance_m - RADIUS > 0.5
    assert flight.time_s < 45.0


@pytest.mark.parametrize("seed", range(2))
def test_a_pillar_dead_ahead_is_passed(seed: int) -> None:
    world = Pillars(np.array([[6.0, 0.0]]), np.array([0.4]))
    flight = fly(mission_to((12.0, 0.0, 1.5)), world, seed, 40.0, rays=1500)
    assert flight.finished
    assert flight.least_distance_m - RADIUS > 0.5
    assert flight.time_s < 22.0


@pytest.mark.parametrize(("half_width", "depth"), [(2.0, 4.0), (4.0, 7.0)])
def test_a_dead_end_is_left_again(half_width: float, depth: float) -> None:
    mouth, end = 8.0 - depth, 8.0
    trap = walls((mouth, -half_width), (end, -half_width), (end, half_width), (mouth, half_width))
    flight = fly(mission_to((16.0, 0.0, 1.5)), trap, 0, 60.0, rays=1500)
    assert flight.finished
    assert flight.least_distance_m - RADIUS > 0.3


def test_a_wall_wider_than_the_horizon_is_flown_round() -> None:
    flight = fly(mission_to((12.0, 0.0, 1.5)), walls((6.0, -8.0), (6.0, 8.0)), 0, 90.0, rays=1500)
    assert flight.finished
    assert flight.least_distance_m - RADIUS > 0.3


def test_a_narrow_gate_is_flown_through() -> None:
    gate = closed(walls((6.0, -12.0), (6.0, -1.0)), walls((6.0, 1.0), (6.0, 12.0)))
    flight = fly(mission_to((12.0, 0.0, 1.5)), gate, 0, 40.0, rays=1500)
    assert flight.finished
    assert flight.least_distance_m - RADIUS > 0.25
    assert max(abs(p[1]) for p in flight.track) < 3.0


def test_between_two_walls_it_does_not_swing() -> None:
    corridor = closed(walls((-3.0, -1.25), (11.0, -1.25)), walls((-3.0, 1.25), (11.0, 1.25)))
    corridor = closed(corridor, walls((-3.0, -1.25), (-3.0, 1.25)))
    flight = fly(mission_to((10.0, 0.0, 1.5)), corridor, 0, 40.0, rays=1500)
    assert flight.finished
    assert flight.time_s < 22.0
    assert max(abs(p[1]) for p in flight.track) < 0.35


@pytest.mark.parametrize("beside", [0.3, 0.7])
def test_a_goal_near_a_pillar_is_reached(beside: float) -> None:
    world = Pillars(np.array([[8.0, 0.0]]), np.array([0.4]))
    goal = (8.0, 0.4 + RADIUS + beside, 1.5)
    flight = fly(mission_to(goal), world, 0, 40.0, rays=1500)
    assert flight.finished
    assert flight.least_distance_m > RADIUS
    assert np.linalg.norm(flight.track[-1] - np.array(goal)) < 0.5


def test_a_goal_inside_a_pillar_ends_beside_it() -> None:
    world = Pillars(np.array([[8.0, 0.0]]), np.array([0.5]))
    flight = fly(mission_to((8.0, 0.0, 1.5)), world, 0, 40.0, rays=1500)
    assert flight.finished
    assert flight.least_distance_m > RADIUS
    assert np.hypot(*(flight.track[-1][:2] - [8.0, 0.0])) < 1.8


def test_a_closed_room_is_not_left_and_nothing_is_touched() -> None:
    room = walls((-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0), (-4.0, -4.0))
    flight = fly(mission_to((12.0, 0.0, 1.5)), room, 0, 6.0, rays=1500)
    assert not flight.finished
    assert flight.plans[-1].status == "no path"
    assert flight.least_distance_m > 1.0
    assert np.linalg.norm(flight.commands[-1]) < 0.01


def test_waypoints_are_visited_in_order_and_the_last_is_held() -> None:
    square = [(6.0, 0.0, 1.5), (6.0, 6.0, 2.0), (0.0, 6.0, 1.5), (0.0, 0.0, 1.5)]
    flight = fly(mission_to(*square), OPEN, 0, 60.0, rays=300)
    assert flight.finished
    track = np.array(flight.track)
    passed = [int(np.linalg.norm(track - np.array(p), axis=1)[200:].argmin()) for p in square]
    assert passed == sorted(passed)
    for p, tick in zip(square, passed, strict=True):
        assert np.linalg.norm(track[200 + tick] - np.array(p)) < 0.55
    assert [plan.waypoint for plan in flight.plans] == sorted(plan.waypoint for plan in flight.plans)
    assert flight.plans[-1].status == "arrived"
    assert np.linalg.norm(np.diff(track[-25:], axis=0), axis=1).max() < 0.15 * 0.02


def test_without_any_return_it_flies_straight() -> None:
    class Nothing(Pillars):
        def returns(self, *_: object, **__: object) -> np.ndarray:
            return np.zeros((0, 3))

    flight = fly(mission_to((8.0, 0.0, 1.5)), Nothing(np.zeros((0, 2)), np.zeros(0)), 0, 30.0)
    assert flight.finished
    assert max(abs(p[1]) for p in flight.track) < 0.2


def test_without_waypoints_the_place_is_held_and_the_mission_ends() -> None:
    flight = fly(LeaderSettings(), OPEN, 0, 10.0, rays=300)
    assert flight.finished
    assert np.linalg.norm(flight.track[-1] - np.array([0.0, 0.0, 1.5])) < 0.2


def test_equal_seeds_give_equal_flights() -> None:
    world = pillar_field(np.random.default_rng(9), 5.0, np.array([12.0, 3.0, 1.5]), extent_m=5.0, tries=200)
    commands = [
        np.array(fly(mission_to((12.0, 3.0, 1.5)), world, seed, 10.0, rays=800).commands).tobytes()
        for seed in (3, 3, 4)
    ]
    assert commands[0] == commands[1]
    assert commands[0] != commands[2]
