"""A follower with a policy: what it flies, and what flies when the policy does not."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx")

from companion.control.action import Pilot
from companion.control.followers.laws_kernels import limit_command, overrule
from companion.control.followers.layout_kernels import PREVIOUS
from companion.control.followers.role import FollowerRole
from companion.control.followers.settings import FollowerSettings
from companion.control.observation import CONTRACTS, Observation
from companion.control.observation_kernels import keeping_of
from companion.control.policy import load_policy
from companion.messages import Float32Array, FloatArray, OdometryStatus, StatusText
from companion.perception.neighbours import NeighbourSettings, NeighbourView
from companion.perception.occupancy import GridSettings, ObstacleGrid
from tests.control.followers.situations import Follower, column, drawn, free, others, own
from tests.control.followers.test_role import START_NS, TICK_NS, odometry, role, show, track
from tests.control.models import save
from tests.control.test_action import FakePolicy

POLICY_TICK_NS = 50_000_000


def learned_role(pilot: Pilot) -> FollowerRole:
    return FollowerRole(
        FollowerSettings(), NeighbourView(NeighbourSettings()), ObstacleGrid(GridSettings()),
        np.full((72, 12), np.inf), pilot,
    )  # fmt: skip


def model_role(path: Path, **model: object) -> FollowerRole:
    save(path, **model)  # type: ignore[arg-type]
    settings = FollowerSettings.model_validate({"controller": "policy", "model": str(path)})
    return learned_role(Pilot(load_policy(settings)))


def flight(follower: FollowerRole, ticks: int = 100) -> FloatArray:
    """Fly in closed loop after a moving neighbour among scattered points; return the commands."""
    rng = np.random.default_rng(6)
    p_map, v_map = np.array([0.0, 0.0, 1.5]), np.zeros(3)
    follower.reset(odometry(START_NS, 0.4))
    commands = []
    for tick in range(ticks):
        t_ns = START_NS + tick * POLICY_TICK_NS
        own_motion = odometry(t_ns, 0.4, p_map=p_map.copy(), v_map=v_map.copy())
        if tick % 5 == 0:
            place = (3.0 + 0.02 * tick, 0.5 + float(rng.normal(0.0, 0.05)), 1.6)
            points = rng.uniform(-4.0, 4.0, (150, 3)) + p_map
            tracks = [track(place, t_ns)] if tick % 40 < 30 else []
            show(follower, t_ns, tick, *tracks, points=points, own=own_motion)
        command = follower.decide(own_motion, t_ns).command.v_map
        commands.append(command)
        v_map = v_map + 0.2 * (command - v_map)
        p_map = p_map + 0.05 * v_map
    return np.array(commands)


def test_a_policy_that_changes_nothing_flies_as_its_law(tmp_path: Path) -> None:
    law = flight(role())
    assert np.linalg.norm(law, axis=1).max() > 0.5
    follower = model_role(tmp_path / "a.onnx", scale=1.0)
    np.testing.assert_allclose(flight(follower), law, atol=1e-5)
    assert follower.counters is not None
    assert follower.counters.flown == follower.counters.asked == 100


@pytest.mark.parametrize("contract", ["best-2", "paper-1"])
def test_a_policys_velocity_is_flown_within_the_limits(contract: str, tmp_path: Path) -> None:
    follower = model_role(tmp_path / "a.onnx", contract=contract, offset=(3.0, 0.0, -3.0))
    commands = flight(follower)
    assert not commands[0].any()
    steps = np.linalg.norm(np.diff(commands, axis=0), axis=1)
    assert steps.max() <= 4.0 * 0.05 + 1e-9
    # Heading frame to map; speed limits as for any law.
    settled = np.array([3.0, 0.0, -1.0]) * 2.0 / np.sqrt(10.0)
    turned = [settled[0] * np.cos(0.4), settled[0] * np.sin(0.4), settled[2]]
    np.testing.assert_allclose(commands[-1], turned, atol=1e-6)


def test_equal_flights_by_policy_give_equal_bytes(tmp_path: Path) -> None:
    flights = [
        flight(model_role(tmp_path / "a.onnx", scale=1.0, offset=(0.1, -0.2, 0.05))).tobytes()
        for _ in range(2)
    ]
    assert flights[0] == flights[1]


@pytest.mark.parametrize("fault", ["not a number", "breaks", "wrong shape"])
def test_where_a_policy_fails_the_law_flies_in_the_same_tick(fault: str) -> None:
    def answer(observation: Observation) -> Float32Array:
        if fault == "breaks":
            raise RuntimeError
        if fault == "wrong shape":
            return np.zeros((1, 2), np.float32)
        return np.full((1, 3), np.nan, np.float32)

    follower = learned_role(Pilot(FakePolicy(answer)))
    assert flight(follower).tobytes() == flight(role()).tobytes()
    assert follower.counters is not None
    assert follower.counters.flown == 0
    assert follower.counters.unsound + follower.counters.failed == follower.counters.asked == 100


def test_the_law_goes_on_from_what_the_policy_flew_and_back_without_a_jump() -> None:
    ticks = 0

    def answer(observation: Observation) -> Float32Array:
        nonlocal ticks
        ticks += 1
        return np.full((1, 3), -0.5 if 20 < ticks <= 60 else np.nan, np.float32)

    commands = flight(learned_role(Pilot(FakePolicy(answer))))
    assert commands[55, 2] == pytest.approx(-0.5)
    assert np.linalg.norm(np.diff(commands, axis=0), axis=1).max() <= 4.0 * 0.05 + 1e-9
    law = flight(role())
    np.testing.assert_array_equal(commands[:20], law[:20])


def test_the_pilot_is_told_now_and_then_not_every_tick() -> None:
    def nothing(observation: Observation) -> Float32Array:
        return np.full((1, 3), np.nan, np.float32)

    told = []
    follower = learned_role(Pilot(FakePolicy(nothing)))
    follower.reset(odometry(START_NS))
    for tick in range(300):
        t_ns = START_NS + tick * TICK_NS
        remarks = follower.decide(odometry(t_ns), t_ns).remarks
        told += [(tick, remark.text) for remark in remarks if isinstance(remark, StatusText)]
    assert told == [(tick, "policy gives no velocity: the law flies") for tick in (0, 250)]
    strange = learned_role(Pilot(FakePolicy(lambda seen: np.zeros((1, 3), np.float32), unusual=1)))
    strange.reset(odometry(START_NS))
    remarks = strange.decide(odometry(START_NS), START_NS).remarks
    texts = [remark.text for remark in remarks if isinstance(remark, StatusText)]
    assert texts == ["policy sees what it hardly knows"]
    assert all(len(text) <= 50 for text in texts)


def test_between_its_decisions_a_policys_command_is_repeated_as_old_as_it_is() -> None:
    pilot = Pilot(FakePolicy(lambda seen: np.ones((1, 3), np.float32)))
    follower = learned_role(pilot)
    follower.reset(odometry(START_NS))
    times = [START_NS + tick * TICK_NS for tick in range(6)]
    commands = [follower.decide(odometry(t_ns), t_ns).command for t_ns in times]
    assert [command.t_ns for command in commands] == [times[tick] for tick in (0, 0, 2, 2, 4, 4)]
    assert commands[3] is commands[2]
    assert pilot.counters.asked == 3
    lost = odometry(times[5] + TICK_NS, status=OdometryStatus.LOST)
    assert not follower.decide(lost, times[5] + TICK_NS).command.v_map.any()


def test_without_sound_inputs_no_policy_is_asked() -> None:
    class Blind(ObstacleGrid):
        def ranges(self, *seen: object) -> FloatArray:
            return np.full((72, 12), np.nan)

    pilot = Pilot(FakePolicy(lambda seen: np.ones((1, 3), np.float32)))
    follower = FollowerRole(
        FollowerSettings(), NeighbourView(NeighbourSettings()), Blind(GridSettings()),
        np.full((72, 12), np.inf), pilot,
    )  # fmt: skip
    assert not flight(follower)[1:].any()
    assert pilot.counters.asked == 0


def test_limits_of_a_policy_are_those_of_a_law() -> None:
    rng = np.random.default_rng(12)
    follower, twin = Follower("flock"), Follower("flock")
    for _ in range(100):
        ego, rows, ranges = drawn(rng)
        ego[6] = rng.uniform(-3.0, 3.0)
        previous_map = follower.memory[PREVIOUS : PREVIOUS + 3].copy()
        command = follower.steer(ego, rows, ranges)
        twin.steer(ego, rows, ranges)
        # What is within the limits already is neither changed nor remembered otherwise.
        again = command.copy()
        overrule(0, ego, previous_map, twin.memory, twin.parameters, again)
        np.testing.assert_allclose(again, command, atol=1e-12)
        np.testing.assert_allclose(twin.memory, follower.memory, atol=1e-12)
        wild = rng.uniform(-5.0, 5.0, 3)
        limited = wild.copy()
        limit_command(ego, previous_map, follower.parameters, limited)
        overrule(0, ego, previous_map, twin.memory, twin.parameters, wild)
        assert wild.tolist() == limited.tolist()
        twin.memory[:] = follower.memory


def test_a_policy_that_keeps_to_the_law_flies_at_nothing_faster_than_the_law_allows() -> None:
    """It asks for full speed at a pillar and at a neighbour; what the law flies is not changed at all."""
    g = FollowerSettings().flock
    towards = column(column(free(), 0.0, 0.8), -5.0, 0.8)
    rows = others((0.0, 0.9, 0.0), (4.0, -1.0, 0.0))
    follower = Follower("flock")
    command = follower.settle(own(), rows, towards)
    previous_map = follower.memory[PREVIOUS : PREVIOUS + 3].copy()
    same = command.copy()
    overrule(1, own(), previous_map, follower.memory, follower.parameters, same)
    np.testing.assert_allclose(same, command, atol=1e-12)
    for asked in ((2.0, 0.0, 0.0), (0.0, 2.0, 0.0), (1.4, 1.4, 0.0)):
        kept, free_of_it = np.array(asked), np.array(asked)
        for _ in range(40):
            kept[:], free_of_it[:] = asked, asked
            follower.steer(own(), rows, towards)
            memory = follower.memory.copy()
            overrule(1, own(), memory[PREVIOUS : PREVIOUS + 3], follower.memory, follower.parameters, kept)
            overrule(0, own(), np.array(asked), memory, follower.parameters, free_of_it)
        assert np.linalg.norm(free_of_it) == pytest.approx(2.0, abs=0.03)
        for azimuth in np.radians([2.5, -2.5]):
            n = np.array([np.cos(azimuth), np.sin(azimuth)])
            aside = 0.8 * abs(n[0] * kept[1] - n[1] * kept[0]) / np.linalg.norm(kept[:2])
            room = g.body_radius_m + g.obstacle_margin_m
            assert n @ kept[:2] <= g.obstacle_per_s * (0.8 - room) + 1e-6 or aside >= room + g.pass_m - 1e-6
        assert kept[1] <= g.neighbour_per_s * (0.9 - g.neighbour_margin_m) + 1e-6


def test_contracts_with_a_law_keep_to_it_in_kernels_too() -> None:
    for contract in CONTRACTS.values():
        assert contract.keeping == keeping_of(contract.number) == (contract.law is not None)


def test_a_velocity_that_is_no_number_is_limited_to_braking() -> None:
    follower = Follower("flock")
    command = np.array([np.nan, 1.0, 1.0])
    limit_command(own(), np.array([1.0, 0.0, 0.0]), follower.parameters, command)
    np.testing.assert_allclose(command, [0.8, 0.0, 0.0])
    assert np.isfinite(follower.steer(own(), others((2.0, 0.0, 0.0)))).all()
