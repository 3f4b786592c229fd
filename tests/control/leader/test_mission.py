import numpy as np
import pytest

from companion.clock import seconds_to_ns
from companion.control.leader.mission import Mission, Phase
from companion.control.leader.settings import MissionSettings

TWO = [[5.0, 0.0, 1.5], [5.0, 5.0, 1.5]]


def started(**more: object) -> Mission:
    mission = Mission(MissionSettings(waypoints_m=TWO, **more))  # type: ignore[arg-type]
    mission.start(np.array([0.0, 0.0, 1.5]), seconds_to_ns(100.0))
    return mission


def visit(mission: Mission, p: tuple[float, float, float], t_s: float) -> Phase:
    mission.update(np.array(p), mission.waypoint_map, seconds_to_ns(t_s))
    return mission.phase


def test_the_leader_waits_a_second_and_ramps_up_for_another() -> None:
    mission = started()
    assert visit(mission, (0.0, 0.0, 1.5), 100.9) is Phase.WAITING
    assert mission.speed(9.0, seconds_to_ns(100.9)) == 0.0
    assert visit(mission, (0.0, 0.0, 1.5), 101.0) is Phase.FLYING
    assert mission.speed(9.0, seconds_to_ns(101.5)) == pytest.approx(0.5)
    assert mission.speed(9.0, seconds_to_ns(105.0)) == pytest.approx(1.0)


def test_waypoints_are_flown_through_and_the_last_is_held() -> None:
    mission = started()
    visit(mission, (0.0, 0.0, 1.5), 101.0)
    visit(mission, (4.4, 0.0, 1.5), 105.0)
    assert mission.index == 0
    visit(mission, (4.6, 0.0, 1.5), 105.2)
    assert mission.index == 1
    assert visit(mission, (5.0, 4.6, 1.5), 110.0) is Phase.PAUSING
    assert visit(mission, (5.0, 5.2, 1.5), 112.9) is Phase.PAUSING
    assert visit(mission, (5.0, 5.2, 1.5), 113.0) is Phase.FINISHED


def test_a_pause_is_made_at_every_waypoint_when_asked_for() -> None:
    mission = started(waypoint_hold_s=2.0)
    visit(mission, (0.0, 0.0, 1.5), 101.0)
    assert visit(mission, (5.0, 0.0, 1.5), 105.0) is Phase.PAUSING
    assert mission.speed(0.2, seconds_to_ns(105.0)) == pytest.approx(0.2)
    assert visit(mission, (5.0, 0.0, 1.5), 107.0) is Phase.FLYING
    assert mission.index == 1


def test_height_counts_for_arrival() -> None:
    mission = started()
    visit(mission, (0.0, 0.0, 1.5), 101.0)
    visit(mission, (5.0, 0.0, 3.0), 105.0)
    assert mission.index == 0


def test_only_the_last_waypoint_brakes() -> None:
    mission = started()
    late = seconds_to_ns(200.0)
    assert mission.speed(0.3, late) == pytest.approx(1.0)
    visit(mission, (0.0, 0.0, 1.5), 101.0)
    visit(mission, (5.0, 0.0, 1.5), 105.0)
    assert mission.speed(0.3, late) == pytest.approx(0.3)
    assert mission.speed(3.0, late) == pytest.approx(1.0)


def test_waypoints_reached_stay_reached_when_control_is_taken_again() -> None:
    mission = started()
    visit(mission, (0.0, 0.0, 1.5), 101.0)
    visit(mission, (5.0, 0.0, 1.5), 105.0)
    mission.start(np.array([5.0, 2.0, 1.5]), seconds_to_ns(300.0))
    assert (mission.index, mission.phase) == (1, Phase.WAITING)
    visit(mission, (5.0, 5.0, 1.5), 301.0)
    assert visit(mission, (5.0, 5.0, 1.5), 304.0) is Phase.FINISHED
    mission.start(np.array([5.0, 5.0, 1.5]), seconds_to_ns(400.0))
    assert (mission.index, mission.phase) == (0, Phase.WAITING)


def test_climb_is_proportional_and_limited() -> None:
    mission = started()
    assert [mission.climb_rate(error) for error in (-3.0, -0.2, 0.0, 0.3, 9.0)] == [-0.5, -0.2, 0.0, 0.3, 0.5]


def test_without_waypoints_the_place_of_taking_control_is_held() -> None:
    mission = Mission(MissionSettings())
    assert mission.height(7.0) == 7.0
    mission.start(np.array([1.0, 2.0, 3.0]), 0)
    assert mission.waypoint_map.tolist() == [1.0, 2.0, 3.0]
    assert mission.height(7.0) == 3.0


def test_a_cruise_speed_beyond_the_limit_is_refused() -> None:
    with pytest.raises(ValueError, match="exceeds max_speed_mps"):
        MissionSettings(speed_mps=2.5)


@pytest.mark.parametrize(
    "waypoint", [[1.0, 2.0], [1.0, 2.0, 3.0, 4.0], [1.0, 2.0, float("nan")], [0.0, 0.0, 1e9]]
)
def test_a_waypoint_that_is_no_place_is_refused(waypoint: list[float]) -> None:
    with pytest.raises(ValueError, match="waypoints_m"):
        MissionSettings(waypoints_m=[waypoint])
