import numpy as np
import pytest

from companion.geometry import rotation
from companion.geometry.rotation import FloatArray
from companion.geometry.trajectory_comparison import compare, path_length


def helix(t: FloatArray) -> FloatArray:
    return np.column_stack([np.sin(t), 2.0 * np.cos(t), 0.3 * t])


def test_an_estimate_in_another_level_frame_has_no_error() -> None:
    t = np.linspace(0.0, 10.0, 400)
    q_map_world = rotation.from_yaw(1.2)
    p_world = helix(t)
    q_world = rotation.from_yaw(0.3 * t)
    p_map = rotation.rotate(q_map_world, p_world - p_world[0])
    q_map = rotation.multiply(q_map_world, q_world)
    found = compare(t, p_map, q_map, t, p_world, q_world)
    assert found is not None
    assert found.error_m == pytest.approx(np.zeros(400), abs=1e-12)
    assert found.ape_rmse_m == pytest.approx(0.0, abs=1e-12)
    assert found.drift_percent == pytest.approx(0.0, abs=1e-9)


def test_drift_is_the_end_error_over_the_path() -> None:
    t = np.linspace(0.0, 10.0, 101)
    truth = np.column_stack([t, 0.0 * t, 0.0 * t])
    estimate = truth + np.column_stack([0.0 * t, 0.02 * t, 0.0 * t])
    q = np.tile(rotation.IDENTITY, (101, 1))
    found = compare(t, estimate, q, t, truth, q)
    assert found is not None
    assert found.path_m == pytest.approx(10.0)
    assert found.end_error_m == pytest.approx(0.2)
    assert found.drift_percent == pytest.approx(2.0)
    # A line that drifts sideways is a slightly longer line turned: almost nothing is left aligned.
    assert found.ape_rmse_m < 1e-3


def test_only_the_common_time_is_compared_and_too_little_gives_nothing() -> None:
    t = np.linspace(0.0, 10.0, 101)
    q = np.tile(rotation.IDENTITY, (101, 1))
    late = t >= 6.0
    found = compare(t, helix(t), q, t[late], helix(t)[late], q[late])
    assert found is not None
    assert found.t[0] == pytest.approx(6.0)
    assert compare(t, helix(t), q, t[late] + 10.0, helix(t)[late], q[late]) is None
    assert compare(t[:2], helix(t)[:2], q[:2], t, helix(t), q) is None
    broken = helix(t)
    broken[5] = np.nan
    found = compare(t, broken, q, t, helix(t), q)
    assert found is not None
    assert len(found.t) == 100
    assert compare(t, helix(t), q, t, broken, q) is None
    assert compare(t, helix(t), q, t, helix(t), 0.0 * q) is None
    assert compare(t, 1e300 * helix(t), q, t, helix(t), q) is None


def test_noise_of_a_standing_vehicle_adds_no_distance() -> None:
    rng = np.random.default_rng(1)
    assert path_length(rng.normal(scale=0.01, size=(5000, 3)), 0.1) == 0.0
    assert path_length(helix(np.linspace(0.0, 10.0, 5000)), 0.1) == pytest.approx(
        np.linalg.norm(np.diff(helix(np.linspace(0.0, 10.0, 5000)), axis=0), axis=1).sum(), rel=0.02
    )
    assert path_length(np.zeros((0, 3)), 0.1) == 0.0
