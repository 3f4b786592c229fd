import numpy as np
import pytest

from companion.perception.tracking import region_kernels
from companion.perception.tracking.motion_filter import Agility, MotionFilter
from companion.perception.tracking.settings import Tape, TrackingSettings
from companion.perception.tracking.tracker import NeighbourTracker
from companion.perception.tracking.validation import Proof, Surroundings
from tests.perception.tracking.bodies import SENSOR, Thing, Uav, scan

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
SETTINGS = TrackingSettings()


def standing() -> MotionFilter:
    return MotionFilter(np.array([4.0, 0.0, 1.5]), 1e-4 * np.eye(3), 0.1, Agility(0.5, 0.5, 1.0, 0.01))


def counts(body: float = 8.0, below: float = 0.0, beside: float = 0.0) -> np.ndarray:
    row = np.zeros(region_kernels.SURROUNDINGS_WIDTH)
    row[region_kernels.BODY], row[region_kernels.BELOW], row[region_kernels.BESIDE] = body, below, beside
    return row


def proof(settings: TrackingSettings = SETTINGS) -> tuple[Proof, MotionFilter]:
    motion = standing()
    return Proof(settings, motion), motion


def test_brightness_alone_proves_nothing_and_free_space_below_does() -> None:
    mine, motion = proof()
    for _ in range(20):
        mine.look_around(counts(), 0.0, False)
        mine.judge(10, 4, motion)
    assert not mine.validated
    for _ in range(3):
        mine.look_around(counts(), 1.5, False)
        mine.judge(10, 4, motion)
    assert mine.validated


def test_a_foot_that_shows_later_takes_the_proof_back() -> None:
    mine, motion = proof()
    for _ in range(5):
        mine.look_around(counts(), 1.5, False)
        mine.judge(10, 4, motion)
    assert mine.validated
    for _ in range(6):
        mine.look_around(counts(below=3.0), 1.5, False)
        mine.judge(10, 4, motion)
    assert not mine.validated


def test_what_is_all_tape_is_a_plate() -> None:
    mine, motion = proof()
    for _ in range(20):
        mine.look_around(counts(), 1.5, False)
        mine.judge(10, 10, motion)
    assert not mine.validated


@pytest.mark.parametrize(("whole", "proven"), [(True, 20), (False, 60)])
def test_a_uav_without_tape_in_view_stays_proven_for_a_while_and_longer_if_seen_in_part(
    whole: bool, proven: int
) -> None:
    mine, motion = proof()
    for _ in range(5):
        mine.look_around(counts(), 1.5, False)
        mine.judge(10, 4, motion)
    states = []
    for _ in range(90):
        mine.look_around(counts(), 1.5 if whole else 0.0, False)
        mine.judge(10, 0, motion, whole=whole)
        states.append(mine.validated)
    assert all(states[:proven])
    # The remembered share of bright points takes a second or so to fade.
    assert not any(states[proven + 20 :])


def test_what_is_seen_well_and_stands_alone_needs_no_visible_foot() -> None:
    mine, motion = proof()
    for _ in range(10):
        mine.look_around(counts(body=40.0), 0.0, True)
        mine.judge(40, 15, motion)
    assert mine.validated


def test_a_foot_is_expected_only_where_the_sensor_looks() -> None:
    surroundings = Surroundings(SETTINGS, LEVEL)
    places = SENSOR + np.array([[6.0, 0.0, 0.5], [6.0, 0.0, -0.3], [1.0, 0.0, 0.0], [12.0, 0.0, 1.0]])
    far, low, near, farther = surroundings.expected_foot(places, SENSOR, LEVEL)
    assert far > 1.0
    assert low < 0.5 * far
    assert near == 0.0
    assert 0.2 * far < farther < 0.3 * far
    assert surroundings.cut_off(places, SENSOR, LEVEL).tolist() == [False, False, True, False]


def untaped(things: list[Thing], scans: int) -> list[list[np.ndarray]]:
    tracker = NeighbourTracker(TrackingSettings(tape=Tape.NONE))
    rng = np.random.default_rng(1)
    results = [tracker.observe(scan(k, things, rng)) for k in range(1, scans + 1)]
    return [[track.p_map for track in tracks.tracks if track.validated] for tracks in results]


def test_without_tape_a_uav_is_found_once_it_moves_and_not_before() -> None:
    moving = Uav((3.5, -2.0, 1.9), (0.0, 0.8, 0.0), bright_share=0.0)
    found = untaped([moving, Uav((-3.0, 1.0, 1.9), bright_share=0.0)], 40)
    assert all(len(places) == 1 for places in found[20:])
    assert np.linalg.norm(found[-1][0] - moving.at(4.0)) < 0.2
