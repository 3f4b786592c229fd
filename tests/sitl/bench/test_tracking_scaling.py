"""Costs of tracking: the scans they are taken from, and how growth is judged."""

import numpy as np
import pytest

from sitl.bench.tracking_scaling import DENSITIES, Cost, Growth, at_density, growth, record, yard
from tests.perception.tracking.bodies import Uav, scan


def costs(time_of: np.ndarray) -> list[Cost]:
    points = [round(20_000 * density) for density in DENSITIES]
    return [
        Cost("points", count, 10, 10.0, float(ms), 2.0 * float(ms), 0.5)
        for count, ms in zip(points, time_of, strict=True)
    ]


@pytest.mark.parametrize(("power", "holds"), [(0.5, True), (1.0, True), (1.4, False), (2.0, False)])
def test_growth_beyond_n_log_n_is_refused(power: float, holds: bool) -> None:
    found = growth(costs(2.0 * np.array(DENSITIES) ** power))
    assert found.exponent == pytest.approx(power)
    assert 1.0 < found.n_log_n_exponent < 1.2
    assert found.tracker_ms == pytest.approx(2.0)
    assert found.holds == holds


def test_what_is_too_slow_is_refused() -> None:
    assert Growth(0.9, 1.1, 8.0, 2.0).holds
    assert not Growth(0.9, 1.1, 8.1, 2.0).holds
    assert not Growth(0.9, 1.1, 8.0, 2.1).holds


@pytest.mark.parametrize("density", [0.25, 1.0, 2.5])
def test_scans_are_thinned_and_filled_up_where_the_points_are(density: float) -> None:
    seen = scan(1, [Uav((1.5, 0.0, 1.6))], np.random.default_rng(1))
    count = len(seen.points_map)
    looked = at_density(seen, density, np.random.default_rng(2))
    assert len(looked.points_map) == len(looked.reflectivity) == len(looked.ages_ns) == round(density * count)
    away = np.linalg.norm(looked.points_map[:, None] - seen.points_map, axis=2).min(axis=1)
    assert away.max() < 0.08
    if density == 1.0:
        np.testing.assert_array_equal(looked.points_map, seen.points_map)


def test_an_empty_scan_stays_empty() -> None:
    empty = scan(1, [], np.random.default_rng(1))
    assert len(at_density(empty, 2.0, np.random.default_rng(2)).points_map) == 0


def test_no_beam_leaves_the_yard_and_everything_is_near() -> None:
    rng = np.random.default_rng(3)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, 2000), np.radians(rng.uniform(-7.0, 52.0, 2000))
    directions = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    origin = np.tile([0.0, 0.0, 1.6], (2000, 1))
    ranges = yard().cast(origin, directions, 50.0).ranges
    assert np.isfinite(ranges).all()
    assert np.mean(ranges < 12.0) > 0.6
    assert ranges.max() < 18.0


def test_the_swarm_in_the_yard_stays_there_and_is_seen() -> None:
    scans = record(2, seed=1, seconds=5.4)
    assert len(scans) >= 3
    assert all(len(seen.points_map) > 19_000 for seen in scans)
    assert all(np.linalg.norm(seen.odometry.p_map) < 3.0 for seen in scans)
    assert np.mean([(seen.reflectivity > 150).sum() for seen in scans]) > 2.0
