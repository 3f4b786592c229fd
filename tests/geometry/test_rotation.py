"""Rotations obey the group's laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.geometry import rotation
from companion.geometry.rotation import FloatArray

vectors = arrays(np.float64, (3,), elements=st.floats(-3.0, 3.0))
attitudes = vectors.map(lambda theta: rotation.normalize(rotation.exp(theta)))


@given(vectors)
def test_exp_matches_the_series_of_the_matrix_exponential(theta: FloatArray) -> None:
    skew = np.array([[0, -theta[2], theta[1]], [theta[2], 0, -theta[0]], [-theta[1], theta[0], 0]])
    series, term = np.eye(3), np.eye(3)
    for order in range(1, 60):
        term = term @ skew / order
        series = series + term
    np.testing.assert_allclose(rotation.to_matrix(rotation.exp(theta)), series, atol=1e-9)


@given(vectors)
def test_log_undoes_exp_within_half_a_turn(theta: FloatArray) -> None:
    shortened = theta * min(1.0, 3.0 / max(float(np.linalg.norm(theta)), 1e-9))
    np.testing.assert_allclose(rotation.log(rotation.exp(shortened)), shortened, atol=1e-9)


@given(attitudes, attitudes, vectors)
def test_composition_rotates_twice(q_a_b: FloatArray, q_b_c: FloatArray, v_c: FloatArray) -> None:
    once = rotation.rotate(rotation.multiply(q_a_b, q_b_c), v_c)
    np.testing.assert_allclose(once, rotation.rotate(q_a_b, rotation.rotate(q_b_c, v_c)), atol=1e-9)


@given(attitudes)
def test_matrix_and_quaternion_are_the_same_rotation(q: FloatArray) -> None:
    R = rotation.to_matrix(q)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert float(rotation.angle_between(rotation.from_matrix(R), q)) < 1e-7


@pytest.mark.parametrize("axis", [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0.6, 0.8, 0]])
def test_a_half_turn_survives_the_matrix_form(axis: list[float]) -> None:
    q = rotation.exp(np.pi * np.array(axis))
    assert float(rotation.angle_between(rotation.from_matrix(rotation.to_matrix(q)), q)) < 1e-7


@given(attitudes, attitudes, st.floats(0.0, 1.0))
def test_slerp_moves_in_proportion(q_start: FloatArray, q_end: FloatArray, fraction: float) -> None:
    middle = rotation.slerp(q_start, q_end, fraction)
    whole = float(rotation.angle_between(q_start, q_end))
    assert float(rotation.angle_between(q_start, middle)) == pytest.approx(fraction * whole, abs=1e-7)


@given(st.floats(-3.1, 3.1))
def test_yaw_is_the_heading_of_the_x_axis(yaw: float) -> None:
    assert float(rotation.yaw_of(rotation.from_yaw(yaw))) == pytest.approx(yaw)


def test_one_quaternion_is_normalised_to_the_bits_of_many() -> None:
    q = np.random.default_rng(3).standard_normal((500, 4)) * np.logspace(-9.0, 9.0, 500)[:, None]
    assert np.array_equal(rotation.normalize(q), [rotation.normalize(one) for one in q])


def test_batches_equal_single_results() -> None:
    generator = np.random.default_rng(0)
    q = rotation.normalize(generator.normal(size=(5, 4)))
    v = generator.normal(size=(5, 3))
    single = np.stack([rotation.rotate(q[i], v[i]) for i in range(5)])
    np.testing.assert_array_equal(rotation.rotate(q, v), single)


@pytest.mark.parametrize("q", [[0.0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 0]])
def test_a_quaternion_without_direction_is_refused(q: list[float]) -> None:
    with pytest.raises(ValueError, match="finite and not zero"):
        rotation.normalize(q)


@given(vectors, vectors)
def test_single_rotations_have_the_bits_of_those_in_arrays(theta: FloatArray, v_b: FloatArray) -> None:
    q = rotation.exp(theta)
    other = rotation.exp(v_b)
    pairs = [
        (q, rotation.exp(theta[None])[0]),
        (rotation.multiply(q, other), rotation.multiply(q[None], other[None])[0]),
        (rotation.rotate(q, v_b), rotation.rotate(q[None], v_b[None])[0]),
        (rotation.to_matrix(q), rotation.to_matrix(q[None])[0]),
        (rotation.from_yaw(theta[2]), rotation.from_yaw(theta[2:])[0]),
        (rotation.yaw_of(q), rotation.yaw_of(q[None])[0]),
    ]
    for alone, in_array in pairs:
        assert alone.tobytes() == in_array.tobytes()
