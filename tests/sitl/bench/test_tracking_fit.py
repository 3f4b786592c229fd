"""The model of perception's errors finds again what made-up flights were made with."""

import numpy as np
import pytest

from sitl.abstract.settings import PerceptionSettings
from sitl.bench.tracking_fit import fit
from sitl.bench.tracking_score import SIGHT, STEP, FlightScore

SCANS = 4000


def flown(fade: float = 0.0) -> FlightScore:
    """Return flights with one neighbour near and one far, whose errors fade from scan to scan."""
    rng = np.random.default_rng(5)
    sights = np.zeros(2 * SCANS, SIGHT)
    sights["scan"] = np.repeat(np.arange(SCANS), 2)
    sights["neighbour"] = np.tile([0, 1], SCANS)
    sights["range_m"] = np.tile([3.0, 9.0], SCANS)
    sights["visible"] = sights["counted"] = True
    sights["matched"] = rng.random(2 * SCANS) < np.tile([1.0, 0.9], SCANS)
    fresh = rng.normal(size=(SCANS, 2, 3)) * np.sqrt(1.0 - fade**2)
    for k in range(1, SCANS):
        fresh[k] += fade * fresh[k - 1]
    errors = fresh * np.array([0.02, 0.06])[None, :, None]
    sights["error_p"] = errors.reshape(-1, 3)
    sights["error_v"] = 5.0 * errors.reshape(-1, 3)
    sights["error_relative_v"] = sights["error_v"] - np.repeat(rng.normal(0.0, 0.04, (SCANS, 3)), 2, axis=0)
    sights["fresh"] = sights["matched"] & (rng.random(2 * SCANS) < np.tile([1.0, 0.5], SCANS))
    times = np.full(SCANS, 4.0)
    return FlightScore(sights, np.zeros(0, STEP), times, 3.0 * times, np.array([0.2, 0.4]), 0, 400.0, 800.0)


def test_sigmas_and_probabilities_by_range_are_found() -> None:
    model = fit(flown())
    assert model is not None
    near, far = model.by_range
    assert near.range_m == 3.0
    assert far.range_m == 9.0
    assert near.position_sigma_m == pytest.approx(0.02, rel=0.05)
    assert far.position_sigma_m == pytest.approx(0.06, rel=0.05)
    assert far.velocity_sigma_mps == pytest.approx(0.3, rel=0.05)
    assert near.detection_probability == 1.0
    assert far.detection_probability == pytest.approx(0.9, abs=0.02)
    assert model.latency_s == pytest.approx(0.012)
    assert model.acquisition_s == pytest.approx(0.3)


def test_the_abstract_swarm_takes_what_is_found() -> None:
    model = fit(flown())
    assert model is not None
    found = PerceptionSettings.model_validate(model.settings())
    for errors in model.by_range:
        assert found.position_sigma_m + errors.range_m * found.position_sigma_per_m == pytest.approx(
            errors.position_sigma_m, rel=0.02
        )
        assert found.dropout + (errors.range_m / 10.0) ** 2 * found.dropout_far == pytest.approx(
            errors.dropout, abs=0.08
        )
    assert found.ego_velocity_sigma_mps == pytest.approx(0.04, rel=0.05)
    assert found.sightings == 4
    assert found.neighbour_delay_s == pytest.approx(0.012)


def test_how_long_errors_last_is_found() -> None:
    model = fit(flown(fade=0.8))
    assert model is not None
    # 0.8^n falls to 1/e after 4.5 scans.
    assert model.position_correlation_s == pytest.approx(0.1 * -1.0 / np.log(0.8), abs=0.1)
    independent = fit(flown())
    assert independent is not None
    assert independent.position_correlation_s < 0.1


def test_the_figures_of_all_ranges_stand_at_the_top() -> None:
    model = fit(flown())
    assert model is not None
    told = model.as_dict()
    assert set(told) >= {"position_sigma_m", "velocity_sigma_mps", "detection_probability", "latency_s"}
    assert model.by_range[0].position_sigma_m < model.overall.position_sigma_m
    assert model.overall.position_sigma_m < model.by_range[1].position_sigma_m


def test_too_little_gives_no_model() -> None:
    few = flown()
    few.sights["matched"] = False
    assert fit(few) is None
