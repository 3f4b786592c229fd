import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.linalg import expm

from companion.messages import FloatArray
from companion.perception.tracking import motion_filter
from companion.perception.tracking.association import gated_costs, global_pairs, greedy_pairs
from companion.perception.tracking.body import seen_of, sight_axes, visible_surface
from companion.perception.tracking.motion_filter import Agility, MotionFilter
from companion.perception.tracking.settings import TrackingSettings


def test_prediction_equals_the_integral_of_the_model() -> None:
    sigma, fading, dt, white = 1.3, 0.7, 0.25, 0.4
    motion = MotionFilter(np.zeros(3), 0.01 * np.eye(3), 1.0, Agility(sigma, 0.5 * sigma, fading, white))
    motion.predict(dt)
    # Van Loan's method on one axis.
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / fading]])
    W = np.diag([0.0, white, 2.0 * sigma**2 / fading])
    block = expm(np.block([[-A, W], [np.zeros((3, 3)), A.T]]) * dt)
    F = block[3:, 3:].T
    expected = F @ np.diag([0.01, 1.0, sigma**2]) @ F.T + F @ block[:3, 3:]
    assert motion.covariance[::3, ::3] == pytest.approx(expected[:2, :2], rel=1e-4)
    assert motion.covariance[5, 5] < motion.covariance[3, 3]


def test_a_measurement_of_the_past_moves_the_present() -> None:
    motion = MotionFilter(np.zeros(3), 1e-6 * np.eye(3), 2.0, Agility(0.0, 0.0, 0.0, 1e-3))
    for step in range(1, 30):
        motion.predict(0.1)
        then = 0.1 * step - 0.06
        motion.update(np.array([2.0 * then, 0.0, 0.0]), 1e-4 * np.eye(3), 0.06)
    assert motion.p_map == pytest.approx([2.0 * 2.9, 0.0, 0.0], abs=5e-3)
    assert motion.v_map == pytest.approx([2.0, 0.0, 0.0], abs=0.02)


def test_the_mean_of_what_is_seen_of_a_cylinder_agrees_with_rays() -> None:
    rng = np.random.default_rng(2)
    radius, height = 0.15, 0.1
    for elevation in (-1.2, -0.4, 0.0, 0.3, 0.9, 1.5707):
        direction = np.array([np.cos(elevation), 0.0, np.sin(elevation)])
        # Parallel rays through a square across the direction, against side and caps.
        u, w = np.array([0.0, 1.0, 0.0]), np.cross(direction, [0.0, 1.0, 0.0])
        starts = rng.uniform(-0.25, 0.25, (100_000, 1)) * u + rng.uniform(-0.25, 0.25, (100_000, 1)) * w
        hits = np.full(100_000, np.inf)
        if np.cos(elevation) > 1e-3:
            a, b = direction[0] ** 2, starts[:, 0] * direction[0]
            c = starts[:, 0] ** 2 + starts[:, 1] ** 2 - radius**2
            root = b**2 - a * c
            s = (-b - np.sqrt(np.maximum(root, 0.0))) / a
            good = (root > 0.0) & (abs(starts[:, 2] + s * direction[2]) <= 0.5 * height)
            hits[good] = s[good]
        if abs(direction[2]) > 1e-3:
            s = (-np.sign(direction[2]) * 0.5 * height - starts[:, 2]) / direction[2]
            at = starts + s[:, None] * direction
            good = np.hypot(at[:, 0], at[:, 1]) <= radius
            hits[good] = np.minimum(hits[good], s[good])
        seen = np.isfinite(hits)
        mean = (starts[seen] + hits[seen, None] * direction).mean(axis=0)
        assert visible_surface(3.0 * direction, radius, height) == pytest.approx(mean, abs=3e-3)


def test_assignment_is_global_and_gated() -> None:
    states = np.zeros((2, 6))
    states[1, 0] = 0.3
    covariances = np.tile(0.04 * np.eye(6), (2, 1, 1))
    measured = np.array([[0.25, 0.0, 0.0], [0.7, 0.0, 0.0], [9.0, 0.0, 0.0]])
    costs = gated_costs(
        states, covariances, measured, np.tile(0.01 * np.eye(3), (3, 1, 1)), np.zeros(3), 17.7
    )
    # The nearest pair is (1, 0), but then nothing would be left for track 0.
    assert global_pairs(costs) == [(0, 0), (1, 1)]
    assert not np.isfinite(costs[:, 2]).any()
    assert greedy_pairs(np.abs(states[:, :1] - measured[:, 0]), 0.5) == [(1, 0)]


def test_a_measurement_of_a_fast_body_is_compared_where_it_was() -> None:
    states = np.array([[1.0, 0.0, 0.0, 4.0, 0.0, 0.0]])
    noises = 1e-4 * np.eye(3)[None]
    where_it_was = np.array([[0.6, 0.0, 0.0]])
    costs = gated_costs(states, 1e-4 * np.eye(6)[None], where_it_was, noises, np.array([0.1]), 16.0)
    assert np.isfinite(costs).all()
    assert not np.isfinite(
        gated_costs(states, 1e-4 * np.eye(6)[None], where_it_was, noises, np.zeros(1), 16.0)
    ).any()


def test_the_tape_tells_distance_and_height_but_not_the_side() -> None:
    away, settings = np.array([5.0, 0.0, 0.0]), TrackingSettings()
    tape_map = np.array([-0.03, 0.05, 0.02])
    without, loose = seen_of(8, 0, np.zeros(3), sight_axes(away), settings)
    shift, sure = seen_of(4, 4, tape_map, sight_axes(away), settings)
    assert np.all(sure <= loose)
    assert sure[0] < 0.6 * loose[0]
    assert sure[1] == loose[1]
    assert shift[1] == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < shift[2] < 0.02
    # The nearer the points lie to the sensor, the farther behind them is the middle.
    assert without[0] > 0.0
    assert np.cross(*sight_axes(away)[:2]) == pytest.approx([0.0, 0.0, 1.0])


AGILITY = Agility(0.8, 0.3, 1.5, 0.01)


def flown(accelerations: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Follow who accelerates so (n, 3) ten times a second.

    Returns:
        The weight of each manner (n, 3), and the mean squared error (n,) of an axis of the velocity, by its
        covariance.
    """
    motion = MotionFilter(np.zeros(3), 4e-4 * np.eye(3), 1.0, AGILITY)
    motion.distinguish()
    p, v, rows = np.zeros(3), np.zeros(3), []
    for acceleration in accelerations:
        p, v = p + 0.1 * v + 0.005 * acceleration, v + 0.1 * acceleration
        motion.predict(0.1)
        motion.update(p + 0.02 * rng.standard_normal(3), 4e-4 * np.eye(3), 0.0)
        error = motion.v_map - v
        rows.append([*motion.weights, error @ np.linalg.solve(motion.covariance[3:, 3:], error) / 3.0])
    return np.array(rows)


def test_the_manner_of_flying_is_told_from_the_motion() -> None:
    ahead = np.array([1.0, 0.0, 0.0])
    still = flown(np.zeros((200, 3)), np.random.default_rng(1))
    assert still[50:, 0].mean() > 0.85
    swing = flown(2.0 * np.sin(0.15 * np.arange(200))[:, None] * ahead, np.random.default_rng(1))
    assert swing[50:, 0].mean() < 0.1
    # A sudden swerve out of a hover is believed within half a second.
    swerve = flown(np.where(np.arange(60) < 40, 0.0, 3.0)[:, None] * ahead, np.random.default_rng(1))
    assert swerve[35, 0] > 0.8
    assert swerve[45:50, 0].max() < 0.2
    assert swerve[46:, 3].max() < 4.0


def test_the_covariance_is_true_for_motion_of_any_manner() -> None:
    squares, left = [], np.exp(-0.1 / AGILITY.fading_s)
    for seed in range(12):
        rng = np.random.default_rng(seed)
        manner, now, accelerations = 0, np.zeros(3), []
        for _ in range(300):
            if rng.random() > np.exp(-0.1 / AGILITY.manners_last_s[manner]):
                manner = int(rng.choice(3, p=motion_filter._SUCCESSORS[manner]))
            level, upwards, _ = AGILITY.manners()[manner]
            push = np.sqrt(1.0 - left**2) * np.array([level, level, upwards])
            now = left * now + push * rng.standard_normal(3)
            accelerations.append(now)
        squares.append(flown(np.array(accelerations), rng)[20:, 3])
    assert 0.85 < np.mean(squares) < 1.15


def test_manners_are_mixed_as_the_interacting_filters_of_the_library_mix_them() -> None:
    rng = np.random.default_rng(3)
    motion = MotionFilter(np.zeros(3), 4e-4 * np.eye(3), 1.0, AGILITY)
    filters = []
    for level, upwards, density in AGILITY.manners():
        single = KalmanFilter(dim_x=9, dim_z=3)
        single.x = np.zeros(9)
        single.P = np.diag([4e-4] * 3 + [1.0] * 3 + [0.64, 0.64, 0.3**2])
        single.F, single.Q = motion_filter._transition(0.1, (level, upwards), 1.5, density)
        single.H, single.R = np.eye(3, 9), 4e-4 * np.eye(3)
        filters.append(single)
    oracle = IMMEstimator(filters, np.full(3, 1.0 / 3.0), motion_filter._switching(0.1, (10.0, 5.0, 3.0)))
    motion.distinguish()
    for step in range(40):
        z = np.array([0.005 * step**2, 0.02 * step, 0.0]) + 0.02 * rng.standard_normal(3)
        motion.predict(0.1)
        oracle.predict()
        motion.update(z, 4e-4 * np.eye(3), 0.0)
        oracle.update(z)
        assert motion.weights == pytest.approx(oracle.mu, abs=2e-5)
        assert motion.p_map == pytest.approx(oracle.x[:3], abs=1e-5)
        assert motion.covariance == pytest.approx(oracle.P[:6, :6], abs=1e-5)


def test_of_a_lost_one_the_manner_is_forgotten() -> None:
    motion = MotionFilter(np.zeros(3), 4e-4 * np.eye(3), 1.0, AGILITY, np.ones(3))
    motion.distinguish()
    before = motion.p_map.copy()
    motion.fade(0.1, 1.5, 1.0, np.zeros(3))
    assert motion.weights.tolist() == [1.0]
    assert motion.p_map == pytest.approx(before)
    assert motion.v_map == pytest.approx(np.full(3, np.exp(-0.1 / 1.5)))
