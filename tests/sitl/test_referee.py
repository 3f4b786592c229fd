"""When a flight is over, and what it is called."""

from dataclasses import replace

import numpy as np
import pytest

from companion.clock import seconds_to_ns
from sitl.referee import Referee, Sighting
from sitl.scenario import Stage, load_scenario, set_stage
from tests.sitl.short_flight import write_scenario

BOOT_NS = 5_000_000_000
EMPTY = {"primitives": [{"shape": "ground"}]}


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Stage:
    folder = tmp_path_factory.mktemp("referee")
    return set_stage(load_scenario(write_scenario(folder, world=EMPTY)), folder, None)


class Flight:
    """A vehicle as the referee sees it; time passes with every look."""

    def __init__(self, stage: Stage) -> None:
        self.referee = Referee(stage, BOOT_NS)
        self.seen = Sighting(BOOT_NS, stage.T_world_start.p, landed=True, armed=False, collisions=0)

    def at(self, t_s: float, **changes: object) -> Referee:
        t_ns = BOOT_NS + seconds_to_ns(t_s)
        self.seen = replace(self.seen, t_ns=t_ns, **changes)  # type: ignore[arg-type]
        self.referee.watch(self.seen)
        return self.referee

    def fly_and_land(self, p_world: object) -> Referee:
        """Take off at 1 s, land at 10 s, stop the motors at 12 s."""
        self.at(1.0, armed=True, landed=False)
        self.at(10.0, p_world=p_world, landed=True)
        self.at(12.0, armed=False)
        return self.referee


def test_it_is_a_success_two_seconds_after_the_motors_have_stopped_at_the_goal(stage: Stage) -> None:
    flight = Flight(stage)
    near = stage.goal_world + np.array([0.6, 0.6, -1.0])
    referee = flight.fly_and_land(near)
    assert not flight.at(13.9).over
    assert flight.at(14.0).over
    ending = referee.ending(wall_time_s=3.5)
    assert (ending.success, ending.reason) == (True, "landed at the goal")
    assert ending.goal_distance_m == pytest.approx(0.6 * np.sqrt(2.0))
    assert (ending.collisions, ending.sim_time_s, ending.wall_time_s) == (0, 14.0, 3.5)


def test_landing_elsewhere_is_a_failure_with_its_distance(stage: Stage) -> None:
    flight = Flight(stage)
    flight.fly_and_land(stage.goal_world + np.array([0.0, 3.0, 0.0]))
    ending = flight.at(14.0).ending(1.0)
    assert (ending.success, ending.reason) == (False, "landed 3.0 m from the goal")


def test_a_vehicle_that_has_not_flown_has_not_landed(stage: Stage) -> None:
    flight = Flight(stage)
    flight.at(1.0, armed=True)
    flight.at(20.0, armed=False)
    assert not flight.at(50.0).over


def test_a_touch_down_with_turning_motors_is_not_a_landing(stage: Stage) -> None:
    flight = Flight(stage)
    flight.at(1.0, armed=True, landed=False)
    flight.at(10.0, landed=True)
    assert not flight.at(40.0).over


def test_the_two_seconds_begin_anew_when_the_vehicle_takes_off_again(stage: Stage) -> None:
    flight = Flight(stage)
    flight.fly_and_land(stage.goal_world)
    flight.at(13.0, armed=True, landed=False)
    flight.at(13.5, armed=False, landed=True)
    assert not flight.at(15.4).over
    assert flight.at(15.5).over


def test_a_collision_ends_the_flight_at_once_even_over_the_goal(stage: Stage) -> None:
    flight = Flight(stage)
    flight.at(1.0, armed=True, landed=False)
    referee = flight.at(2.0, p_world=stage.goal_world, collisions=1)
    assert referee.over
    ending = referee.ending(1.0)
    assert (ending.success, ending.reason, ending.collisions) == (False, "collision", 1)


def test_a_contact_seen_after_the_landing_takes_the_success_back(stage: Stage) -> None:
    flight = Flight(stage)
    flight.fly_and_land(stage.goal_world)
    assert flight.at(14.0).ending(1.0).success
    assert not flight.at(14.1, collisions=1).ending(1.0).success


def test_the_longest_duration_ends_the_flight(stage: Stage) -> None:
    flight = Flight(stage)
    assert not flight.at(59.9, armed=True, landed=False).over
    assert flight.at(60.0).reason == "not landed after 60 s"


def test_the_first_reason_stays(stage: Stage) -> None:
    flight = Flight(stage)
    flight.referee.end("the companion ended: no")
    flight.fly_and_land(stage.goal_world)
    ending = flight.at(14.0).ending(1.0)
    assert (ending.success, ending.reason) == (False, "the companion ended: no")


def test_before_the_first_look_the_goal_is_as_far_as_the_mission_is_long(stage: Stage) -> None:
    referee = Referee(stage, BOOT_NS)
    assert referee.goal_distance_m == pytest.approx(6.0)
    assert (referee.elapsed_s, referee.over, referee.reason) == (0.0, False, "")


def test_height_does_not_count_towards_the_distance(stage: Stage) -> None:
    flight = Flight(stage)
    high = stage.goal_world + np.array([0.0, 0.0, 7.0])
    assert flight.at(1.0, p_world=high).goal_distance_m == pytest.approx(0.0, abs=1e-12)
