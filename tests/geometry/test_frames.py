"""Axis conventions, checked on directions one can point at."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.geometry import frames, rotation
from companion.geometry.pose import Pose, interpolate
from companion.geometry.rotation import FloatArray

vectors = arrays(np.float64, (3,), elements=st.floats(-3.0, 3.0))
attitudes = vectors.map(lambda theta: rotation.normalize(rotation.exp(theta)))


def test_up_is_negative_down_and_left_is_negative_right() -> None:
    np.testing.assert_array_equal(frames.frd_from_flu([1.0, 2.0, 3.0]), [1.0, -2.0, -3.0])


def test_east_north_up_becomes_north_east_down() -> None:
    np.testing.assert_array_equal(frames.ned_from_enu([1.0, 2.0, 3.0]), [2.0, 1.0, -3.0])


@pytest.mark.parametrize(("yaw_enu_deg", "yaw_ned_deg"), [(0, 90), (90, 0), (180, -90), (-90, 180)])
def test_heading_east_reads_zero_in_enu_and_ninety_in_ned(yaw_enu_deg: float, yaw_ned_deg: float) -> None:
    q_ned = frames.q_ned_frd_from_enu_flu(rotation.from_yaw(np.radians(yaw_enu_deg)))
    difference = float(rotation.yaw_of(q_ned)) - np.radians(yaw_ned_deg)
    assert np.cos(difference) == pytest.approx(1.0)


@given(attitudes, vectors)
def test_attitude_conversion_agrees_with_vector_conversion(q_flu: FloatArray, v_body: FloatArray) -> None:
    q_frd = frames.q_frd_from_flu(q_flu)
    expected = frames.frd_from_flu(rotation.rotate(q_flu, v_body))
    np.testing.assert_allclose(rotation.rotate(q_frd, frames.frd_from_flu(v_body)), expected, atol=1e-9)


@given(attitudes, vectors)
def test_ned_attitude_agrees_with_vector_conversion(q_enu: FloatArray, v_body: FloatArray) -> None:
    q_ned = frames.q_ned_frd_from_enu_flu(q_enu)
    expected = frames.ned_from_enu(rotation.rotate(q_enu, v_body))
    np.testing.assert_allclose(rotation.rotate(q_ned, frames.frd_from_flu(v_body)), expected, atol=1e-9)


@given(attitudes)
def test_attitude_conversions_are_their_own_inverse(q: FloatArray) -> None:
    there_and_back = frames.q_flu_from_frd(frames.q_frd_from_flu(q))
    assert float(rotation.angle_between(there_and_back, q)) < 1e-7
    there_and_back = frames.q_enu_flu_from_ned_frd(frames.q_ned_frd_from_enu_flu(q))
    assert float(rotation.angle_between(there_and_back, q)) < 1e-7


def test_covariance_keeps_variances_and_flips_mixed_terms() -> None:
    covariance = np.arange(9.0).reshape(3, 3)
    converted = frames.covariance_frd_from_flu(covariance + covariance.T)
    np.testing.assert_array_equal(np.diag(converted), np.diag(covariance + covariance.T))
    assert converted[0, 1] == -(covariance + covariance.T)[0, 1]
    assert converted[1, 2] == (covariance + covariance.T)[1, 2]


@given(vectors, attitudes, vectors, attitudes, vectors)
def test_poses_chain_and_invert(
    p_1: FloatArray, q_1: FloatArray, p_2: FloatArray, q_2: FloatArray, point: FloatArray
) -> None:
    T_a_b, T_b_c = Pose.of(p_1, q_1), Pose.of(p_2, q_2)
    expected = T_a_b.transform(T_b_c.transform(point))
    np.testing.assert_allclose((T_a_b @ T_b_c).transform(point), expected, atol=1e-8)
    np.testing.assert_allclose(T_a_b.inverse().transform(T_a_b.transform(point)), point, atol=1e-8)


def test_interpolation_meets_both_ends_and_the_middle() -> None:
    start, end = Pose.identity(), Pose.of([2.0, 0.0, 0.0], rotation.from_yaw(np.pi / 2))
    middle = interpolate(start, end, 0.5)
    np.testing.assert_allclose(middle.p, [1.0, 0.0, 0.0])
    assert float(rotation.yaw_of(middle.q)) == pytest.approx(np.pi / 4)
    np.testing.assert_allclose(interpolate(start, end, 1.0).q, end.q, atol=1e-12)
