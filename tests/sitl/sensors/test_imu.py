import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray
from sitl.kinematics import Kinematics
from sitl.sensors.imu import ImuModel, ImuSettings, true_inertial
from sitl.sensors.vibration import Vibration, VibrationSettings

STEP_S = 0.005
STEP_NS = 5_000_000
MOUNT = Pose.of([0.1, -0.05, 0.08], rotation.exp([0.1, 0.4, -0.6]))
GRAVITY_WORLD = np.array([0.0, 0.0, -9.81])
vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


def _at_rest(q_world_body: FloatArray = rotation.IDENTITY) -> Kinematics:
    return Kinematics(np.zeros(3), np.zeros(3), np.array(q_world_body), np.zeros(3))


def _slow_inertial(start: Kinematics, end: Kinematics, T_body_imu: Pose) -> FloatArray:
    """Difference the chip's own pose and velocity."""
    q_start, q_end = (rotation.multiply(state.q_world_body, T_body_imu.q) for state in (start, end))
    turn = rotation.log(rotation.multiply(rotation.conjugate(q_start), q_end))
    v_start, v_end = (
        state.v_world + rotation.rotate(state.q_world_body, np.cross(state.omega_body, T_body_imu.p))
        for state in (start, end)
    )
    q_mid = rotation.slerp(q_start, q_end, 0.5)
    force = rotation.rotate(rotation.conjugate(q_mid), (v_end - v_start) / STEP_S - GRAVITY_WORLD)
    return np.concatenate([turn / STEP_S, force])


@given(
    turns=st.tuples(vectors, vectors, vectors),
    rates=st.tuples(vectors, vectors),
    speeds=st.tuples(vectors, vectors),
)
@settings(max_examples=60, deadline=None)
def test_the_kernel_differences_the_motion_of_the_chip(
    turns: tuple[FloatArray, FloatArray, FloatArray],
    rates: tuple[FloatArray, FloatArray],
    speeds: tuple[FloatArray, FloatArray],
) -> None:
    q_start = rotation.exp(turns[0])
    q_end = rotation.multiply(q_start, rotation.exp(0.02 * turns[1]))
    start = Kinematics(np.zeros(3), speeds[0], q_start, rates[0])
    end = Kinematics(np.zeros(3), speeds[1], -q_end, rates[1])  # either sign is the same attitude
    T_body_imu = Pose.of([0.1, -0.2, 0.05], rotation.exp(turns[2]))
    np.testing.assert_allclose(
        true_inertial(start, end, STEP_S, T_body_imu), _slow_inertial(start, end, T_body_imu), atol=1e-9
    )


def test_a_level_chip_at_rest_feels_one_g_upwards() -> None:
    slot = ImuModel(np.random.default_rng(0), Pose.identity(), ImuSettings.ideal()).sample(
        0, _at_rest(), STEP_NS, _at_rest(), thrust=0.0
    )
    np.testing.assert_allclose(slot.accel_imu, [0.0, 0.0, 9.81], atol=1e-12)
    np.testing.assert_allclose(slot.gyro_imu, 0.0, atol=1e-12)
    assert slot.t_sensor_ns == STEP_NS


def test_a_chip_off_the_axis_of_rotation_feels_the_centripetal_and_tangential_terms() -> None:
    arm, rate, growth = 0.3, 4.0, 2.0
    start = Kinematics(np.zeros(3), np.zeros(3), rotation.IDENTITY, np.array([0.0, 0.0, rate]))
    end = Kinematics(
        np.zeros(3),
        np.zeros(3),
        rotation.from_yaw(rate * STEP_S + 0.5 * growth * STEP_S**2),
        np.array([0.0, 0.0, rate + growth * STEP_S]),
    )
    measured = true_inertial(start, end, STEP_S, Pose.of([arm, 0.0, 0.0], rotation.IDENTITY))
    np.testing.assert_allclose(measured[:3], [0.0, 0.0, rate + 0.5 * growth * STEP_S], atol=1e-12)
    assert measured[3] == pytest.approx(-arm * rate**2, rel=0.01)
    assert measured[4] == pytest.approx(arm * growth, rel=0.01)
    assert measured[5] == pytest.approx(9.81)


def test_integrating_the_samples_reproduces_the_motion_of_the_chip() -> None:
    rng = np.random.default_rng(6)
    T_body_imu = ImuModel(rng, MOUNT, ImuSettings.ideal()).T_body_imu
    state = Kinematics(np.zeros(3), np.array([1.0, 0.0, 0.5]), rotation.exp([0.1, -0.2, 1.0]), np.zeros(3))
    q = rotation.multiply(state.q_world_body, T_body_imu.q)
    v = state.v_world.copy()
    for _ in range(400):
        omega = state.omega_body + STEP_S * rng.uniform(-20.0, 20.0, 3)
        after = Kinematics(
            state.p_world,
            state.v_world + STEP_S * rng.uniform(-5.0, 5.0, 3),
            rotation.multiply(state.q_world_body, rotation.exp(0.5 * STEP_S * (state.omega_body + omega))),
            omega,
        )
        sample = true_inertial(state, after, STEP_S, T_body_imu)
        q_mid = rotation.multiply(q, rotation.exp(0.5 * STEP_S * sample[:3]))
        v = v + STEP_S * (rotation.rotate(q_mid, sample[3:]) + GRAVITY_WORLD)
        q = rotation.multiply(q, rotation.exp(STEP_S * sample[:3]))
        state = after
    arm_velocity = rotation.rotate(state.q_world_body, np.cross(state.omega_body, T_body_imu.p))
    np.testing.assert_allclose(v, state.v_world + arm_velocity, atol=1e-10)
    assert rotation.angle_between(q, rotation.multiply(state.q_world_body, T_body_imu.q)) < 1e-10


def test_the_chip_sits_where_the_manual_says() -> None:
    model = ImuModel(np.random.default_rng(0), Pose.identity(), ImuSettings())
    np.testing.assert_allclose(model.T_body_imu.p, [0.011, 0.02329, -0.04412])


def test_white_noise_has_the_densities_of_the_datasheet() -> None:
    settings = ImuSettings.ideal().model_copy(
        update={"gyro_noise_radps_per_sqrt_hz": 7.9e-5, "accel_noise_mps2_per_sqrt_hz": 9.8e-4}
    )
    model = ImuModel(np.random.default_rng(3), Pose.identity(), settings)
    slots = [model.sample(0, _at_rest(), STEP_NS, _at_rest(), 0.0) for _ in range(4000)]
    assert np.std([slot.gyro_imu for slot in slots]) == pytest.approx(7.9e-4, rel=0.03)
    assert np.std([slot.accel_imu for slot in slots], axis=0) == pytest.approx([9.8e-3] * 3, rel=0.06)


def test_biases_differ_between_units_and_are_what_the_samples_show() -> None:
    settings = ImuSettings(
        gyro_noise_radps_per_sqrt_hz=0.0, accel_noise_mps2_per_sqrt_hz=0.0, scale_error=0.0
    )
    biases = []
    for seed in range(200):
        model = ImuModel(np.random.default_rng(seed), Pose.identity(), settings)
        slot = model.sample(0, _at_rest(), STEP_NS, _at_rest(), 0.0)
        np.testing.assert_allclose(slot.gyro_imu, model.bias[:3], atol=1e-12)
        np.testing.assert_allclose(slot.accel_imu - [0.0, 0.0, 9.81], model.bias[3:], atol=1e-12)
        biases.append(model.bias)
    spread = np.std(biases, axis=0)
    assert spread[:3] == pytest.approx([math.radians(0.3)] * 3, rel=0.2)
    assert spread[3:] == pytest.approx([0.05] * 3, rel=0.2)


def test_the_bias_wanders_within_its_instability() -> None:
    settings = ImuSettings.ideal().model_copy(
        update={"accel_bias_instability_mps2": 0.01, "bias_time_s": 1.0}
    )
    model = ImuModel(np.random.default_rng(1), Pose.identity(), settings)
    biases = []
    for _ in range(6000):
        model.sample(0, _at_rest(), STEP_NS, _at_rest(), 0.0)
        biases.append(model.bias[3:])
    assert np.std(biases) == pytest.approx(0.01, rel=0.3)
    assert np.std(np.diff(biases, axis=0)) == pytest.approx(0.01 * math.sqrt(2 * STEP_S), rel=0.05)


def test_scale_errors_stay_within_their_bound() -> None:
    settings = ImuSettings.ideal().model_copy(update={"scale_error": 0.005})
    errors = []
    for seed in range(100):
        model = ImuModel(np.random.default_rng(seed), Pose.identity(), settings)
        errors.append(model.sample(0, _at_rest(), STEP_NS, _at_rest(), 0.0).accel_imu[2] / 9.81 - 1.0)
    assert 0.004 < np.abs(errors).max() <= 0.005


def test_a_hard_knock_saturates() -> None:
    settings = ImuSettings.ideal().model_copy(update={"accel_range_g": 4.0, "gyro_range_dps": 250.0})
    model = ImuModel(np.random.default_rng(0), Pose.identity(), settings)
    end = Kinematics(np.zeros(3), np.array([1.0, 0.0, 0.0]), rotation.from_yaw(0.5), np.zeros(3))
    slot = model.sample(0, _at_rest(), STEP_NS, end, 0.0)
    assert slot.accel_imu[0] == pytest.approx(4.0 * 9.80665)
    assert slot.gyro_imu[2] == pytest.approx(math.radians(250.0))


def test_equal_generators_give_equal_samples() -> None:
    def run(seed: int) -> list[bytes]:
        model = ImuModel(np.random.default_rng(seed), MOUNT, ImuSettings())
        slots = [model.sample(0, _at_rest(), STEP_NS, _at_rest(), 9.81) for _ in range(20)]
        return [slot.gyro_imu.tobytes() + slot.accel_imu.tobytes() for slot in slots]

    assert run(4) == run(4)
    assert run(4) != run(5)


def _vibration(thrust: float, share: float, n: int = 4000) -> FloatArray:
    model = Vibration(np.random.default_rng(9), VibrationSettings(harmonic_share=share))
    return np.array([model.step(STEP_S, thrust) for _ in range(n)])


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_vibration_in_hover_has_the_power_asked_for(share: float) -> None:
    rms = np.sqrt(np.mean(_vibration(9.81, share) ** 2, axis=0))
    assert rms[:3] == pytest.approx([0.01] * 3, rel=0.3)
    assert rms[3:] == pytest.approx([0.5] * 3, rel=0.3)


def test_stopped_motors_do_not_vibrate_and_a_climb_vibrates_more() -> None:
    assert not _vibration(0.0, 0.5, n=10).any()
    assert _vibration(14.0, 0.5).std() > 1.3 * _vibration(9.81, 0.5).std()


def test_rotor_tones_stand_out_of_the_broadband_shaking() -> None:
    spectrum = np.abs(np.fft.rfft(_vibration(9.81, 0.5)[:, 3])) ** 2
    assert spectrum.max() > 100.0 * np.median(spectrum)
    frequencies = np.fft.rfftfreq(4000, STEP_S)
    strongest = frequencies[np.argsort(spectrum)[-4:]]
    # Rotors turn at 95 Hz or nearly so; sampled at 200 Hz, twice that appears near 10 Hz.
    folded = np.minimum(np.abs(strongest - 95.0), np.abs(strongest - 10.0))
    assert folded.max() < 7.0
