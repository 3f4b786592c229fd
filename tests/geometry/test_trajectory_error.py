import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geometry import rotation, trajectory_error
from companion.geometry.pose import Pose
from companion.messages import FloatArray


def _path(n: int = 400) -> tuple[FloatArray, FloatArray]:
    s = np.linspace(0.0, 20.0, n)
    p = np.stack([s, 3.0 * np.sin(0.3 * s), 0.5 * np.cos(s)], axis=1)
    return p, rotation.exp(np.stack([0.1 * np.sin(s), 0.05 * np.cos(s), 0.2 * s], axis=1))


def _moved(T: Pose, p: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    return T.transform(p), rotation.multiply(T.q, q)


def test_a_rigidly_moved_trajectory_has_no_absolute_and_no_relative_error() -> None:
    p, q = _path()
    T = Pose.of([4.0, -2.0, 1.0], rotation.exp([0.3, 1.0, -2.0]))
    p_moved, q_moved = _moved(T, p, q)
    ape = trajectory_error.absolute_error(p_moved, q_moved, p, q)
    assert ape.max_m < 1e-9
    assert ape.rotation_rmse_deg < 1e-5
    assert trajectory_error.relative_error(p_moved, q_moved, p, q, 5.0).max_m < 1e-9
    assert trajectory_error.drift_percent(p_moved, q_moved, p, q) < 1e-9


def test_alignment_never_mirrors() -> None:
    p, _ = _path()
    T = trajectory_error.align(p * [1.0, 1.0, -1.0], p)
    assert float(np.linalg.det(rotation.to_matrix(T.q))) == pytest.approx(1.0)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_alignment_undoes_any_rigid_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = rng.normal(size=(20, 3))
    moved = rotation.rotate(rotation.exp(rng.normal(size=3)), p) + rng.normal(size=3) * 10.0
    assert trajectory_error.align(p, moved).transform(p) == pytest.approx(moved, abs=1e-9)


def test_white_noise_gives_its_own_deviation_as_absolute_error() -> None:
    p, q = _path(5000)
    noisy = p + np.random.default_rng(0).normal(0.0, 0.02, p.shape)
    ape = trajectory_error.absolute_error(noisy, q, p, q)
    assert ape.rmse_m == pytest.approx(0.02 * np.sqrt(3.0), rel=0.05)


def test_a_scale_error_shows_as_drift_and_relative_error() -> None:
    s = np.linspace(0.0, 50.0, 501)
    p = np.stack([s, np.zeros_like(s), np.zeros_like(s)], axis=1)
    q = np.tile(rotation.IDENTITY, (501, 1))
    assert trajectory_error.drift_percent(1.01 * p, q, p, q) == pytest.approx(1.0)
    assert trajectory_error.relative_error(1.01 * p, q, p, q, 10.0).rmse_m == pytest.approx(0.1, rel=1e-3)


def test_a_heading_error_at_the_start_does_not_count_as_drift() -> None:
    p, q = _path()
    yaw = Pose.of([0.0, 0.0, 0.0], rotation.from_yaw(0.1))
    p_turned, q_turned = _moved(yaw, p, q)
    assert trajectory_error.drift_percent(p_turned, q_turned, p, q) < 1e-9
    assert trajectory_error.drift_percent(p_turned, q, p, q) > 1.0


def test_impossible_requests_are_refused() -> None:
    p, q = _path(10)
    with pytest.raises(ValueError, match="cannot align"):
        trajectory_error.align(p[:2], p[:2])
    with pytest.raises(ValueError, match="shorter than a stretch"):
        trajectory_error.relative_error(p, q, p, q, 1000.0)
    with pytest.raises(ValueError, match="needs a path"):
        trajectory_error.drift_percent(p, q, np.zeros_like(p), q)
