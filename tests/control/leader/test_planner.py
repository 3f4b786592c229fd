import numpy as np
import pytest

from companion.control.leader.planner import LeaderDecision, LeaderPlanner
from companion.control.leader.settings import LeaderSettings, MissionSettings
from companion.messages import OdometryStatus
from tests.control.leader.fields import wall
from tests.control.leader.flight import Pillars, mission_to, odometry_at, scan_of

TICK_NS = 20_000_000
HOVER = np.array([0.0, 0.0, 1.5])
T_START_NS = 7_000_000_000_000_000
BOX = wall((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0), (-3.0, -3.0))


def leader(settings: LeaderSettings | None = None, seed: int = 0) -> LeaderPlanner:
    return LeaderPlanner(settings or mission_to((20.0, 0.0, 1.5)), np.random.default_rng(seed))


def hover(planner: LeaderPlanner, ticks: int, start: int = 0, p: np.ndarray = HOVER) -> list[LeaderDecision]:
    decisions = []
    for tick in range(start, start + ticks):
        t_ns = T_START_NS + tick * TICK_NS
        decisions.append(planner.decide(odometry_at(t_ns, p), t_ns))
    return decisions


def see(planner: LeaderPlanner, world: Pillars, scans: int = 5) -> None:
    rng = np.random.default_rng(0)
    for sequence in range(scans):
        planner.observe(scan_of(world.returns(HOVER, rng, 4000), odometry_at(T_START_NS, HOVER), sequence))


def test_the_first_command_after_taking_control_is_zero_and_stamped_with_its_data() -> None:
    planner = leader()
    moving = odometry_at(T_START_NS, HOVER, np.array([1.0, 0.5, 0.2]))
    planner.reset(moving)
    decision = planner.decide(moving, T_START_NS + 5_000_000)
    assert decision.command.v_map.tolist() == [0.0, 0.0, 0.0]
    assert decision.command.yaw_rate == 0.0
    assert decision.command.t_ns == T_START_NS
    assert not decision.finished


def test_it_stands_for_a_second_and_then_speeds_up_gently() -> None:
    planner = leader()
    planner.reset(odometry_at(T_START_NS, HOVER))
    commands = np.array([decision.command.v_map for decision in hover(planner, 150)])
    assert not commands[:50].any()
    assert commands[-1] == pytest.approx([1.0, 0.0, 0.0], abs=0.05)
    assert np.linalg.norm(np.diff(commands, axis=0), axis=1).max() <= 1.5 * 0.02 + 1e-9


def test_taking_control_again_starts_from_standstill() -> None:
    planner = leader()
    planner.reset(odometry_at(T_START_NS, HOVER))
    assert np.linalg.norm(hover(planner, 150)[-1].command.v_map) > 0.9
    planner.reset(odometry_at(T_START_NS, HOVER))
    again = hover(planner, 60, start=1000)
    assert not any(decision.command.v_map.any() for decision in again[:50])
    assert again[0].plan is not None


def test_a_plan_is_told_when_it_changes_and_leads_from_the_vehicle_to_the_waypoint() -> None:
    planner = leader(mission_to((6.0, 2.0, 2.0)))
    planner.reset(odometry_at(T_START_NS, HOVER))
    plans = [decision.plan for decision in hover(planner, 100)]
    told = [plan for plan in plans if plan is not None]
    assert len(told) == 2
    assert [plan.status for plan in told] == ["planned", "kept"]
    assert told[0].path_map[0].tolist() == [0.0, 0.0, 2.0]
    assert told[0].path_map[-1].tolist() == [6.0, 2.0, 2.0]
    assert told[0].goal_map.tolist() == [6.0, 2.0, 2.0]
    assert told[0].waypoint == 0


def test_without_a_path_it_brakes_holds_says_so_and_goes_on_when_the_way_is_free() -> None:
    planner = leader()
    planner.reset(odometry_at(T_START_NS, HOVER))
    assert np.linalg.norm(hover(planner, 150)[-1].command.v_map) > 0.9
    see(planner, Pillars(BOX, np.full(len(BOX), 0.15)))
    decisions = hover(planner, 100, start=150)
    assert any(decision.plan is not None and decision.plan.status == "no path" for decision in decisions)
    assert np.linalg.norm(decisions[-1].command.v_map) < 0.01
    far = wall((-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0), (-9.0, -9.0))
    see(planner, Pillars(far, np.full(len(far), 0.15)), scans=60)
    decisions = hover(planner, 150, start=250)
    assert decisions[-1].command.v_map[0] > 0.3


@pytest.mark.parametrize("status", [OdometryStatus.LOST, OdometryStatus.INITIALISING])
def test_without_trustworthy_odometry_it_brakes(status: OdometryStatus) -> None:
    planner = leader()
    planner.reset(odometry_at(T_START_NS, HOVER))
    hover(planner, 150)
    for tick in range(150, 220):
        t_ns = T_START_NS + tick * TICK_NS
        v_map = planner.decide(odometry_at(t_ns, HOVER, status=status), t_ns).command.v_map
    assert np.linalg.norm(v_map) < 0.05


def test_commands_are_finite_whatever_comes_in() -> None:
    rng = np.random.default_rng(4)
    planner = leader(mission_to((4.0, 0.0, 1.5)))
    planner.reset(odometry_at(T_START_NS, HOVER))
    for tick in range(400):
        t_ns = T_START_NS + tick * TICK_NS
        p = HOVER + rng.normal(0.0, 1.5, 3)
        v = rng.normal(0.0, 3.0, 3)
        if tick % 7 == 0:
            p[tick % 3] = np.nan
        if tick % 11 == 0:
            v[tick % 3] = np.inf
        odometry = odometry_at(t_ns, p, v)
        if tick % 5 == 0:
            points = HOVER + rng.normal(0.0, 1.0, (2000, 3))
            points[::10] = np.nan
            planner.observe(scan_of(points, odometry))
        v_map = planner.decide(odometry, t_ns).command.v_map
        assert np.all(np.isfinite(v_map))
        assert np.linalg.norm(v_map) <= 2.0 + 1e-9


def test_a_jump_of_the_map_frame_empties_the_map_and_starts_anew() -> None:
    planner = leader()
    planner.reset(odometry_at(T_START_NS, HOVER))
    see(planner, Pillars(BOX, np.full(len(BOX), 0.15)))
    assert hover(planner, 120)[-1].command.v_map == pytest.approx(np.zeros(3), abs=1e-6)
    t_ns = T_START_NS + 120 * TICK_NS
    for tick in range(150):
        t_ns += TICK_NS
        decision = planner.decide(odometry_at(t_ns, HOVER, reset_counter=1), t_ns)
        if tick < 50:
            assert not decision.command.v_map.any()
    assert decision.command.v_map[0] > 0.9


def test_the_height_of_the_waypoint_is_flown_within_the_climb_limit() -> None:
    planner = leader(mission_to((20.0, 0.0, 4.0)))
    planner.reset(odometry_at(T_START_NS, HOVER))
    assert hover(planner, 200)[-1].command.v_map[2] == pytest.approx(0.5, abs=0.01)


def test_no_command_is_faster_than_the_limit() -> None:
    mission = MissionSettings(waypoints_m=[[20.0, 0.0, 9.0]], speed_mps=1.0, max_speed_mps=1.0)
    planner = leader(LeaderSettings(mission=mission))
    planner.reset(odometry_at(T_START_NS, HOVER))
    v_map = hover(planner, 250)[-1].command.v_map
    assert np.linalg.norm(v_map) == pytest.approx(1.0, abs=1e-3)
    assert v_map[2] > 0.4


def test_old_odometry_is_carried_forward_by_its_velocity() -> None:
    planner = leader(mission_to((0.9, 0.0, 1.5)))
    fast = odometry_at(T_START_NS, HOVER, np.array([2.0, 0.0, 0.0]))
    planner.reset(fast)
    planner.decide(fast, T_START_NS)
    late = odometry_at(T_START_NS + 60 * TICK_NS, HOVER, np.array([2.0, 0.0, 0.0]))
    plan = planner.decide(late, late.t_ns).plan
    assert plan is None or plan.status == "kept"
    plan = planner.decide(late, late.t_ns + 250_000_000).plan
    assert plan is not None
    assert plan.status == "holding"


def test_a_path_never_starts_behind_the_wall_ahead() -> None:
    planner = leader(mission_to((12.0, 0.0, 1.5)))
    centres = wall((0.7, -3.0), (0.7, 3.0), (-3.0, 3.0), (-3.0, -3.0), (0.7, -3.0))
    see(planner, Pillars(centres, np.full(len(centres), 0.12)))
    fast = odometry_at(T_START_NS, HOVER, np.array([4.0, 0.0, 0.0]))
    planner.reset(fast)
    plan = planner.decide(fast, T_START_NS).plan
    assert plan is not None
    assert plan.status == "no path"


def test_before_control_is_ever_taken_scans_are_remembered() -> None:
    planner = leader()
    see(planner, Pillars(BOX, np.full(len(BOX), 0.15)))
    planner.reset(odometry_at(T_START_NS, HOVER))
    assert hover(planner, 1)[0].plan is not None
    assert hover(planner, 120, start=1)[-1].command.v_map == pytest.approx(np.zeros(3), abs=1e-6)
