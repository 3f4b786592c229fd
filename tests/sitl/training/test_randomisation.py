import math

import numpy as np
import pytest

from sitl.abstract import grid_kernels
from sitl.abstract import layout_kernels as place
from sitl.training.conditions import Conditions, ConditionsSource
from sitl.training.environment_settings import EnvironmentSettings
from sitl.training.randomisation import HISTORY_ROWS, WIDE, RandomisationSettings


def _drawn(randomisation: RandomisationSettings, number: int = 200) -> list[Conditions]:
    source = ConditionsSource(EnvironmentSettings(randomisation=randomisation))
    rng = np.random.default_rng(1)
    return [source.draw("measured", rng) for _ in range(number)]


def test_without_settings_nothing_changes() -> None:
    plain = EnvironmentSettings()
    abstract = plain.abstract("measured")
    for conditions in _drawn(RandomisationSettings(), 3):
        known = abstract.packed(plain.swarm.termination, 0.0, 4.0)
        np.testing.assert_allclose(conditions.parameters[: place.N_PARAMETERS], known, rtol=1e-15)
        np.testing.assert_array_equal(conditions.quadrotor, abstract.packed_quadrotor())
        np.testing.assert_allclose(conditions.limits, abstract.packed_grid()[0], rtol=1e-15)


@pytest.mark.parametrize(
    ("name", "bounds", "index", "low", "high"),
    [
        ("obstacle_delay_s", (0.0, 0.1), place.GRID_DELAY, 1.0, 3.0),
        ("neighbour_delay_s", (0.05, 0.15), place.NEIGHBOUR_DELAY, 2.0, 4.0),
        ("sigma_factor", (0.5, 2.0), place.POSITION_SIGMA, 0.002, 0.008),
        ("sigma_factor", (0.5, 2.0), place.VELOCITY_SIGMA_FAR, 0.00405, 0.0162),
        ("ego_velocity_sigma_mps", (0.0, 0.1), place.EGO_VELOCITY_SIGMA, 0.011, 0.111),
        ("dropout", (0.0, 0.2), place.DROPOUT, 0.0, 0.2),
        ("range_factor", (0.5, 1.0), place.SIGHT_RANGE, 5.0, 10.0),
        ("lag_factor", (0.5, 2.0), place.LAG_LEAST, 0.1, 0.4),
        ("command_delay_s", (0.0, 0.05), place.COMMAND_DELAY, 6.0, 11.0),
        ("wind_mps", (0.0, 3.0), place.WIND_X, -3.0, 3.0),
        ("gust_mps", (0.0, 0.9), place.VERTICAL_GUST, 0.0, 0.3),
    ],
)
def test_draws_fill_their_bounds(
    name: str, bounds: tuple[float, float], index: int, low: float, high: float
) -> None:
    conditions = _drawn(RandomisationSettings.model_validate({name: bounds}))
    drawn = np.array([one.parameters[index] for one in conditions])
    assert low - 1e-9 <= drawn.min() < low + 0.15 * (high - low)
    assert high - 0.15 * (high - low) < drawn.max() <= high + 1e-9


def test_a_tilted_sensor_looks_elsewhere_with_grid_and_neighbours_alike() -> None:
    for conditions in _drawn(RandomisationSettings(tilt_deg=(3.0, 3.0)), 2):
        lowest = math.degrees(math.asin(conditions.parameters[place.SIGHT_LOWEST]))
        highest = math.degrees(math.asin(conditions.parameters[place.SIGHT_HIGHEST]))
        assert lowest == pytest.approx(-4.0)
        assert highest == pytest.approx(55.0)
        assert conditions.limits[grid_kernels.SIGHT_LOWEST] == conditions.parameters[place.SIGHT_LOWEST]
        assert conditions.limits[grid_kernels.SIGHT_HIGHEST] == conditions.parameters[place.SIGHT_HIGHEST]


def test_trials_differ_and_no_delay_is_longer_than_the_history() -> None:
    conditions = _drawn(WIDE, 20)
    assert len({one.parameters.tobytes() for one in conditions}) == 20
    for one in conditions:
        for delay in (place.GRID_DELAY, place.NEIGHBOUR_DELAY, place.EGO_DELAY):
            assert one.parameters[delay] <= HISTORY_ROWS - 2
        assert one.parameters[place.DROPOUT] + one.parameters[place.DROPOUT_FAR] < 1.0


@pytest.mark.parametrize(
    ("key", "bounds"), [("wind_mps", (2.0, 1.0)), ("dropout", (-0.1, 0.1)), ("neighbour_delay_s", (0.0, 0.5))]
)
def test_impossible_bounds_are_refused(key: str, bounds: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match=r"allowed|rising|below|at most"):
        RandomisationSettings.model_validate({key: bounds})
