import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.perception.odometry import kernels
from companion.perception.odometry.state import NavigationState

DT = 0.005


def _state(seed: int = 0) -> NavigationState:
    rng = np.random.default_rng(seed)
    vector = np.zeros(24)
    vector[0:3] = rng.normal(0.0, 5.0, 3)
    vector[3:12] = rotation.to_matrix(rotation.exp(rng.normal(0.0, 1.0, 3))).ravel()
    vector[12:15] = rng.normal(0.0, 2.0, 3)
    vector[15:21] = rng.normal(0.0, 0.05, 6)
    vector[21:24] = [0.0, 0.0, -9.81]
    root = rng.normal(0.0, 0.1, (18, 18))
    return NavigationState(0, vector, root @ root.T)


def _propagate(state: NavigationState, inertial: FloatArray, noise: float = 0.0) -> FloatArray:
    count = len(inertial)
    segments = np.zeros((count + 1, kernels.SEGMENT_WIDTH))
    kernels.propagate(
        state.vector,
        state.covariance,
        np.asarray(DT * np.arange(count + 1), dtype=np.float64),
        np.ascontiguousarray(inertial),
        np.full((count, 4), noise),
        segments,
    )
    return segments


def _one_step(state: NavigationState, inertial: FloatArray) -> NavigationState:
    """The same interval, readably."""
    omega = inertial[:3] - state.gyro_bias
    force = inertial[3:] - state.accel_bias
    q = rotation.from_matrix(state.R_map_imu)
    middle = rotation.multiply(q, rotation.exp(0.5 * DT * omega))
    acceleration = rotation.rotate(middle, force) + state.g_map
    after = state.copy()
    after.p_map[:] += state.v_map * DT + 0.5 * acceleration * DT**2
    after.v_map[:] += acceleration * DT
    after.vector[3:12] = rotation.to_matrix(rotation.multiply(q, rotation.exp(omega * DT))).ravel()
    return after


def _difference(a: NavigationState, b: NavigationState) -> FloatArray:
    turn = rotation.multiply(
        rotation.conjugate(rotation.from_matrix(b.R_map_imu)), rotation.from_matrix(a.R_map_imu)
    )
    return np.concatenate([a.p_map - b.p_map, rotation.log(turn), a.vector[12:24] - b.vector[12:24]])


def test_at_rest_nothing_moves() -> None:
    state = _state()
    state.v_map[:] = 0.0
    before = state.copy()
    measured = np.concatenate([state.gyro_bias, state.accel_bias - state.R_map_imu.T @ state.g_map])
    _propagate(state, np.tile(measured, (400, 1)))
    np.testing.assert_allclose(state.vector, before.vector, atol=1e-9)


def test_pure_rotation_gives_the_exponential_of_rate_times_time() -> None:
    state = _state()
    q_before = rotation.from_matrix(state.R_map_imu)
    omega = np.array([0.7, -1.1, 2.0])
    _propagate(state, np.tile(np.concatenate([omega + state.gyro_bias, np.zeros(3)]), (400, 1)))
    expected = rotation.multiply(q_before, rotation.exp(omega * 400 * DT))
    assert float(rotation.angle_between(rotation.from_matrix(state.R_map_imu), expected)) < 1e-9


def test_constant_acceleration_gives_half_a_t_squared() -> None:
    state = _state()
    before = state.copy()
    acceleration = np.array([0.5, -1.0, 0.3])
    force = state.R_map_imu.T @ (acceleration - state.g_map) + state.accel_bias
    _propagate(state, np.tile(np.concatenate([state.gyro_bias, force]), (400, 1)))
    t = 400 * DT
    np.testing.assert_allclose(state.v_map, before.v_map + acceleration * t, atol=1e-9)
    np.testing.assert_allclose(
        state.p_map, before.p_map + before.v_map * t + 0.5 * acceleration * t**2, atol=1e-9
    )


@pytest.mark.parametrize("seed", range(5))
def test_every_interval_agrees_with_the_readable_integration(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = _state(seed)
    expected = state.copy()
    inertial = rng.normal(0.0, 3.0, (10, 6))
    segments = _propagate(state, inertial)
    for k in range(10):
        np.testing.assert_allclose(segments[k, 1:16], np.concatenate([expected.vector[:15]]), atol=1e-9)
        expected = _one_step(expected, inertial[k])
    np.testing.assert_allclose(state.vector, expected.vector, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_covariance_follows_the_numerical_jacobian(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = _state(seed)
    prior = state.covariance.copy()
    inertial = rng.normal(0.0, 3.0, 6)
    nominal = _one_step(state, inertial)
    jacobian = np.zeros((18, 18))
    for i in range(18):
        moved = []
        for sign in (1.0, -1.0):
            error = np.zeros(18)
            error[i] = sign * 1e-6
            shifted = state.copy()
            shifted.vector[0:3] += error[0:3]
            q = rotation.multiply(rotation.from_matrix(state.R_map_imu), rotation.exp(error[3:6]))
            shifted.vector[3:12] = rotation.to_matrix(q).ravel()
            shifted.vector[12:24] += error[6:18]
            moved.append(_difference(_one_step(shifted, inertial), nominal))
        jacobian[:, i] = (moved[0] - moved[1]) / 2e-6
    _propagate(state, inertial[None, :])
    np.testing.assert_allclose(state.covariance, jacobian @ prior @ jacobian.T, atol=2e-4)
    np.testing.assert_array_equal(state.covariance, state.covariance.T)


def test_white_noise_accumulates_with_time() -> None:
    state = _state()
    state.covariance[:] = 0.0
    _propagate(state, np.zeros((200, 6)), noise=1e-4)
    # Per axis the rate's noise q t and the bias walk's q t^3 / 3, after one second.
    assert float(np.trace(state.covariance[3:6, 3:6])) == pytest.approx(
        3.0 * 1e-4 * (1.0 + 1.0 / 3.0), rel=0.02
    )
    assert state.covariance[12, 12] == pytest.approx(1e-4, rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_deskewed_points_lie_where_the_motion_puts_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = _state(seed)
    inertial = rng.normal(0.0, 2.0, (20, 6))
    inertial[:, 5] += 9.8
    segments = _propagate(state, inertial)
    points_lidar = rng.normal(0.0, 10.0, (300, 3)).astype(np.float32)
    offsets_ns = rng.integers(0, 100_000_000, 300).astype(np.int32)
    q_imu_lidar = rotation.exp([0.1, -0.2, 0.3])
    t_imu_lidar = np.array([-0.01, 0.02, 0.05])
    packed = np.concatenate([rotation.to_matrix(q_imu_lidar).ravel(), t_imu_lidar])
    points_imu = np.zeros((300, 3))
    kernels.deskew(points_lidar, offsets_ns, segments, 21, packed, points_imu)
    for i in range(300):
        t = offsets_ns[i] * 1e-9
        row = segments[min(int(t / DT + 1e-9), 19)]
        since = t - row[0]
        R = row[4:13].reshape(3, 3) @ rotation.to_matrix(rotation.exp(row[19:22] * since))
        p = row[1:4] + row[13:16] * since + 0.5 * row[16:19] * since**2
        p_map = R @ (rotation.rotate(q_imu_lidar, points_lidar[i].astype(float)) + t_imu_lidar) + p
        expected = state.R_map_imu.T @ (p_map - state.p_map)
        np.testing.assert_allclose(points_imu[i], expected, atol=2e-5)


def test_thinning_keeps_the_first_point_of_every_cell() -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(0.0, 4.0, (3000, 3))
    keys, stamps = np.zeros(8192, np.int64), np.zeros(8193, np.int64)
    chosen = np.zeros(3000, np.int64)
    for cell_m in (0.3, 1.0, 0.3):  # scratch memory is used again
        count = kernels.thin(points, cell_m, keys, stamps, chosen)
        first: dict[tuple[int, ...], int] = {}
        for i, cell in enumerate(np.floor(points / cell_m).astype(int).tolist()):
            first.setdefault(tuple(cell), i)
        assert chosen[:count].tolist() == sorted(first.values())
