import numpy as np
import pytest
from scipy.linalg import expm

from companion.perception.tracking.association import gated_costs, global_pairs, greedy_pairs
from companion.perception.tracking.body import seen_of, sight_axes, visible_surface
from companion.perception.tracking.motion_filter import MotionFilter
from companion.perception.tracking.settings import TrackingSettings


def test_prediction_equals_the_integral_of_the_model() -> None:
    sigma, fading, dt, white = 1.3, 0.7, 0.25, 0.4
    motion = MotionFilter(np.zeros(3), 0.01 * np.eye(3), 1.0, (sigma, 0.5 * sigma), fading)
    motion.predict(dt, white)
    # Van Loan's method on one axis.
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / fading]])
    W = np.diag([0.0, white, 2.0 * sigma**2 / fading])
    block = expm(np.block([[-A, W], [np.zeros((3, 3)), A.T]]) * dt)
    F = block[3:, 3:].T
    expected = F @ np.diag([0.01, 1.0, sigma**2]) @ F.T + F @ block[:3, 3:]
    assert motion.covariance[::3, ::3] == pytest.approx(expected[:2, :2], rel=1e-4)
    assert motion.covariance[5, 5] < motion.covariance[3, 3]


def test_a_measurement_of_the_past_moves_the_present() -> None:
    motion = MotionFilter(np.zeros(3), 1e-6 * np.eye(3), 2.0, (0.0, 0.0), 0.0)
    for step in range(1, 30):
        motion.predict(0.1, 1e-3)
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
