"""What happens in a simulated flight: the world, the vehicle's start, the operator, the faults, the seed."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.random import Generator, SeedSequence
from pydantic import Field, Strict, model_validator

from companion.clock import NANOSECONDS_PER_SECOND
from companion.config import SCHEMA_DIALECT, Profile, load_profile
from companion.errors import ProfileError
from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.messages import FloatArray
from companion.settings import Settings
from companion.yaml_problems import misfit
from companion.yaml_source import load
from sitl.dynamics import QuadrotorSettings
from sitl.network import NetworkSettings
from sitl.swarm.settings import SwarmSettings
from sitl.wind import GENTLE_GUSTS, WindSettings
from sitl.worlds.pillars import pillar_field
from sitl.worlds.primitives import World
from sitl.worlds.settings import WorldSettings, site_of
from sitl.worlds.sites import FLOWN_SITES

Point = Annotated[tuple[float, float], Strict(False)]


class OperatorSettings(Settings):
    """The person who arms, takes off and authorises."""

    takeoff_height_m: float = Field(default=1.5, gt=0.2, le=20.0)
    """Height to which the autopilot climbs by itself."""

    authorise_after_s: float = Field(default=2.0, ge=0.0, le=60.0)
    """Hovering time before the companion may engage."""

    takeover_after_s: float | None = Field(default=None, gt=0.0)
    """Seconds after engaging at which the pilot selects POSITION; never by default."""


class Scenario(Settings):
    """One simulated flight."""

    profile: str
    """Profile of the vehicle, relative to this file; of the leader, if there is a swarm."""

    seed: int = Field(default=1, ge=0, le=2**63 - 1)
    """Everything random comes from it."""

    max_duration_s: float = Field(default=180.0, gt=0.0, le=3600.0)
    """The flight of a single vehicle has failed if it lasts longer; swarms have `swarm.termination`."""

    goal_tolerance_m: float = Field(default=1.0, gt=0.0, le=10.0)
    """Largest distance between a single vehicle's place of landing and the last waypoint."""

    vehicle_radius_m: float = Field(default=0.2, gt=0.0, le=2.0)
    """A surface nearer than this to the vehicle's centre is a collision."""

    start_world_m: Point = (0.0, 0.0)
    """Where the vehicle stands."""

    start_yaw_deg: float | None = Field(default=None, ge=-180.0, le=180.0)
    """Its heading; random by default."""

    perception_latency_ms: float = Field(default=20.0, ge=0.0, le=500.0)
    """Computing time of a scan in lockstep, where computing takes no simulated time of its own."""

    vibration: bool = True
    """Shake the IMU while the motors run."""

    swarm: SwarmSettings | None = None
    """A leader, whose profile is `profile`, with followers. The scene then decides starts, headings, goal and
    heights, `termination` what ends the flight."""

    world: WorldSettings
    operator: OperatorSettings = OperatorSettings()
    network: NetworkSettings = NetworkSettings()
    quadrotor: QuadrotorSettings = QuadrotorSettings()
    wind: WindSettings = GENTLE_GUSTS

    @model_validator(mode="after")
    def _swarms_have_rules_of_their_own(self) -> "Scenario":
        rules = {"goal_tolerance_m": "goal_tolerance_m", "max_duration_s": "spare_time_s"}
        for key, instead in rules.items():
            if self.swarm is not None and key in self.model_fields_set:
                raise misfit((key,), "it beside a swarm", f"swarm.termination.{instead} instead")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A scenario made concrete by its seed.

    Attributes:
        scenario: as written, with the seed that counts.
        profile: of the vehicle under test.
        world: what the LiDAR sees and the vehicle can hit.
        T_world_start: pose of the body at power-on, on the ground; the map frame begins here.
        goal_world: (3,) last waypoint, or the start for a vehicle without waypoints.
        seeds: root of every stream of chance.
    """

    scenario: Scenario
    profile: Profile
    profile_path: Path
    world: World
    T_world_start: Pose
    goal_world: FloatArray
    seeds: SeedSequence

    def generator(self, consumer: str) -> Generator:
        """Return the stream of chance that belongs to a named consumer, whatever else draws."""
        label = [ord(letter) for letter in consumer]
        return np.random.default_rng(SeedSequence(self.seeds.entropy, spawn_key=tuple(label)))

    @property
    def max_duration_ns(self) -> int:
        """Longest simulated time."""
        return round(self.scenario.max_duration_s * NANOSECONDS_PER_SECOND)


def load_scenario(path: Path) -> Scenario:
    """Read a scenario file.

    Raises:
        ProfileError: if it is wrong, naming file, line and column.
    """
    return load(path, Scenario)


def set_stage(scenario: Scenario, folder: Path, seed: int | None, T_world_start: Pose | None = None) -> Stage:
    """Build the world and the start.

    Args:
        scenario: what happens.
        folder: of the scenario's file, to which the profile's name is relative.
        seed: instead of the scenario's own.
        T_world_start: where the vehicle stands, if somebody else has decided that already.

    Raises:
        ProfileError: if the vehicle's profile or a file of the world is wrong.
    """
    if seed is not None:
        scenario = scenario.model_copy(update={"seed": seed})
    profile_path = folder / scenario.profile
    profile = load_profile(profile_path)
    seeds = SeedSequence(scenario.seed)
    rng = np.random.default_rng(seeds)
    yaw = rng.uniform(-np.pi, np.pi) if scenario.start_yaw_deg is None else np.radians(scenario.start_yaw_deg)
    standing_m = scenario.quadrotor.ground_height_m + scenario.quadrotor.standing_height_m
    if T_world_start is None:
        T_world_start = Pose.of([*scenario.start_world_m, standing_m], rotation.from_yaw(yaw))
    else:
        start_xy = (float(T_world_start.p[0]), float(T_world_start.p[1]))
        scenario = scenario.model_copy(update={"start_world_m": start_xy})
    waypoints = profile.leader.mission.waypoints_m if profile.leader is not None else []
    goal_world = T_world_start.transform(waypoints[-1] if waypoints else [0.0, 0.0, 0.0])
    return Stage(
        scenario=scenario,
        profile=profile,
        profile_path=profile_path,
        world=_world(scenario, folder, goal_world, rng),
        T_world_start=T_world_start,
        goal_world=goal_world,
        seeds=seeds,
    )


def _world(scenario: Scenario, folder: Path, goal_world: FloatArray, rng: Generator) -> World:
    start, goal = scenario.start_world_m, (float(goal_world[0]), float(goal_world[1]))
    if scenario.world.site in FLOWN_SITES and start != (0.0, 0.0):
        raise ProfileError(
            f"start_world_m: found {start}, allowed is (0, 0): the site {scenario.world.site} begins there"
        )
    if scenario.world.pillars is not None:
        places = {"spawn_world_m": start, "goal_world_m": goal}
        return pillar_field(rng, scenario.world.pillars.model_copy(update=places))
    return site_of(scenario.world, rng, folder=folder, followers=0, spawn_world=start, goal_world=goal).world


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of scenario files, for editors."""
    return {"$schema": SCHEMA_DIALECT, **Scenario.model_json_schema(), "title": "Companion scenario"}


def schema_text() -> str:
    """Return the schema as the text of a file."""
    return json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n"
