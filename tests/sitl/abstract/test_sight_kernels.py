import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import FloatArray
from sitl.abstract.settings import AbstractSettings, PerceptionSettings
from sitl.abstract.sight_kernels import sees
from sitl.worlds.primitives import Cylinder, World
from sitl.worlds.sites import build_site
from tests.sitl.abstract.sight_oracle import is_seen


def _sees(world: World, p: FloatArray, q: FloatArray, i: int, j: int, settings: PerceptionSettings) -> bool:
    world = world.obstacles()
    states = np.zeros((len(p), 10))
    states[:, :3], states[:, 6:] = p, q
    limits = AbstractSettings(perception=settings).packed_grid()[0]
    everything = np.arange(len(world.kinds), dtype=np.int32)
    return bool(
        sees(
            i, j, states, world.kinds, world.rows, world.discs, everything, len(everything), settings.range_m,
            limits[5], limits[6], settings.body_radius_m, settings.free_rays,
        )
    )  # fmt: skip


@pytest.mark.parametrize("site", ["pillars_5m", "forest"])
def test_sight_agrees_with_rays_through_the_whole_world(site: str) -> None:
    settings = PerceptionSettings()
    seen = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        world = build_site(site, rng, followers=4).world
        for _ in range(8):
            p = np.column_stack([rng.uniform(-7.0, 7.0, (6, 2)), rng.uniform(1.2, 2.4, 6)])
            tilt = np.column_stack([rng.uniform(-0.3, 0.3, (6, 2)), np.zeros(6)])
            q = rotation.multiply(rotation.from_yaw(rng.uniform(-3.0, 3.0, 6)), rotation.exp(tilt))
            for i in range(6):
                for j in range(6):
                    if i == j or world.obstacles().clearance(p[i]) < 0.0:
                        continue
                    expected = is_seen(world, p, q, i, j, settings)
                    assert _sees(world, p, q, i, j, settings) == expected
                    seen.append(expected)
    assert 0.2 < np.mean(seen) < 0.9


def test_two_free_rays_of_five_are_enough_and_one_is_not() -> None:
    level = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    p = np.array([[0.0, 0.0, 1.5], [4.0, 0.0, 1.5]])
    settings = PerceptionSettings()

    def behind(y: float) -> bool:
        pillar = Cylinder(start_world_m=(2.0, y, 0.0), end_world_m=(2.0, y, 5.0), radius_m=0.3)
        return _sees(World.of([pillar]), p, level, 0, 1, settings)

    # The pillar hides the centre and both vertical points as well as one side; then one side more.
    assert behind(1.0)
    assert not behind(0.0)
    assert not behind(0.28)
    assert behind(0.42)


def test_a_vehicle_below_the_field_of_view_is_seen_once_the_body_tilts_towards_it() -> None:
    p = np.array([[0.0, 0.0, 2.0], [3.0, 0.0, 1.4]])
    level = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    nose_down = level.copy()
    nose_down[0] = rotation.exp(np.array([0.0, np.radians(10.0), 0.0]))
    assert not _sees(World.of([]), p, level, 0, 1, PerceptionSettings())
    assert _sees(World.of([]), p, nose_down, 0, 1, PerceptionSettings())


def test_another_vehicle_on_the_line_hides_the_one_behind_it() -> None:
    p = np.array([[0.0, 0.0, 1.5], [4.0, 0.0, 1.5], [2.0, 0.0, 1.5]])
    level = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    assert not _sees(World.of([]), p, level, 0, 1, PerceptionSettings())
    p[2, 1] = 0.3
    assert _sees(World.of([]), p, level, 0, 1, PerceptionSettings())
