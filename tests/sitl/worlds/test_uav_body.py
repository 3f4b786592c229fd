import math

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from sitl.worlds.bodies import Bodies
from sitl.worlds.primitives import Hits, World
from sitl.worlds.uav_body import UavBodySettings, rotor_turns, uav_body

LEVEL = np.array([rotation.IDENTITY])
FAR_M = 200.0


def _seen_from(azimuth: float, elevation: float, settings: UavBodySettings) -> tuple[World, Hits, float]:
    """Cast parallel rays at a body through a square of half a metre; also return the area of one ray."""
    world = Bodies(World.of([]), [uav_body(settings)]).at(np.zeros((1, 3)), LEVEL, turns=[0.3])
    towards = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )
    left = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    up = np.cross(towards, left)
    grid = np.linspace(-0.3, 0.3, 151)
    a, b = (each.ravel()[:, None] for each in np.meshgrid(grid, grid))
    origins: FloatArray = FAR_M * towards + a * left + b * up
    hits = world.cast(origins, np.tile(-towards, (len(origins), 1)), 2.0 * FAR_M)
    return world, hits, float((grid[1] - grid[0]) ** 2)


@pytest.mark.parametrize("azimuth_deg", [0.0, 30.0, 45.0, 90.0, 180.0])
def test_from_the_side_a_uav_shows_its_hull_and_little_more(azimuth_deg: float) -> None:
    azimuth = math.radians(azimuth_deg)
    length, width, height = UavBodySettings().hull_size_m
    _, hits, cell = _seen_from(azimuth, 0.0, UavBodySettings())
    hull = height * (length * abs(math.sin(azimuth)) + width * abs(math.cos(azimuth)))
    area = float(np.isfinite(hits.ranges).sum()) * cell
    assert hull < area < hull + 0.0155


def test_a_uav_shows_as_much_as_a_plate_of_a_quarter_by_an_eighth_of_a_metre() -> None:
    areas = []
    for azimuth in np.radians(np.arange(0.0, 90.0, 7.5)):
        _, hits, cell = _seen_from(float(azimuth), math.radians(3.0), UavBodySettings())
        areas.append(float(np.isfinite(hits.ranges).sum()) * cell)
    assert np.mean(areas) == pytest.approx(0.25 * 0.12, rel=0.05)


@pytest.mark.parametrize("azimuth_deg", [0.0, 45.0, 90.0, 200.0])
@pytest.mark.parametrize("elevation_deg", [-80.0, -30.0, 0.0, 30.0, 80.0])
def test_tape_shows_on_all_sides(azimuth_deg: float, elevation_deg: float) -> None:
    world, hits, cell = _seen_from(math.radians(azimuth_deg), math.radians(elevation_deg), UavBodySettings())
    on_tape = (hits.indices >= 0) & (world.retro_reflective[hits.indices] != 0)
    assert on_tape.sum() * cell > 0.005
    # No direction is farther than this from the nearest of a cuboid's faces.
    assert hits.cosines[on_tape].max() > math.cos(math.radians(54.8))


def test_without_tape_nothing_on_a_uav_is_retro_reflective() -> None:
    assert not uav_body(UavBodySettings(tape=False)).parts.retro_reflective.any()
    wide, narrow = (_seen_from(0.0, 0.0, UavBodySettings(tape_width_m=width))[:2] for width in (0.08, 0.02))
    shares = [
        (world.retro_reflective[hits.indices[hits.indices >= 0]] != 0).sum() for world, hits in (wide, narrow)
    ]
    assert shares[0] > 3 * shares[1]


def test_most_rays_pass_a_rotor_disc() -> None:
    body = Bodies(World.of([]), [uav_body(UavBodySettings())])
    hub = 0.5 * 0.35 * math.sqrt(0.5)
    rng = np.random.default_rng(0)
    radius, angle = 0.065 * np.sqrt(rng.uniform(size=2000)), rng.uniform(0.0, 2.0 * math.pi, 2000)
    origins = np.column_stack(
        [hub + radius * np.cos(angle), hub + radius * np.sin(angle), np.full(2000, 2.0)]
    )
    side = 0.5 * UavBodySettings().hull_size_m[0] + 0.001
    outside = np.hypot(np.maximum(origins[:, 0] - side, 0.0), np.maximum(origins[:, 1] - side, 0.0)) > 0.0
    shares = []
    for turn in np.linspace(0.0, math.pi, 12):
        hits = body.at(np.zeros((1, 3)), LEVEL, turns=[turn]).cast(
            origins[outside], np.tile([0.0, 0.0, -1.0], (int(outside.sum()), 1)), 2.5
        )
        shares.append(float(np.isfinite(hits.ranges).mean()))
    assert 0.05 < np.mean(shares) < 0.35
    assert np.std(shares) > 0.003  # it matters where the blades stand


def test_rotors_turn_at_their_rates() -> None:
    np.testing.assert_allclose(rotor_turns(np.array([100.0, 50.0]), 0.0125), [0.5 * math.pi, 1.25 * math.pi])
