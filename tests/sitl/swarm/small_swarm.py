"""A leader and one follower between a few pillars, for tests."""

from pathlib import Path

import numpy as np

from companion.config import load_profile
from sitl.scenario import Scenario
from sitl.swarm.lockstep import FlightPlan
from sitl.swarm.scene import SwarmScene
from sitl.swarm.vehicles import Crew
from sitl.worlds.primitives import Cylinder, Ground, World
from sitl.worlds.settings import WorldSettings

FIELD_CONFIGS = Path(__file__).resolve().parents[3] / "field_configs"


def crew() -> Crew:
    return Crew(
        load_profile(FIELD_CONFIGS / "sitl_swarm_leader.yaml"),
        load_profile(FIELD_CONFIGS / "sitl_swarm_follower.yaml"),
    )


def setting() -> Scenario:
    return Scenario(profile="-", world=WorldSettings(primitives=[]))


def scene(*, vehicles: int = 2, goal_m: float = 3.0) -> SwarmScene:
    """Return vehicles in a row, 1.6 m apart, the leader in front; it flies ahead to its goal."""
    pillars = [
        Cylinder(start_world_m=(x, y, 0.0), end_world_m=(x, y, 5.0), radius_m=0.3)
        for x, y in [(5.0, 3.0), (7.0, -3.0), (-5.0, 5.0), (-6.0, -4.0), (1.0, 6.0), (2.0, -6.0)]
    ]
    starts = np.array([[-1.6 * k, 0.0, 1.5] for k in range(vehicles)])
    return SwarmScene(
        seed=3,
        world=World.of([Ground(), *pillars]),
        starts_world=starts,
        yaws=np.linspace(0.3, 2.5, vehicles),
        waypoints_world=np.array([[goal_m, 0.0, 1.5]]),
        holds_s=np.array([0.5]),
        speed_mps=1.0,
        timeout_s=20.0,
        scene_hash="small",
        wait_s=0.5,
        ramp_s=0.5,
    )


def plan(folder: Path, *, vehicles: int = 2) -> FlightPlan:
    return FlightPlan(setting(), crew(), scene(vehicles=vehicles), folder, packets=True)
