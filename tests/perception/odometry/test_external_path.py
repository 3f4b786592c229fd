"""Between stated poses: the kernel against a slow oracle, and a way that leads through every pose."""

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.odometry import external_kernels
from companion.perception.odometry.external_path import DeadReckoning, P, R, StatedPath, V, motion_of
from companion.perception.odometry.inertial_history import InertialHistory

GRAVITY = 9.80665
START_NS = 40_000_000_000


def oracle(motion: FloatArray, t_s: FloatArray, inertial: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the last motion and all rows, computed plainly."""
    p, q, v = motion[P], rotation.from_matrix(motion[R].reshape(3, 3)), motion[V]
    rows = []
    accel, omega = np.zeros(3), np.zeros(3)
    for k, t in enumerate(t_s):
        row = [np.array([t]), p, rotation.to_matrix(q).ravel(), v]
        if k + 1 < len(t_s):
            dt = t_s[k + 1] - t
            omega = inertial[k, :3]
            q_middle = rotation.multiply(q, rotation.exp(0.5 * dt * omega))
            accel = rotation.rotate(q_middle, inertial[k, 3:]) - np.array([0.0, 0.0, GRAVITY])
            p, v = p + v * dt + 0.5 * accel * dt * dt, v + accel * dt
            q = rotation.multiply(q, rotation.exp(dt * omega))
        rows.append(np.concatenate([*row, accel, omega]))
    return motion_of(p, rotation.to_matrix(q), v), np.array(rows)


def random_motion(rng: np.random.Generator) -> FloatArray:
    R_map_imu = rotation.to_matrix(rotation.exp(rng.normal(size=3)))
    return motion_of(rng.normal(size=3), R_map_imu, rng.normal(size=3))


@pytest.mark.parametrize("count", [1, 2, 40])
def test_the_kernel_is_as_its_readable_form(count: int) -> None:
    rng = np.random.default_rng(count)
    motion = random_motion(rng)
    t_s = np.cumsum(rng.uniform(1e-3, 8e-3, count))
    inertial = rng.normal(size=(count - 1, 6)) * 3.0
    expected, rows = oracle(motion, t_s, inertial)
    segments = np.full((count + 3, 22), np.nan)
    external_kernels.dead_reckon(motion, t_s, inertial, GRAVITY, segments)
    np.testing.assert_allclose(motion, expected, atol=1e-9)
    np.testing.assert_allclose(segments[:count], rows, atol=1e-9)
    assert np.isnan(segments[count:]).all()


def history(rng: np.random.Generator, samples: int = 400) -> InertialHistory:
    found = InertialHistory()
    gyro = np.cumsum(rng.normal(size=(samples, 3)), axis=0) * 0.05
    accel = rng.normal(size=(samples, 3)) + np.array([0.0, 0.0, GRAVITY])
    for index in range(samples):
        found.append(START_NS + index * 5_000_000, gyro[index], accel[index], suspect=False)
    return found


def test_the_gyros_bias_is_taken_off() -> None:
    rng = np.random.default_rng(1)
    reckoning = DeadReckoning(GRAVITY)
    motion = random_motion(rng)
    other = motion.copy()
    samples = history(rng)
    reckoning.advance(motion, samples, START_NS, START_NS + 100_000_000)
    reckoning.gyro_bias = np.array([0.1, 0.0, 0.0])
    reckoning.advance(other, samples, START_NS, START_NS + 100_000_000)
    turn = rotation.log(rotation.from_matrix(motion[R].reshape(3, 3).T @ other[R].reshape(3, 3)))
    assert float(np.linalg.norm(turn)) == pytest.approx(0.01, rel=0.01)


def stated_path(rng: np.random.Generator, period_ns: int, count: int) -> tuple[StatedPath, list[FloatArray]]:
    """Return a way through poses that lie off where the IMU leads."""
    samples, reckoning, path = history(rng), DeadReckoning(GRAVITY), StatedPath()
    motions = [random_motion(rng)]
    path.begin(START_NS, motions[0])
    for index in range(count):
        start_ns = START_NS + index * period_ns
        predicted = motions[-1].copy()
        reckoning.advance(predicted, samples, start_ns, start_ns + period_ns)
        turn = rotation.to_matrix(rotation.exp(rng.normal(size=3) * 0.01))
        motion = motion_of(
            predicted[P] + rng.normal(size=3) * 0.02,
            predicted[R].reshape(3, 3) @ turn,
            predicted[V] + rng.normal(size=3) * 0.05,
        )
        path.extend(start_ns + period_ns, motion, reckoning.segments[: reckoning.count])
        motions.append(motion)
    return path, motions


@pytest.mark.parametrize("period_ns", [5_000_000, 13_000_000, 100_000_000])
def test_the_way_leads_through_every_stated_pose_without_a_step(period_ns: int) -> None:
    path, motions = stated_path(np.random.default_rng(2), period_ns, 8)
    for index in range(1, len(motions)):
        t_ns = START_NS + index * period_ns
        rows, motion, _ = path.between(START_NS, t_ns)
        np.testing.assert_allclose(motion, motions[index], atol=1e-9)
        assert rows[-1, 0] == pytest.approx((t_ns - START_NS) * 1e-9)
        if index + 1 < len(motions):  # just before and after the pose
            for shift_ns in (-1000, 1000):
                _, near, _ = path.between(START_NS, t_ns + shift_ns)
                np.testing.assert_allclose(near[P], motions[index][P], atol=1e-4)
                np.testing.assert_allclose(near[R], motions[index][R], atol=1e-4)
                np.testing.assert_allclose(near[V], motions[index][V], atol=1e-2)


def test_rows_between_two_instants_are_all_of_the_way_and_nothing_else() -> None:
    path, _ = stated_path(np.random.default_rng(3), 20_000_000, 10)
    start_ns, end_ns = START_NS + 33_000_000, START_NS + 151_000_000
    assert path.covers(start_ns, end_ns)
    rows, _, _ = path.between(start_ns, end_ns)
    assert rows[0, 0] <= 0.0 < rows[1, 0]
    assert np.all(np.diff(rows[:, 0]) > 0.0)
    assert rows[-1, 0] == pytest.approx(0.118)
    # Each row leads to the next one.
    dt = np.diff(rows[:, 0])[:, None]
    led = rows[:-1, 1:4] + (rows[:-1, 13:16] + 0.5 * rows[:-1, 16:19] * dt) * dt
    np.testing.assert_allclose(led, rows[1:, 1:4], atol=2e-4)


def test_what_is_not_known_is_not_covered() -> None:
    path, _ = stated_path(np.random.default_rng(4), 20_000_000, 10)
    end_ns = START_NS + 200_000_000
    assert path.end_ns == end_ns
    assert path.covers(START_NS, end_ns)
    assert not path.covers(START_NS - 1, end_ns)
    assert not path.covers(START_NS, end_ns + 1)
    path.begin(end_ns, np.zeros(15))
    assert not path.covers(end_ns, end_ns)


def test_a_clock_that_was_set_moves_the_whole_way() -> None:
    path, motions = stated_path(np.random.default_rng(5), 20_000_000, 10)
    path.relabel(-START_NS)
    assert not path.covers(START_NS, START_NS + 100)
    _, motion, _ = path.between(0, 40_000_000)
    np.testing.assert_allclose(motion, motions[2], atol=1e-9)


def test_memory_is_bounded_and_the_newest_stays() -> None:
    path, predicted = StatedPath(), np.zeros((2, 22))
    predicted[1, 0] = 0.005
    predicted[:, 4:13] = np.eye(3).ravel()
    motion = motion_of(np.zeros(3), np.eye(3), np.zeros(3))
    path.begin(0, motion)
    for index in range(1, 10_000):
        path.extend(index * 5_000_000, motion, predicted)
    assert path.covers(path.end_ns - 5_000_000_000, path.end_ns)
    assert not path.covers(0, path.end_ns)
