from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sitl.sensors
from companion.messages import FloatArray
from sitl.sensors.scan_pattern import ScanPattern

PATTERN = ScanPattern()
SLOTS_PER_S = 200_000
REFERENCE = Path(__file__).resolve().parents[4] / "shared" / "data" / "mid360_scan_pattern"


def _angles(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    return azimuth, np.arcsin(directions[:, 2])


def _slow_directions(
    first_slot: int,
    count: int,
    coefficients: FloatArray,
    rotor_hz: float,
    nod_hz: float,
    orders: tuple[int, int],
) -> FloatArray:
    """Sum the Fourier series term by term."""
    directions = np.zeros((count, 3))
    for i in range(count):
        slot = first_slot + i
        t = slot // 4 * 20e-6
        rotor, nod = 2.0 * np.pi * rotor_hz * t, 2.0 * np.pi * nod_hz * t
        basis = [1.0]
        for turns in range(orders[0] + 1):
            for nods in range(-orders[1] if turns else 1, orders[1] + 1):
                basis += [np.cos(turns * rotor + nods * nod), np.sin(turns * rotor + nods * nod)]
        vector = np.array(basis) @ coefficients[slot % 4]
        directions[i] = vector / np.linalg.norm(vector)
    return directions


def _coverage(seconds: float) -> float:
    """Return the share of 1 x 1 degree cells between -7 and 52 degrees of elevation that were hit."""
    azimuth, elevation = _angles(PATTERN.directions_lidar(0, round(seconds * SLOTS_PER_S)))
    column = np.floor(np.degrees(azimuth)).astype(int) % 360
    row = np.floor(np.degrees(elevation) + 7.0).astype(int)
    inside = (row >= 0) & (row < 59)
    return len(np.unique(column[inside] * 59 + row[inside])) / (360 * 59)


def test_the_kernel_sums_the_series_as_defined() -> None:
    with np.load(Path(sitl.sensors.__file__).parent / "mid360_pattern.npz") as data:
        for first in (0, 3, 1_234_567):
            expected = _slow_directions(
                first, 50, data["coefficients"], PATTERN.rotor_hz, PATTERN.nod_hz,
                (int(data["rotor_order"]), int(data["nod_order"])),
            )  # fmt: skip
            np.testing.assert_allclose(PATTERN.directions_lidar(first, 50), expected, atol=1e-8)


def test_the_field_of_view_reaches_from_minus_seven_to_fifty_two_degrees() -> None:
    _, elevation = _angles(PATTERN.directions_lidar(0, SLOTS_PER_S))
    assert -8.0 < np.degrees(elevation.min()) < -6.5
    assert 51.5 < np.degrees(elevation.max()) < 53.0
    assert (np.degrees(elevation) < -7.5).mean() == 0.0


@pytest.mark.parametrize(
    ("seconds", "least", "most"), [(0.1, 0.60, 0.63), (0.5, 0.95, 0.97), (1.0, 0.96, 0.98)]
)
def test_coverage_grows_as_measured(seconds: float, least: float, most: float) -> None:
    assert least <= _coverage(seconds) <= most


def test_azimuth_grows_counter_clockwise_by_1_3_degrees_a_firing() -> None:
    for line in range(4):
        azimuth, _ = _angles(PATTERN.directions_lidar(0, 20_000)[line::4])
        steps = np.degrees(np.diff(np.unwrap(azimuth)))
        assert steps.min() > 1.0
        assert steps.max() < 1.6
        assert np.median(steps) == pytest.approx(1.309, abs=0.01)


def test_the_pattern_does_not_repeat() -> None:
    first = PATTERN.directions_lidar(0, 4000)
    for seconds in (0.1, 1.0, 4.0, 60.0):
        later = PATTERN.directions_lidar(round(seconds * SLOTS_PER_S), 4000)
        assert np.median(np.linalg.norm(first - later, axis=1)) > 0.02


@given(first=st.integers(0, 10**12), split=st.integers(1, 99))
@settings(max_examples=30, deadline=None)
def test_any_slot_has_one_unit_direction_however_it_is_asked_for(first: int, split: int) -> None:
    whole = PATTERN.directions_lidar(first, 100)
    np.testing.assert_array_equal(whole[split:], PATTERN.directions_lidar(first + split, 100 - split))
    np.testing.assert_allclose(np.linalg.norm(whole, axis=1), 1.0, atol=1e-12)


def test_negative_slots_are_refused() -> None:
    with pytest.raises(ValueError, match="must not be negative"):
        PATTERN.directions_lidar(-1, 10)


@pytest.mark.skipif(not REFERENCE.exists(), reason="the reference tables are not here")
def test_the_pattern_spans_the_elevations_of_the_manufacturers_table() -> None:
    """Compare with Livox's own 4 s table, a simulation that turns the other way at another rate."""
    table = np.load(REFERENCE / "mid360.npy").astype(np.float64)
    assert np.degrees(table[:, 1].max()) == pytest.approx(52.2, abs=0.3)
    _, elevation = _angles(PATTERN.directions_lidar(0, len(table)))
    np.testing.assert_allclose(
        np.percentile(elevation, [5, 25, 50, 75, 95]),
        np.percentile(table[:, 1], [5, 25, 50, 75, 95]),
        atol=0.06,
    )
    with np.load(REFERENCE / "fourier.npz") as reference:
        expected = _slow_directions(
            40_000, 100, reference["coefs"], float(reference["f1"]), float(reference["f2"]), (2, 8)
        )
    np.testing.assert_allclose(PATTERN.directions_lidar(40_000, 100), expected, atol=1e-9)
