import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.geometry.trajectory import Trajectory
from companion.messages import FloatArray
from sitl.bench.judgement import drift_percent, judge

STEPS = 601


def _straight(length_m: float, share: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Return a path along x whose length is off by a factor, and its attitudes."""
    p = np.zeros((STEPS, 3))
    p[:, 0] = share * np.linspace(0.0, length_m, STEPS)
    return p, np.tile(rotation.IDENTITY, (STEPS, 1))


def _trajectory(p: FloatArray, q: FloatArray) -> Trajectory:
    return Trajectory(np.arange(len(p), dtype=np.int64) * 100_000_000, p, q)


def _circle() -> tuple[FloatArray, FloatArray]:
    angle = np.linspace(0.0, 6.0 * np.pi, STEPS)
    p = np.column_stack([10.0 * np.cos(angle), 10.0 * np.sin(angle), 0.1 * angle])
    return p, rotation.from_yaw(angle + np.pi / 2.0)


@pytest.mark.parametrize("length_m", [5.0, 30.0, 120.0])
def test_a_path_that_is_one_percent_too_long_drifts_by_one_percent(length_m: float) -> None:
    assert drift_percent(*_straight(length_m, 1.01), *_straight(length_m)) == pytest.approx(1.0, rel=1e-6)


def test_a_wrong_start_attitude_and_place_are_no_drift() -> None:
    p, q = _circle()
    elsewhere = Pose.of([5.0, -3.0, 1.0], rotation.exp([0.3, -0.2, 1.0]))
    moved = elsewhere.transform(p)
    assert drift_percent(moved, rotation.multiply(elsewhere.q, q), p, q) == pytest.approx(0.0, abs=1e-6)
    judged = judge(_trajectory(moved, rotation.multiply(elsewhere.q, q)), _trajectory(p, q))
    assert judged is not None
    assert judged.ape_rmse_m == pytest.approx(0.0, abs=1e-9)
    assert judged.attitude_rmse_deg == pytest.approx(0.0, abs=1e-4)
    np.testing.assert_allclose(judged.p_laid, p, atol=1e-9)


def test_a_slow_turn_of_the_heading_is_drift_even_on_a_closed_path() -> None:
    p, q = _circle()
    turned = rotation.from_yaw(np.radians(1.0) * np.linspace(0.0, 1.0, STEPS))
    steps = rotation.rotate(turned[:-1], np.diff(p, axis=0))
    bent = np.concatenate([p[:1], p[0] + np.cumsum(steps, axis=0)])
    drift = drift_percent(bent, rotation.multiply(turned, q), p, q)
    assert drift is not None
    assert 0.05 < drift < 0.5


def test_a_bounded_error_weighs_less_on_longer_stretches() -> None:
    p, q = _straight(120.0)
    noise = np.random.default_rng(1).normal(0.0, 0.01, p.shape)
    drift = drift_percent(p + noise, q, p, q)
    # Two independent errors of 1 cm an axis are 2.26 cm apart on average, over 20, 40 and 80 m.
    assert drift == pytest.approx(100.0 * 0.0226 * np.mean([1 / 20, 1 / 40, 1 / 80]), rel=0.1)


def test_who_does_not_move_cannot_drift() -> None:
    assert drift_percent(*_straight(0.5), *_straight(0.5)) is None


def test_only_times_that_both_know_are_compared() -> None:
    truth = _trajectory(*_circle())
    shifted = Trajectory(truth.t_ns + 1, truth.p, truth.q)
    assert judge(shifted, truth) is None
    half = Trajectory(truth.t_ns[::2].copy(), truth.p[::2].copy(), truth.q[::2].copy())
    judged = judge(half, truth)
    assert judged is not None
    assert len(judged.t_ns) == len(half)
