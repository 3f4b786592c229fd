"""How fast one core casts rays and simulates the Mid-360 in a pillar field.

Times are processor time of one thread, the best of several rounds.
"""

import numpy as np

from companion.clock import SystemClock
from companion.geometry.pose import Pose
from companion.geometry.rotation import IDENTITY
from companion.messages import FloatArray
from sitl.kinematics import BodyTrajectory
from sitl.sensors.mid360 import Mid360Model, Mid360Settings
from sitl.sensors.scan_pattern import ScanPattern
from sitl.worlds.pillars import PillarFieldSettings, pillar_field
from sitl.worlds.primitives import World

SLOTS = 20_000
STEPS = 20
STEP_NS = 5_000_000
RANGE_M = 100.0
_CLOCK = SystemClock()


def _world(pillars: int) -> World:
    """Return the ground and exactly `pillars` pillars."""
    field = pillar_field(np.random.default_rng(1), PillarFieldSettings(size_m=(60.0, 60.0)))
    if len(field) <= pillars:
        raise ValueError(f"the field has room for {len(field) - 1} pillars only")
    keep = slice(0, pillars + 1)
    return World(
        field.kinds[keep], field.rows[keep], field.discs[keep], field.reflectivity[keep],
        field.retro_reflective[keep],
    )  # fmt: skip


def _rays_per_s(world: World, directions: FloatArray, rounds: int) -> float:
    origins = np.tile([0.0, 0.0, 1.5], (len(directions), 1))
    world.cast(origins, directions, RANGE_M)
    best = float("inf")
    for _ in range(rounds):
        start = _CLOCK.thread_cpu_ns()
        world.cast(origins, directions, RANGE_M)
        best = min(best, _CLOCK.thread_cpu_ns() - start)
    return 1e9 * len(directions) / best


def _scan_ms(world: World, rounds: int) -> float:
    """Return milliseconds for 20,000 slots taken in 20 steps, as a simulated vehicle does."""
    model = Mid360Model(np.random.default_rng(0), Pose.of([0.0, 0.0, 0.05], IDENTITY), Mid360Settings())
    times_ns = np.arange(STEPS + 1, dtype=np.int64) * STEP_NS
    p_world = np.linspace([0.0, 0.0, 1.5], [0.2, 0.0, 1.5], STEPS + 1)
    q_world_body = np.tile(IDENTITY, (STEPS + 1, 1))
    best = float("inf")
    for _ in range(rounds + 1):
        start = _CLOCK.thread_cpu_ns()
        for step in range(STEPS):
            part = slice(step, step + 2)
            trajectory = BodyTrajectory(times_ns[part], p_world[part], q_world_body[part])
            model.measure(step * SLOTS // STEPS, SLOTS // STEPS, trajectory, world)
        best = min(best, _CLOCK.thread_cpu_ns() - start)
    return 1e-6 * best


def measure(pillars: int = 60, rounds: int = 10) -> list[dict[str, object]]:
    """Return one row a quantity, against `pillars` pillars and the ground."""
    world = _world(pillars)
    in_order = ScanPattern().directions_lidar(0, 10 * SLOTS)
    in_disorder = np.random.default_rng(0).permutation(in_order)
    figures = (
        ("rays in firing order", 1e-6 * _rays_per_s(world, in_order, rounds), "M/s"),
        ("rays in random order", 1e-6 * _rays_per_s(world, in_disorder, rounds), "M/s"),
        ("20,000 Mid-360 slots, all included", _scan_ms(world, rounds), "ms"),
    )
    return [{"what": what, "value": round(value, 2), "unit": unit} for what, value, unit in figures]
