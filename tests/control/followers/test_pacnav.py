import numpy as np
import pytest

from companion.control.followers.layout_kernels import (
    MEMORY_SIZE,
    PACNAV_PATH_SIZE,
    PACNAV_PATHS,
    PACNAV_POSITIONS,
    PACNAV_SAMPLES,
    PACNAV_TARGET,
)
from companion.control.followers.pacnav_path_kernels import persistence, similarity
from companion.control.followers.settings import FollowerSettings, with_gains
from companion.messages import FloatArray
from tests.control.followers.oracles import Shared
from tests.control.followers.pacnav_oracle import Pacnav
from tests.control.followers.situations import Follower, column, drawn, free, others, own


def with_paths(*paths: list[tuple[float, float]], first_beat: int = 0) -> FloatArray:
    """Return a memory in which these paths were sampled on beats that ended together."""
    memory = np.zeros(MEMORY_SIZE)
    longest = max(len(path) for path in paths)
    for number, path in enumerate(paths):
        at = PACNAV_PATHS + number * PACNAV_PATH_SIZE
        first = first_beat + longest - len(path)
        memory[at : at + 3] = number + 1.0, first, first + len(path) - 1
        for offset, position in enumerate(path):
            place = at + PACNAV_POSITIONS + 2 * ((first + offset) % PACNAV_SAMPLES)
            memory[place : place + 2] = position
    return memory


def test_a_path_that_bends_twice_has_the_known_persistence() -> None:
    memory = with_paths([(0.0, 0.0), (1.0, 0.0), (2.0, 2.0), (2.0, 4.0)])
    assert persistence(memory, 0, 0.0) == pytest.approx(3.0 / (2.0 * np.sqrt(5.0)))


def test_a_straight_path_has_persistence_one_also_where_the_memory_wraps() -> None:
    path = [(0.5 * k, 1.0 - 0.2 * k) for k in range(20)]
    assert persistence(with_paths(path, first_beat=17), 0, 0.0) == pytest.approx(1.0)


def test_two_short_paths_at_45_degrees_are_similar_by_the_cosine_and_not_persistent() -> None:
    memory = with_paths([(0.0, 0.0), (1.0, 0.0)], [(5.0, 5.0), (6.0, 6.0)])
    assert similarity(memory, 0, 1, 0.0) == pytest.approx(1.0 / np.sqrt(2.0))
    assert persistence(memory, 0, 0.0) == persistence(memory, 1, 0.0) == -1.0


def test_similarity_compares_steps_of_the_same_time_only() -> None:
    long = [(0.0, 0.0), (0.0, 1.0), (0.0, 2.0), (1.0, 2.0), (2.0, 2.0)]
    memory = with_paths(long, [(9.0, 0.0), (10.0, 0.0), (11.0, 0.0)])
    assert similarity(memory, 0, 1, 0.0) == pytest.approx(1.0)


def test_standing_still_is_neither_persistent_nor_similar() -> None:
    memory = with_paths([(1.0, 1.0)] * 5, [(0.0, float(k)) for k in range(5)])
    assert persistence(memory, 0, 0.0) == 0.0
    assert similarity(memory, 0, 1, 0.0) == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_it_agrees_with_its_oracle_on_random_flights(seed: int) -> None:
    """Neighbours with lasting numbers fly about, come into view and go out of it."""
    rng = np.random.default_rng(seed)
    settings = FollowerSettings()
    follower, oracle, shared = (
        Follower("pacnav"),
        Pacnav(settings.pacnav, settings.command),
        Shared(settings.command),
    )
    p = rng.uniform(-6.0, 6.0, (6, 3)) * [1.0, 1.0, 0.05]
    v = rng.uniform(-1.0, 1.0, (6, 3)) * [1.0, 1.0, 0.05]
    in_view = rng.random(6) < 0.8
    own_p = np.array([0.3, -0.2, 1.5])
    for _ in range(300):
        _, _, ranges = drawn(rng)
        v += rng.normal(0.0, 0.1, (6, 3)) * [1.0, 1.0, 0.05]
        p += 0.05 * v
        in_view ^= rng.random(6) < 0.02
        own_p[:2] += rng.normal(0.0, 0.02, 2)
        ego = own(p=tuple(own_p), yaw=0.4)
        relative = p + np.array([0.0, 0.0, 1.5]) - own_p
        turn = np.array([[np.cos(0.4), np.sin(0.4)], [-np.sin(0.4), np.cos(0.4)]])
        relative[:, :2] = relative[:, :2] @ turn.T
        seen = sorted(np.flatnonzero(in_view), key=lambda j: float(np.linalg.norm(relative[j])))
        rows = others(*[(*relative[j], 0.0, 0.0, 0.0) for j in seen])
        rows[: len(seen), 7] = seen
        wish = np.append(oracle(ego, rows, ranges, shared.previous_map), shared.height(ego, rows))
        assert follower.steer(ego, rows, ranges) == pytest.approx(shared.finish(ego, wish), abs=1e-8)
        target = follower.memory[PACNAV_TARGET]
        assert (None if target == 0.0 else int(target) - 1) == oracle.target


def watching(settle_s: float = 0.0) -> Follower:
    return Follower("pacnav", with_gains(FollowerSettings(), "pacnav", {"settle_s": settle_s}))


def test_steps_that_noise_explains_do_not_count() -> None:
    memory = with_paths([(0.0, 0.0), (0.05, 0.0), (1.05, 0.0), (2.05, 0.0)])
    assert persistence(memory, 0, 0.0) == pytest.approx(1.0)
    assert persistence(memory, 0, 0.06) == pytest.approx(0.5)


def test_nobody_is_followed_before_there_was_time_to_watch() -> None:
    follower = watching(settle_s=1.0)
    for _ in range(19):
        v = follower.steer(own(), others((4.0, 0.0, 0.0)))
        assert v[:2].tolist() == [0.0, 0.0]
    assert follower.steer(own(), others((4.0, 0.0, 0.0)))[0] > 0.0


def test_one_who_went_out_of_sight_is_still_kept_clear_of_for_a_while() -> None:
    follower = watching(settle_s=20.0)
    beside = others((0.8, 0.0, 0.0))
    seen = [follower.steer(own(), beside) for _ in range(20)][-1]
    assert seen[0] < -0.1
    for _ in range(19):
        assert follower.steer(own(), others())[:2] == pytest.approx(seen[:2])
    for _ in range(10):
        gone = follower.steer(own(), others())
    assert gone[:2].tolist() == [0.0, 0.0]


def test_the_first_target_is_the_nearest_outside_the_flock_radius_and_it_sticks() -> None:
    follower = watching()
    rows = others((1.0, 0.0, 0.0), (3.0, 1.0, 0.0), (5.0, 0.0, 0.0))
    follower.steer(own(), rows)
    assert follower.memory[PACNAV_TARGET] == rows[1, 7] + 1.0
    follower.steer(own(), others((1.0, 0.0, 0.0), (6.0, 1.0, 0.0), (5.0, 0.0, 0.0)))
    assert follower.memory[PACNAV_TARGET] == rows[1, 7] + 1.0


def test_it_changes_to_somebody_who_flies_straight_away() -> None:
    rng = np.random.default_rng(1)
    follower = Follower("pacnav")
    for step in range(100):
        restless = (2.0 + 0.05 * rng.normal(), -1.0 + 0.05 * rng.normal(), 0.0)
        leading = (2.0 + 0.05 * step, 2.0, 0.0)
        rows = others(restless, leading)
        follower.steer(own(), rows)
    assert follower.memory[PACNAV_TARGET] == rows[1, 7] + 1.0


def test_a_target_out_of_sight_is_still_flown_to_for_a_second() -> None:
    follower = watching()
    for _ in range(40):
        there = follower.steer(own(), others((4.0, 0.0, 0.0)))
    assert there[0] == pytest.approx(1.7)
    for _ in range(19):
        assert follower.steer(own(), others())[0] == pytest.approx(1.7)
    for _ in range(40):
        gone = follower.steer(own(), others())
    assert gone[:2].tolist() == [0.0, 0.0]


def test_collision_forces_turn_from_along_to_away_as_it_gets_near() -> None:
    """Standing, the force is straight away; flying, it is turned towards the flight."""
    follower = Follower("pacnav")
    gap, reach = 0.5, 2.1
    size = 1.5 * (1.0 / np.sqrt(gap) - 1.0 / np.sqrt(reach))
    v = follower.steer(own(dt=10.0), others(), column(free(), 0.0, gap + 0.4))
    assert v[:2] == pytest.approx(-size * np.array([np.cos(np.radians(2.5)), np.sin(np.radians(2.5))]))
    follower.memory[1:3] = 0.0, 1.0
    v = follower.steer(own(dt=10.0), others(), column(free(), 0.0, gap + 0.4))
    turn = np.arctan2(v[1], v[0]) - np.radians(182.5)
    assert (turn + np.pi) % (2.0 * np.pi) - np.pi == pytest.approx(-0.5 * np.pi * gap / reach)
    assert np.linalg.norm(v[:2]) == pytest.approx(size)


def test_obstacles_are_kept_clear_of_from_farther_away_than_neighbours() -> None:
    follower = watching(settle_s=20.0)
    assert follower.steer(own(), others((2.3, 0.0, 0.0)))[:2].tolist() == [0.0, 0.0]
    assert follower.steer(own(), others(), column(free(), 0.0, 2.3))[0] < 0.0
    assert watching(settle_s=20.0).steer(own(), others(), column(free(), 0.0, 2.6))[:2].tolist() == [0.0, 0.0]
