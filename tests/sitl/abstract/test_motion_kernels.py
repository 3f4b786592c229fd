import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from sitl.abstract.motion_kernels import closest_approach, move, touches
from sitl.abstract.settings import HISTORY, AbstractSettings
from sitl.dynamics import QuadrotorCommand, at_rest, step
from sitl.dynamics_kernels import P, Q, V
from sitl.swarm.settings import TerminationSettings
from sitl.worlds.primitives import Cylinder, Sphere, World


def _moved(settings: AbstractSettings, commands: FloatArray, yaw: FloatArray) -> FloatArray:
    n = commands.shape[1]
    state = at_rest(np.tile([0.0, 0.0, 2.0], (n, 1)), yaw, settings=settings.quadrotor)
    motion, loop, gusts = state.motion.copy(), state.memory.copy(), np.zeros((n, 3))
    ring = np.zeros((HISTORY, n, 3))
    parameters = settings.packed(TerminationSettings(), 60.0, 4.0)
    path = np.empty((len(commands), n, 19))
    for k, command in enumerate(commands):
        ring[k % HISTORY] = command
        move(
            np.uint64(1), k, ring, parameters, settings.packed_quadrotor(), gusts, motion, loop,
            np.zeros((n, 5)), np.zeros((n, 3)),
        )  # fmt: skip
        path[k] = motion
    return path


def _commands(rng: np.random.Generator) -> FloatArray:
    pieces = rng.uniform(-1.5, 1.5, (20, 3, 3)) * np.array([1.0, 1.0, 0.3])
    return np.repeat(pieces, 10, axis=0)


def test_in_steps_of_five_milliseconds_vehicles_fly_as_in_full_fidelity() -> None:
    settings = AbstractSettings(substep_s=0.005)
    commands, yaw = _commands(np.random.default_rng(0)), np.array([0.0, 1.0, -2.0])
    path = _moved(settings, commands, yaw)
    state = at_rest(np.tile([0.0, 0.0, 2.0], (3, 1)), yaw, settings=settings.quadrotor)
    for k in range(len(commands)):
        for _ in range(10):
            order = QuadrotorCommand(commands[k], np.zeros(3), np.ones(3, np.bool_))
            state = step(state, order, state.v_world, np.zeros((3, 3)), settings=settings.quadrotor)
        np.testing.assert_allclose(path[k], state.motion, atol=1e-9)


def test_the_default_step_stays_close_to_that() -> None:
    commands, yaw = _commands(np.random.default_rng(1)), np.zeros(3)
    fine = _moved(AbstractSettings(substep_s=0.005), commands, yaw)
    coarse = _moved(AbstractSettings(), commands, yaw)
    assert np.abs(fine[:, :, V : V + 3] - coarse[:, :, V : V + 3]).max() < 0.06
    assert np.abs(fine[:, :, P : P + 3] - coarse[:, :, P : P + 3]).max() < 0.06


def test_a_lagging_vehicle_reaches_its_command_and_tilts_by_what_it_accelerates() -> None:
    settings = AbstractSettings(dynamics="lag")
    commands = np.tile([1.0, 0.5, 0.0], (40, 4, 1))
    yaw = np.array([0.0, 1.0, 2.0, -3.0])
    path = _moved(settings, commands, yaw)
    np.testing.assert_allclose(path[-1, :, V : V + 3], commands[-1], atol=0.02)
    rising = path[4]
    up = rotation.rotate(rising[:, Q : Q + 4], [0.0, 0.0, 1.0])
    # Acceleration and thrust point the same way, and the heading has not turned.
    assert np.all(up[:, :2] @ np.array([1.0, 0.5]) > 0.02)
    np.testing.assert_allclose(up[:, 0] * 0.5 - up[:, 1], 0.0, atol=1e-9)
    turned = np.angle(np.exp(1j * (rotation.yaw_of(rising[:, Q : Q + 4]) - yaw)))
    np.testing.assert_allclose(turned, 0.0, atol=1e-9)
    # Everybody has a lag of its own.
    assert len(np.unique(np.round(path[8, :, V], 6))) == 4


def test_nothing_slips_through_an_obstacle_within_a_step() -> None:
    world = World.of(
        [
            Cylinder(start_world_m=(0.0, 0.0, 0.0), end_world_m=(0.0, 0.0, 5.0), radius_m=0.02),
            Sphere(centre_world_m=(3.0, 0.0, 1.0), radius_m=0.1),
        ]
    )
    everything = np.arange(2, dtype=np.int32)
    rng = np.random.default_rng(2)
    found = []
    for _ in range(300):
        start, end = rng.uniform([-1.0, -1.0, 0.0], [1.0, 1.0, 2.0], (2, 3))
        along = np.linspace(start, end, 400)
        expected = bool(np.any(world.clearance(along) < 0.2))
        margin = abs(float(world.clearance(along).min()) - 0.2)
        if margin < 0.005:
            continue
        room = float(world.clearance(end))
        assert bool(
            touches(world.kinds, world.rows, world.discs, everything, 2, start, end, 0.2, room)
        ) == expected  # fmt: skip
        found.append(expected)
    assert 0.1 < np.mean(found) < 0.9


def test_the_closest_approach_lies_between_the_samples() -> None:
    rng = np.random.default_rng(3)
    for _ in range(100):
        a, b, c, d = rng.uniform(-1.0, 1.0, (4, 3))
        along = np.linspace(0.0, 1.0, 2001)[:, None]
        dense = np.linalg.norm((a + along * (b - a)) - (c + along * (d - c)), axis=1).min()
        assert closest_approach(a, b, c, d) == pytest.approx(dense, abs=2e-3)
        assert closest_approach(a, b, c, d) <= dense + 1e-12
