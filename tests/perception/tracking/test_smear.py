import numpy as np
import pytest

from companion.messages import FloatArray
from companion.perception.tracking.clustering import FilteredPoints
from companion.perception.tracking.smear import straighten


def streak(v_map: FloatArray, count: int, owner: int = -1) -> FilteredPoints:
    """Return points of a body at the origin now, measured while it came here."""
    rng = np.random.default_rng(5)
    ages_s = rng.uniform(0.0, 0.2, count)
    measured = rng.uniform(-0.1, 0.1, (count, 3)) - ages_s[:, None] * v_map
    return FilteredPoints(
        measured_map=measured,
        moved_map=measured,
        ages_s=ages_s,
        fresh=(ages_s < 0.1).astype(np.uint8),
        bright=np.ones(count, np.uint8),
        owners=np.full(count, owner, np.int32),
        tracks=1,
    )


@pytest.mark.parametrize("v_map", [(4.0, 0.0, 0.0), (-2.0, 3.0, 0.5)])
def test_a_streak_shrinks_to_the_body_and_tells_its_velocity(v_map: tuple[float, float, float]) -> None:
    points = streak(np.array(v_map), 60)
    before = points.measured_map.copy()
    moved, velocities = straighten(np.zeros(60, np.int32), points, np.array([False]))
    assert np.ptp(before, axis=0).max() > 0.5
    assert np.ptp(moved.moved_map, axis=0).max() < 0.3
    velocity, sigma = velocities[0]
    assert np.linalg.norm(velocity - v_map) < 3.0 * sigma < 0.8
    np.testing.assert_array_equal(moved.measured_map, before)
    np.testing.assert_array_equal(points.moved_map, before)


def test_what_rests_few_points_and_known_tracks_are_left_alone() -> None:
    cases = [(np.zeros(3), 60, -1), (np.array([4.0, 0.0, 0.0]), 6, -1), (np.array([4.0, 0.0, 0.0]), 60, 0)]
    for v_map, count, owner in cases:
        points = streak(v_map, count, owner)
        moved, velocities = straighten(np.zeros(count, np.int32), points, np.array([True]))
        assert velocities == {}
        np.testing.assert_array_equal(moved.moved_map, points.moved_map)
