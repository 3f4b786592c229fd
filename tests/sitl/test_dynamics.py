import itertools

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from sitl.dynamics import (
    GRAVITY,
    STEP_S,
    QuadrotorCommand,
    QuadrotorSettings,
    QuadrotorState,
    at_rest,
    step,
)
from tests.sitl.dynamics_oracle import OracleState
from tests.sitl.dynamics_oracle import step as oracle_step

SETTINGS = QuadrotorSettings()


def _fly(
    state: QuadrotorState,
    seconds: float,
    v_world: tuple[float, float, float],
    *,
    yaw_rate: float = 0.0,
    armed: bool = True,
    wind_world: tuple[float, float, float] = (0.0, 0.0, 0.0),
    estimate_error_world: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> list[QuadrotorState]:
    n = len(state.p_world)
    command = QuadrotorCommand(np.tile(v_world, (n, 1)), np.full(n, yaw_rate), np.full(n, armed))
    wind = np.tile(wind_world, (n, 1))
    states = []
    for _ in range(round(seconds / STEP_S)):
        state = step(state, command, state.v_world + estimate_error_world, wind, settings=SETTINGS)
        states.append(state)
    return states


def _hovering(height_m: float = 3.0, yaw: float = 0.0) -> QuadrotorState:
    return at_rest(np.array([[0.0, 0.0, height_m]]), np.array([yaw]), settings=SETTINGS)


def _standing() -> QuadrotorState:
    return at_rest(np.zeros((1, 3)), np.zeros(1), settings=SETTINGS)


def _first_time(speeds: FloatArray, level: float) -> float:
    return float((np.argmax(speeds >= level) + 1) * STEP_S)


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.0, -1.5])
def test_the_velocity_step_is_that_of_px4(heading: float) -> None:
    """Figures of a 0 to 1 m/s step of PX4 1.18 with a drag of 0.3 per second; read off at 0.1 s."""
    states = _fly(_hovering(yaw=0.3), 8.0, (float(np.cos(heading)), float(np.sin(heading)), 0.0))
    along = np.array([np.cos(heading), np.sin(heading), 0.0])
    speeds = np.array([state.v_world[0] @ along for state in states])
    across = np.array([state.v_world[0, :2] @ [-along[1], along[0]] for state in states])
    assert 0.15 < _first_time(speeds, 0.02) < 0.31
    assert _first_time(speeds, 0.10) == pytest.approx(0.31, abs=0.03)
    assert _first_time(speeds, 0.50) == pytest.approx(0.60, abs=0.04)
    assert _first_time(speeds, 0.63) == pytest.approx(0.75, abs=0.05)
    assert speeds[round(1.3 / STEP_S) - 1] == pytest.approx(0.95, abs=0.02)
    assert speeds.max() == pytest.approx(1.03, abs=0.01)
    assert speeds[-1] == pytest.approx(1.0, abs=0.01)
    assert np.abs(across).max() < 1e-9
    assert max(abs(state.p_world[0, 2] - 3.0) for state in states) < 0.02


def test_the_vertical_response_is_quicker_and_settles() -> None:
    states = _fly(_hovering(), 5.0, (0.0, 0.0, 1.0))
    speeds = np.array([state.v_world[0, 2] for state in states])
    assert _first_time(speeds, 0.63) == pytest.approx(0.5, abs=0.06)
    assert speeds.max() < 1.08
    assert speeds[-1] == pytest.approx(1.0, abs=0.03)


def test_acceleration_and_tilt_stay_within_bounds_on_a_large_step() -> None:
    states = _fly(_hovering(), 3.0, (8.0, 8.0, 0.0))
    horizontal = [float(np.linalg.norm(state.accel_setpoint_world[0, :2])) for state in states]
    assert max(horizontal) == pytest.approx(3.0, abs=1e-6)
    tilts = [float(rotation.angle_between(state.q_world_body[0], rotation.from_yaw(0.0))) for state in states]
    assert np.degrees(max(tilts)) == pytest.approx(np.degrees(np.arctan2(3.0, GRAVITY)), abs=2.0)
    jerk = np.diff([state.accel_setpoint_world[0] for state in states], axis=0) / STEP_S
    assert np.linalg.norm(jerk, axis=1).max() <= SETTINGS.jerk_max_mps3 * 1.001


def test_tilt_points_the_thrust_into_the_acceleration() -> None:
    state = _fly(_hovering(yaw=1.0), 0.6, (2.0, 0.0, 0.0))[-1]
    z_world = rotation.rotate(state.q_world_body[0], [0.0, 0.0, 1.0])
    assert z_world[0] > 0.1
    assert abs(z_world[1]) < 0.01
    assert float(rotation.yaw_of(state.q_world_body[0])) == pytest.approx(1.0, abs=0.02)


def test_an_error_of_the_estimate_becomes_drift_of_the_vehicle() -> None:
    states = _fly(_hovering(), 12.0, (0.0, 0.0, 0.0), estimate_error_world=(0.2, 0.0, 0.0))
    np.testing.assert_allclose(states[-1].v_world[0], [-0.2, 0.0, 0.0], atol=0.01)
    assert states[-1].p_world[0, 0] < -1.5


def test_yaw_follows_its_rate_with_a_lag() -> None:
    states = _fly(_hovering(), 2.0, (0.0, 0.0, 0.0), yaw_rate=0.5)
    assert states[-1].omega_body[0, 2] == pytest.approx(0.5, abs=1e-3)
    expected = 0.5 * (2.0 - SETTINGS.yaw_rate_time_constant_s - SETTINGS.command_delay_s)
    assert float(rotation.yaw_of(states[-1].q_world_body[0])) == pytest.approx(expected, abs=0.02)


def test_steady_wind_is_held_after_a_while() -> None:
    states = _fly(_hovering(), 15.0, (0.0, 0.0, 0.0), wind_world=(4.0, 0.0, 0.0))
    assert max(state.v_world[0, 0] for state in states) > 0.2
    assert abs(states[-1].v_world[0, 0]) < 0.02
    leaning = rotation.rotate(states[-1].q_world_body[0], [0.0, 0.0, 1.0])
    assert leaning[0] == pytest.approx(-0.3 * 4.0 / GRAVITY, rel=0.05)


def test_a_vehicle_stands_until_it_is_armed_and_told_to_climb() -> None:
    standing = _standing()
    assert standing.on_ground[0]
    assert standing.p_world[0, 2] == SETTINGS.standing_height_m
    assert _fly(standing, 1.0, (0.0, 0.0, 1.0), armed=False)[-1].thrust[0] == 0.0
    idle = _fly(standing, 1.0, (0.5, 0.0, 0.0))[-1]
    assert idle.on_ground[0]
    assert idle.thrust[0] == pytest.approx(SETTINGS.thrust_idle_mps2)
    np.testing.assert_array_equal(idle.p_world, standing.p_world)
    np.testing.assert_array_equal(idle.v_world, 0.0)
    risen = _fly(idle, 3.0, (0.0, 0.0, 1.0))[-1]
    assert not risen.on_ground[0]
    assert risen.p_world[0, 2] > 2.0


def test_a_landing_ends_on_the_ground_at_the_commanded_speed() -> None:
    descent = _fly(_hovering(1.5), 4.0, (0.0, 0.0, -0.7))
    landed = descent[-1]
    assert landed.on_ground[0]
    assert landed.touchdown_speed[0] == pytest.approx(0.7, abs=0.05)
    np.testing.assert_allclose(landed.v_world, 0.0)
    assert landed.p_world[0, 2] == SETTINGS.standing_height_m
    assert min(state.p_world[0, 2] for state in descent) >= SETTINGS.standing_height_m


def test_disarming_in_the_air_is_a_fall() -> None:
    states = _fly(_hovering(2.0), 2.0, (0.0, 0.0, 0.0), armed=False)
    assert states[-1].on_ground[0]
    assert states[-1].touchdown_speed[0] > 5.0


def test_positions_and_attitudes_are_the_exact_integrals_of_velocity_and_rate() -> None:
    states = _fly(_hovering(), 1.0, (1.0, -0.5, 0.3), yaw_rate=0.4)
    for before, after in itertools.pairwise(states):
        np.testing.assert_allclose(after.v_world - before.v_world, STEP_S * after.accel_world, atol=1e-15)
        mean = 0.5 * (before.v_world + after.v_world)
        np.testing.assert_allclose(after.p_world - before.p_world, STEP_S * mean, atol=1e-14)
        turn = rotation.exp(0.5 * STEP_S * (before.omega_body + after.omega_body))
        np.testing.assert_allclose(
            after.q_world_body, rotation.multiply(before.q_world_body, turn), atol=1e-14
        )


def test_a_batch_of_one_equals_a_batch_of_many_bit_by_bit() -> None:
    rng = np.random.default_rng(2)
    n = 7
    positions = rng.uniform(0.0, 4.0, (n, 3))
    positions[::3, 2] = 0.0
    yaws = rng.uniform(-3.0, 3.0, n)
    commands = [
        QuadrotorCommand(
            rng.uniform(-2.0, 2.0, (n, 3)), rng.uniform(-1.0, 1.0, n), rng.uniform(size=n) < 0.95
        )
        for _ in range(60)
    ]
    winds = rng.uniform(-3.0, 3.0, (60, n, 3))
    errors = rng.normal(0.0, 0.1, (60, n, 3))

    def run(part: slice) -> QuadrotorState:
        state = at_rest(positions[part], yaws[part], settings=SETTINGS)
        for command, wind, error in zip(commands, winds, errors, strict=True):
            own = QuadrotorCommand(command.v_world[part], command.yaw_rate[part], command.armed[part])
            state = step(state, own, state.v_world + error[part], wind[part], settings=SETTINGS)
        return state

    together = run(slice(None))
    for k in range(n):
        alone = run(slice(k, k + 1))
        for name in ("p_world", "v_world", "q_world_body", "omega_body", "thrust", "on_ground"):
            assert getattr(alone, name)[0].tobytes() == getattr(together, name)[k].tobytes(), name


def test_a_step_leaves_its_inputs_alone() -> None:
    state = _hovering()
    before = state.p_world.copy(), state.pending.copy()
    _fly(state, 0.1, (1.0, 0.0, 0.0))
    np.testing.assert_array_equal(state.p_world, before[0])
    np.testing.assert_array_equal(state.pending, before[1])


def test_the_motion_of_one_vehicle_can_be_taken_out() -> None:
    motion = _fly(_hovering(), 0.5, (1.0, 0.0, 0.0))[-1].kinematics(0)
    assert motion.p_world.shape == (3,)
    assert motion.q_world_body.shape == (4,)
    assert motion.v_world[0] > 0.0


def test_the_kernel_follows_the_readable_form_through_a_whole_flight() -> None:
    generator = np.random.default_rng(5)
    fast = at_rest(np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 4.0]]), np.array([0.3, -2.0]), settings=SETTINGS)
    slow = OracleState(
        p_world=fast.p_world, v_world=fast.v_world, q_world_body=fast.q_world_body,
        omega_body=fast.omega_body, accel_world=fast.accel_world, thrust=fast.thrust,
        accel_setpoint_world=fast.memory[:, :3], accel_integral_world=fast.memory[:, 3:],
        pending=fast.pending, on_ground=fast.on_ground, touchdown_speed=fast.touchdown_speed,
    )  # fmt: skip
    for index in range(2000):
        if index % 200 == 0:
            command = QuadrotorCommand(
                generator.uniform(-3.0, 3.0, (2, 3)),
                generator.uniform(-2.0, 2.0, 2),
                np.array([index > 100, True]),
            )
        wind, error = generator.normal(0.0, 1.0, (2, 3)), generator.normal(0.0, 0.2, (2, 3))
        slow = oracle_step(slow, command, slow.v_world + error, wind, settings=SETTINGS)
        fast = step(fast, command, fast.v_world + error, wind, settings=SETTINGS)
        for name in (
            "p_world",
            "v_world",
            "q_world_body",
            "omega_body",
            "accel_world",
            "thrust",
            "on_ground",
        ):
            np.testing.assert_allclose(getattr(fast, name), getattr(slow, name), atol=1e-6, err_msg=name)
        np.testing.assert_array_equal(fast.on_ground, slow.on_ground)
