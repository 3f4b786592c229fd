"""Signs, frames and covariances on their way to PX4, against examples worked by hand."""

import math

import numpy as np
import pytest

from companion.drivers import px4_messages
from companion.geometry import rotation
from companion.geometry.rotation import FloatArray
from companion.messages import Severity, StatusText
from tests.drivers.px4_peer import a_setpoint, an_odometry

QUARTER = math.sqrt(0.5)


def odometry_fields(**changes: object) -> dict[str, object]:
    fields = px4_messages.external_odometry(an_odometry(0, **changes), 123, 0.1)
    assert fields is not None
    return fields


def vector(fields: dict[str, object], *names: str) -> list[float]:
    return [float(str(fields[name])) for name in names]


def test_forward_left_up_leaves_as_forward_right_down() -> None:
    fields = px4_messages.velocity_setpoint(a_setpoint(0, (1.0, 2.0, 3.0), 0.5), 7, 2**32 + 5)
    assert fields is not None
    assert vector(fields, "vx", "vy", "vz") == [1.0, -2.0, -3.0]
    # A turn to the left, seen from above, is negative about the axis that points down.
    assert fields["yaw_rate"] == -0.5
    assert (fields["coordinate_frame"], fields["type_mask"]) == (1, 0x5C7)
    assert (fields["target_system"], fields["target_component"]) == (7, 1)
    assert fields["time_boot_ms"] == 5


def test_the_type_mask_uses_velocity_and_yaw_rate_only() -> None:
    used = [bit for bit in range(12) if not 0x5C7 >> bit & 1]
    assert used == [3, 4, 5, 9, 11]  # vx, vy, vz; bit 9 would turn acceleration into force; yaw rate


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e39, 1e7])
@pytest.mark.parametrize("axis", range(4))
def test_a_number_that_is_not_finite_in_float32_never_leaves(bad: float, axis: int) -> None:
    numbers = [0.0, 0.0, 0.0, 0.0]
    numbers[axis] = bad
    assert px4_messages.velocity_setpoint(a_setpoint(0, tuple(numbers[:3]), numbers[3]), 7, 0) is None


def test_odometry_says_vio_in_local_frd() -> None:
    fields = odometry_fields(reset_counter=257, quality=88)
    assert (fields["frame_id"], fields["child_frame_id"], fields["estimator_type"]) == (20, 12, 3)
    assert (fields["reset_counter"], fields["quality"], fields["time_usec"]) == (1, 88, 123)


def test_a_body_turned_left_moves_forward_when_the_map_velocity_points_left() -> None:
    q_map_body = rotation.from_yaw(math.pi / 2)
    fields = odometry_fields(q_map_body=q_map_body, v_map=np.array([0.0, 2.0, 0.5]))
    assert vector(fields, "vx", "vy", "vz") == pytest.approx([2.0, 0.0, -0.5])
    # Left about up is minus 90 degrees about down.
    assert fields["q"] == pytest.approx([QUARTER, 0.0, 0.0, -QUARTER])
    assert vector(fields, "x", "y", "z") == [1.0, -2.0, -3.0]
    assert vector(fields, "rollspeed", "pitchspeed", "yawspeed") == [0.01, -0.02, -0.03]


def test_nose_up_stays_nose_up() -> None:
    # About the left axis a positive angle lowers the nose; about the right axis it raises it.
    nose_up = np.array([math.cos(0.1), 0.0, -math.sin(0.1), 0.0])
    assert odometry_fields(q_map_body=nose_up)["q"] == pytest.approx([math.cos(0.1), 0.0, math.sin(0.1), 0.0])


@pytest.mark.parametrize("scale", [1.0, 0.9999, 1.3])
def test_the_quaternion_is_normal_in_float32(scale: float) -> None:
    rng = np.random.default_rng(1)
    for q in rng.normal(size=(200, 4)):
        sent = np.asarray(odometry_fields(q_map_body=scale * q / np.linalg.norm(q))["q"], dtype=np.float32)
        assert abs(float(np.linalg.norm(sent.astype(np.float64))) - 1.0) < 1e-6


def upper(fields: dict[str, object], name: str) -> FloatArray:
    full = np.zeros((6, 6))
    full[np.triu_indices(6)] = np.asarray(fields[name])
    return full + np.triu(full, 1).T


def test_the_diagonal_lies_where_px4_reads_it() -> None:
    sent = odometry_fields()["pose_covariance"]
    assert isinstance(sent, list)
    assert len(sent) == 21
    assert [sent[i] for i in (0, 6, 11)] == pytest.approx([1e-4, 2e-4, 3e-4])
    assert [sent[i] for i in (15, 18, 20)] == pytest.approx([4e-6, 5e-6, 6e-6])
    velocity = odometry_fields()["velocity_covariance"]
    assert isinstance(velocity, list)
    assert [velocity[i] for i in (0, 6, 11, 15)] == pytest.approx([1e-3, 2e-3, 3e-3, 0.01])


def test_velocity_uncertainty_turns_into_the_body() -> None:
    fields = odometry_fields(
        q_map_body=rotation.from_yaw(math.pi / 2), covariance_velocity=np.diag([1.0, 4.0, 9.0])
    )
    # The map's left is the body's front; the map's front is the body's right.
    assert np.diag(upper(fields, "velocity_covariance"))[:3] == pytest.approx([4.0, 1.0, 9.0])


def test_a_mixed_term_changes_sign_with_one_axis_only() -> None:
    covariance = np.eye(6)
    covariance[0, 1] = covariance[1, 0] = 0.5  # x with y: one axis flips
    covariance[1, 2] = covariance[2, 1] = 0.25  # y with z: both flip
    sent = upper(odometry_fields(covariance_pose=covariance), "pose_covariance")
    assert sent[0, 1] == pytest.approx(-0.5)
    assert sent[1, 2] == pytest.approx(0.25)


def euler_of(q_frd: FloatArray) -> FloatArray:
    R = rotation.to_matrix(q_frd)
    return np.array([math.atan2(R[2, 1], R[2, 2]), -math.asin(R[2, 0]), math.atan2(R[1, 0], R[0, 0])])


def test_the_angles_covariance_is_what_sampling_finds() -> None:
    rng = np.random.default_rng(2)
    q_map_body = rotation.exp([0.4, -0.3, 1.0])
    root = rng.normal(size=(3, 3)) * 1e-4
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = root @ root.T
    flip = np.array([1.0, 1.0, -1.0, -1.0])
    nominal = euler_of(q_map_body * flip)
    samples = []
    for theta in rng.normal(size=(4000, 3)) @ root.T:
        q = rotation.multiply(q_map_body, rotation.exp(theta))
        samples.append(euler_of(q * flip) - nominal)
    expected = np.cov(np.array(samples).T)
    found = px4_messages.pose_covariance_frd(covariance, q_map_body)[3:, 3:]
    assert found == pytest.approx(expected, rel=0.12, abs=0.05 * float(np.max(np.abs(expected))))


@pytest.mark.parametrize(
    "name", ["p_map", "q_map_body", "v_map", "omega_body", "covariance_pose", "covariance_velocity"]
)
@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e39])
def test_odometry_with_one_bad_number_never_leaves(name: str, bad: float) -> None:
    array = np.array(getattr(an_odometry(0), name))
    array.flat[0] = bad
    assert px4_messages.external_odometry(an_odometry(0, **{name: array}), 1, 0.1) is None


def test_a_text_is_prefixed_ascii_and_at_most_fifty_characters() -> None:
    fields = px4_messages.status_text(StatusText(0, Severity.WARNING, "höhe\nzu groß " + "x" * 60))
    assert fields["text"] == ("CMP: h?he zu gro? " + "x" * 60)[:50]
    assert fields["severity"] == 4
    again = px4_messages.status_text(StatusText(0, Severity.INFO, "CMP: ready"))
    assert again["text"] == "CMP: ready"
