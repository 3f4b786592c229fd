import numpy as np

from companion.perception.tracking import region_kernels as kernels

GRID = np.zeros((kernels.GRID,) * 3, np.uint8)


def random_scene(seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-10.0, 10.0, (7, 3))
    velocities = rng.uniform(-3.0, 3.0, (7, 3))
    near = centres[rng.integers(0, 7, 600)] + rng.normal(0.0, 0.4, (600, 3))
    points = np.vstack([near, rng.uniform(-30.0, 30.0, (200, 3))]).astype(np.float32)
    return points, rng.uniform(0.0, 0.3, 800), rng.normal(0.0, 1.0, 3), centres, velocities


def test_every_point_belongs_to_the_nearest_moving_ball_it_lies_in() -> None:
    for seed in range(5):
        points, ages, origin, centres, velocities = random_scene(seed)
        radii = np.random.default_rng(seed).uniform(0.2, 1.0, 7)
        owners = np.empty(len(points), np.int32)
        kernels.claim(points, ages, origin, centres, velocities, radii, GRID, owners)
        then = centres - velocities * ages[:, None, None]
        away = np.linalg.norm(points[:, None].astype(float) - then, axis=2)
        away[away > radii] = np.inf
        expected = np.where(np.isfinite(away.min(axis=1)), np.argmin(away, axis=1), -1)
        assert np.array_equal(owners, expected)
        assert not GRID.any()


def test_points_around_a_body_are_told_from_those_on_it() -> None:
    for seed in range(5):
        points, ages, origin, centres, velocities = random_scene(seed)
        owners = np.random.default_rng(seed).integers(-1, 7, len(points)).astype(np.int32)
        names, proven = np.arange(7, dtype=np.int32), np.array([1, 0, 1, 0, 0, 1, 0], np.uint8)
        counts = np.empty((7, kernels.SURROUNDINGS_WIDTH))
        kernels.survey(
            points,
            ages,
            owners,
            origin,
            centres,
            velocities,
            names,
            0.25,
            0.15,
            0.4,
            0.3,
            proven,
            GRID,
            counts,
        )
        expected = np.zeros_like(counts)
        for k in range(7):
            others = (owners >= 0) & (owners != k) & (proven[owners] == 1)
            off = points.astype(float) - (centres[k] - velocities[k] * ages[:, None])
            flat, z = np.hypot(off[:, 0], off[:, 1]), off[:, 2]
            inside = (flat <= 0.25) & ~others
            expected[k, kernels.BODY] = np.sum(inside & (abs(z) <= 0.15))
            expected[k, kernels.BELOW] = np.sum(inside & (z < -0.15) & (z >= -0.55))
            expected[k, kernels.ABOVE] = np.sum(inside & (z > 0.15) & (z <= 0.55))
            ring = (flat > 0.25) & (flat <= 0.55) & ~others
            expected[k, kernels.BESIDE] = np.sum(ring & (abs(z) <= 0.15))
        assert np.array_equal(counts, expected)
        assert not GRID.any()


def test_only_what_stands_before_a_body_shades_it() -> None:
    points = np.array(
        [
            [2.0, 0.0, 0.0],
            [2.0, 0.1, 0.0],
            [2.0, 0.3, 0.0],
            [3.8, 0.0, 0.0],
            [5.0, 0.0, 0.0],
            [-2.0, 0.0, 0.0],
        ],
        np.float32,
    )
    counts = np.empty(2)
    centres = np.array([[4.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    kernels.shade(points, np.zeros(3), centres, 0.3, 0.4, counts)
    assert counts.tolist() == [2.0, 0.0]
