"""When a swarm's trial begins, when it is over, and what it is called."""

import numpy as np
import pytest
from numpy.typing import ArrayLike

from companion.clock import seconds_to_ns
from companion.messages import FlightState
from sitl.dynamics import STEP_NS
from sitl.swarm.referee import PREPARATION_S, SwarmReferee, TrialNames
from sitl.swarm.settings import TerminationSettings
from sitl.swarm.table import (
    COLLISIONS,
    LEADER_SEEN_S,
    MISSION_OVER,
    READY,
    STATE,
    STATE_NUMBERS,
    WIDTH,
    P,
    Q,
    Table,
)
from tests.sitl.swarm.small_swarm import scene

BOOT_NS = 1_000_000_000
NAMES = TrialNames("small", "flock")


class Trial:
    """Three vehicles as the referee sees them."""

    def __init__(self) -> None:
        self.scene = scene(vehicles=3)
        self.referee = SwarmReferee(self.scene, TerminationSettings(), 4.0, BOOT_NS)
        self.t_ns = BOOT_NS
        self.rows = np.zeros((3, WIDTH))
        self.rows[:, P] = self.scene.starts_world
        self.rows[:, Q] = [1.0, 0.0, 0.0, 0.0]
        self.put(FlightState.READY)
        self._last = Table(self.rows.copy())

    def put(self, state: FlightState, *numbers: int) -> None:
        for number in numbers or range(len(self.rows)):
            self.rows[number, STATE] = STATE_NUMBERS[state]

    def move(self, number: int, p_world: ArrayLike) -> None:
        self.rows[number, P] = np.asarray(p_world)

    def step(self, seconds: float = 0.005, *, seen: bool = True) -> SwarmReferee:
        """Let time pass; nobody moves after the first step."""
        for _ in range(round(seconds / 0.005)):
            self.t_ns += STEP_NS
            if seen:
                self.rows[1, LEADER_SEEN_S] = self.t_ns * 1e-9
            now = Table(self.rows.copy())
            if not self.referee.over:
                self.referee.watch(self.t_ns, self._last, now)
            self._last = now
        return self.referee

    def start(self) -> None:
        self.rows[:, READY] = 1.0
        self.step()
        self.put(FlightState.ACTIVE)
        self.step()

    def fly_to_goal(self) -> None:
        goal = self.scene.waypoints_world[-1]
        for x in np.arange(0.0, goal[0] - 0.2, 0.05):
            for k in range(3):
                self.move(k, self.scene.starts_world[k] + [x, 0.0, 0.0])
            self.step()


def test_all_are_authorised_when_the_last_one_is_ready() -> None:
    trial = Trial()
    trial.rows[:2, READY] = 1.0
    assert not trial.step().start_given
    trial.rows[2, READY] = 1.0
    assert trial.step().start_given
    trial.rows[:, READY] = 0.0
    assert trial.step().start_given


def test_the_clock_starts_when_all_companions_are_in_control() -> None:
    trial = Trial()
    trial.put(FlightState.ACTIVE, 0, 1)
    assert trial.step(1.0).started_ns is None
    trial.put(FlightState.ACTIVE)
    assert trial.step().started_ns == trial.t_ns
    assert trial.step(0.5).trial_s == pytest.approx(0.5)


def test_a_companion_that_never_engages_ends_the_trial_before_it_began() -> None:
    trial = Trial()
    trial.put(FlightState.ACTIVE, 0, 2)
    record = trial.step(PREPARATION_S + 0.1).record(NAMES)
    assert (record.end, record.ended_by, record.t_end_s) == ("failsafe", (1,), 0.0)
    assert np.isnan(record.flock_radius_m)
    assert record.mission_progress_percent == 0.0


def test_success_is_judged_when_the_pause_at_the_goal_ends() -> None:
    trial = Trial()
    trial.start()
    trial.fly_to_goal()
    trial.step(0.6)
    assert not trial.referee.over
    trial.rows[0, MISSION_OVER] = 1.0
    trial.step()
    record = trial.referee.record(NAMES)
    assert record.end == "success"
    assert record.mission_progress_percent == 100.0
    assert record.minimum_separation_m == pytest.approx(1.6)
    assert record.flock_radius_m == pytest.approx(1.6)
    assert 0.0 < record.obstacle_distance_m < 4.0
    assert record.steps == pytest.approx(record.t_end_s / 0.05, abs=1.0)


def test_a_follower_left_behind_makes_the_swarm_scattered() -> None:
    trial = Trial()
    trial.start()
    trial.fly_to_goal()
    trial.move(2, [-4.0, 0.0, 1.5])
    trial.rows[0, MISSION_OVER] = 1.0
    record = trial.step(0.6).record(NAMES)
    assert (record.end, record.ended_by) == ("scattered", (2,))
    assert record.mission_progress_percent < 100.0


def test_a_leader_that_ends_its_mission_elsewhere_has_not_arrived() -> None:
    trial = Trial()
    trial.start()
    trial.fly_to_goal()
    trial.move(0, trial.scene.waypoints_world[-1] - [1.1, 0.0, 0.0])
    trial.rows[0, MISSION_OVER] = 1.0
    record = trial.step().record(NAMES)
    assert (record.end, record.ended_by) == ("timeout", (0,))


@pytest.mark.parametrize(
    ("pair", "end"), [((1, 2), "uav_uav"), ((0, 1), "leader_follower")], ids=["followers", "leader"]
)
def test_two_vehicles_that_pass_through_each_other_within_a_step_collide(
    pair: tuple[int, int], end: str
) -> None:
    trial = Trial()
    trial.start()
    first, second = pair
    middle = trial.rows[first, P] + [0.0, 0.42, 0.0]
    trial.move(second, middle)
    assert not trial.step().over
    trial.move(second, middle - [0.0, 0.84, 0.0])
    record = trial.step().record(NAMES)
    assert (record.end, record.ended_by) == (end, pair)


def test_contact_with_an_obstacle_ends_the_trial_even_before_its_start() -> None:
    trial = Trial()
    trial.rows[2, COLLISIONS] = 1.0
    record = trial.step().record(NAMES)
    assert (record.end, record.ended_by, record.t_end_s) == ("obstacle", (2,), 0.0)


@pytest.mark.parametrize("height", [0.45, 3.55])
def test_flying_too_low_or_too_high_ends_the_trial(height: float) -> None:
    trial = Trial()
    trial.start()
    trial.move(1, [-1.6, 0.0, height])
    assert trial.step().record(NAMES).end == "altitude"


def test_the_leader_is_lost_when_no_follower_has_known_it_for_half_a_second() -> None:
    trial = Trial()
    trial.start()
    trial.step(1.0)
    assert not trial.step(0.5, seen=False).over
    assert trial.step(0.05, seen=False).record(NAMES).end == "leader_lost"


def test_a_companion_that_gives_up_ends_the_trial_and_one_that_brakes_does_not() -> None:
    trial = Trial()
    trial.start()
    trial.put(FlightState.HOLDING, 1)
    assert not trial.step(0.2).over
    trial.put(FlightState.LOST, 1)
    record = trial.step().record(NAMES)
    assert (record.end, record.ended_by) == ("failsafe", (1,))


def test_time_is_up_when_the_leader_does_not_arrive() -> None:
    trial = Trial()
    trial.start()
    record = trial.step(trial.scene.timeout_s + 0.1).record(NAMES)
    assert record.end == "timeout"
    assert record.t_end_s == pytest.approx(trial.scene.timeout_s, abs=0.01)
    assert seconds_to_ns(record.t_end_s) <= trial.t_ns - BOOT_NS
