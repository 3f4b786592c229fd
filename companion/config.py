"""The profile of a vehicle: every module's settings in one strict, frozen model.

A profile is a YAML file (`companion.yaml_source`); rules that concern more than one module live here.
"""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import Field, Strict, model_validator

from companion.control.followers.layout_kernels import (
    AZIMUTHS,
    ELEVATIONS,
    HIGHEST_ELEVATION_DEG,
    LOWEST_ELEVATION_DEG,
)
from companion.control.followers.settings import FollowerSettings
from companion.control.leader.settings import LeaderSettings
from companion.control.model_file import pinned
from companion.drivers.external_odometry_settings import ExternalOdometrySettings
from companion.drivers.livox_settings import LivoxSettings
from companion.drivers.px4_settings import Px4Settings
from companion.geometry import rotation
from companion.geometry.pose import Pose
from companion.logs.writer import LogSettings
from companion.perception.neighbours import NeighbourSettings
from companion.perception.occupancy import GridSettings
from companion.perception.odometry.settings import OdometrySettings
from companion.perception.tracking.settings import TrackingSettings
from companion.safety.settings import SafetySettings
from companion.settings import Settings
from companion.yaml_problems import misfit
from companion.yaml_source import EXTENDS, load

Role = Literal["leader", "follower"]
AuthorisationSource = Literal["mode_switch", "ground_station", "command"]
BodyCoordinate = Annotated[float, Field(ge=-2.0, le=2.0)]
Angle = Annotated[float, Field(ge=-180.0, le=180.0)]

SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
MID360_IMU_POSITION_M = (0.011, 0.02329, -0.04412)
"""Position of the inertial chip in the point frame; the axes are parallel."""

_SCHEMA_TITLE = "Companion vehicle profile"
_MAX_NAME_LENGTH = 32
_GRID_OF_A_FOLLOWER = {
    "azimuths": AZIMUTHS,
    "elevations": ELEVATIONS,
    "lowest_elevation_deg": LOWEST_ELEVATION_DEG,
    "highest_elevation_deg": HIGHEST_ELEVATION_DEG,
}


class VehicleSettings(Settings):
    """Which vehicle this is and how the sensor sits on it."""

    name: str = Field(min_length=1, max_length=_MAX_NAME_LENGTH, pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")
    """Name in logs, folders and reports: letters, digits, hyphens and underscores."""

    lidar_position_m: Annotated[tuple[BodyCoordinate, BodyCoordinate, BodyCoordinate], Strict(False)] = (
        0.0,
        0.0,
        0.0,
    )
    """Origin of the LiDAR's point frame in the body frame: forward, left, up."""

    lidar_rotation_deg: Annotated[tuple[Angle, Angle, Angle], Strict(False)] = (0.0, 0.0, 0.0)
    """Attitude of the LiDAR in the body: roll, pitch, yaw, turned about z first, then y, then x."""

    @property
    def T_body_lidar(self) -> Pose:
        """Transform from the LiDAR's point frame to the body frame."""
        roll, pitch, yaw = np.deg2rad(self.lidar_rotation_deg)
        q_body_lidar = rotation.multiply(
            rotation.from_yaw(yaw),
            rotation.multiply(rotation.exp([0.0, pitch, 0.0]), rotation.exp([roll, 0.0, 0.0])),
        )
        return Pose.of(self.lidar_position_m, q_body_lidar)

    @property
    def T_lidar_imu(self) -> Pose:
        """Transform from the Mid-360's inertial chip to its point frame, as the manufacturer states it."""
        return Pose.of(MID360_IMU_POSITION_M, rotation.IDENTITY)


class AuthorisationSettings(Settings):
    """Who may permit the companion to take control."""

    sources: Annotated[tuple[AuthorisationSource, ...], Strict(False)] = Field(
        default=("mode_switch", "command"), min_length=1, max_length=3
    )
    """`mode_switch`: the pilot selects OFFBOARD; `ground_station`: a MAVLink command; `command`: on board."""


class Profile(Settings):
    """Everything that is configured on one vehicle."""

    vehicle: VehicleSettings
    """Which vehicle this is."""

    role: Role
    """What it does in the swarm."""

    authorisation: AuthorisationSettings = AuthorisationSettings()
    """Who may permit it to take control."""

    lidar: LivoxSettings = LivoxSettings()
    """The Livox Mid-360."""

    autopilot: Px4Settings = Px4Settings()
    """The link to PX4."""

    odometry: OdometrySettings = OdometrySettings()
    """Own motion: where it comes from, and the LiDAR-inertial odometry."""

    external_odometry: ExternalOdometrySettings = ExternalOdometrySettings()
    """Where another process sends its odometry; for `odometry.source: external` only."""

    tracking: TrackingSettings = TrackingSettings()
    """How other UAVs are found and followed."""

    leader: LeaderSettings | None = None
    """Mission and planner; for the role `leader` only."""

    neighbours: NeighbourSettings = NeighbourSettings()
    """Which of the tracked UAVs a follower reckons with."""

    grid: GridSettings = GridSettings()
    """The obstacle grid that a follower sees."""

    follower: FollowerSettings | None = None
    """The law that a follower flies by; for the role `follower` only, which has the defaults without it."""

    safety: SafetySettings = SafetySettings()
    """Limits that hold for every setpoint."""

    log: LogSettings = LogSettings()
    """What is recorded."""

    @model_validator(mode="after")
    def _role_has_its_section(self) -> "Profile":
        if self.role == "leader" and self.leader is None:
            raise misfit(("role",), "'leader' without a section leader", "a section leader with a mission")
        if self.role != "leader" and self.leader is not None:
            raise misfit(
                ("leader",), f"a mission for the role {self.role!r}", "it for the role 'leader' only"
            )
        return self

    @model_validator(mode="before")
    @classmethod
    def _follower_has_its_section(cls, values: Any) -> Any:
        if isinstance(values, dict) and values.get("role") == "follower" and values.get("follower") is None:
            return {**values, "follower": {}}
        return values

    @model_validator(mode="after")
    def _follower_fits(self) -> "Profile":
        if self.follower is None:
            return self
        if self.role != "follower":
            raise misfit(
                ("follower",), f"a law for the role {self.role!r}", "it for the role 'follower' only"
            )
        for name, value in _GRID_OF_A_FOLLOWER.items():
            found = getattr(self.grid, name)
            if found != value:
                raise misfit(("grid", name), f"{found:g}", f"{value:g}, which the followers' laws know")
        command, safety = self.follower.command, self.safety
        if command.max_speed_mps > safety.max_speed_mps:
            at = ("follower", "command", "max_speed_mps")
            raise misfit(
                at,
                f"{command.max_speed_mps:g}",
                f"at most safety.max_speed_mps, {safety.max_speed_mps:g}",
            )
        low, high = safety.min_altitude_m, safety.max_altitude_m
        if not low <= command.recovery_height_m <= high:
            raise misfit(
                ("follower", "command", "recovery_height_m"),
                f"{command.recovery_height_m:g}",
                f"from safety.min_altitude_m to max_altitude_m, {low:g} to {high:g}",
            )
        return self

    @model_validator(mode="after")
    def _sources_are_distinct(self) -> "Profile":
        sources = self.authorisation.sources
        for index, source in enumerate(sources):
            if source in sources[:index]:
                raise misfit(("authorisation", "sources", index), f"{source!r} twice", "each source once")
        return self

    @model_validator(mode="after")
    def _external_odometry_has_its_own_port(self) -> "Profile":
        if self.odometry.source != "external":
            return self
        ports = self.lidar.host_ports
        taken = {ports.discovery, ports.command, ports.state, ports.points, ports.imu}
        if self.autopilot.url.startswith("udpin://"):
            taken.add(int(self.autopilot.url.rpartition(":")[2]))
        port = self.external_odometry.port
        if port in taken:
            raise misfit(
                ("external_odometry", "port"),
                f"{port}, which the LiDAR or the autopilot uses",
                "another port",
            )
        return self

    @model_validator(mode="after")
    def _altitudes_are_ordered(self) -> "Profile":
        low, high = self.safety.min_altitude_m, self.safety.max_altitude_m
        if low >= high:
            raise misfit(
                ("safety", "min_altitude_m"), f"{low:g}", f"less than safety.max_altitude_m, {high:g}"
            )
        return self

    @model_validator(mode="after")
    def _mission_keeps_the_limits(self) -> "Profile":
        if self.leader is None:
            return self
        mission, safety = self.leader.mission, self.safety
        low, high = safety.min_altitude_m, safety.max_altitude_m
        for index, (_, _, z) in enumerate(mission.waypoints_m):
            if not low <= z <= high:
                at = ("leader", "mission", "waypoints_m", index, 2)
                raise misfit(
                    at, f"{z:g}", f"from safety.min_altitude_m to max_altitude_m, {low:g} to {high:g}"
                )
        vertical_limit = min(safety.max_climb_mps, safety.max_descent_mps)
        limits = (
            (("mission", "speed_mps"), mission.speed_mps, "max_speed_mps", safety.max_speed_mps),
            (
                ("mission", "max_vertical_speed_mps"),
                mission.max_vertical_speed_mps,
                "max_climb_mps and max_descent_mps",
                vertical_limit,
            ),
        )
        for path, value, name, limit in limits:
            if value > limit:
                raise misfit(("leader", *path), f"{value:g}", f"at most safety.{name}, {limit:g}")
        return self


def load_profile(path: Path | str) -> Profile:
    """Read a vehicle's profile; if it names a learned model, the result names its hash as well.

    Raises:
        MissingProfileError: if there is no such file.
        RejectedProfileError: if anything in it is wrong; the text names file, line, column, key, what was
            found and what is allowed.
    """
    profile = load(path, Profile)
    if profile.follower is None:
        return profile
    return profile.model_copy(update={"follower": pinned(profile.follower.located(Path(path).parent))})


def profile_text(profile: Profile) -> str:
    """Return a profile as YAML with every default written out; loading it gives an equal profile."""
    return yaml.safe_dump(profile.model_dump(mode="json"), sort_keys=False, allow_unicode=True)


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of profile files, for editors.

    A file that extends another may leave out what the other says, so required keys are demanded only of
    files without ``extends``.
    """
    schema = Profile.model_json_schema()
    complete = _required(schema, schema)
    _relax(schema, schema)
    extends = {
        "type": "string",
        "minLength": 1,
        "description": "A profile, relative to this file, to start from.",
    }
    schema["properties"] = {EXTENDS: extends, **schema["properties"]}
    schema["if"] = {"not": {"required": [EXTENDS]}}
    schema["then"] = complete
    return {"$schema": SCHEMA_DIALECT, **schema, "title": _SCHEMA_TITLE}


def schema_text() -> str:
    """Return the JSON schema as the text of ``profile.schema.json``."""
    return json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n"


def _objects(schema: dict[str, Any], root: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the mappings that a schema may stand for, references and alternatives followed."""
    if "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rpartition("/")[2]]
    if "anyOf" in schema:
        return [found for branch in schema["anyOf"] for found in _objects(branch, root)]
    return [schema] if schema.get("type") == "object" else []


def _required(schema: dict[str, Any], root: dict[str, Any]) -> dict[str, Any]:
    """Return only what a schema requires of its mappings, level by level, with references written out."""
    found = _objects(schema, root)
    if len(found) != 1:
        return {}
    inner = {name: _required(part, root) for name, part in found[0].get("properties", {}).items()}
    result: dict[str, Any] = {}
    if "required" in found[0]:
        result["required"] = list(found[0]["required"])
    if any(inner.values()):
        result["properties"] = {name: part for name, part in inner.items() if part}
    return result


def _relax(schema: dict[str, Any], root: dict[str, Any]) -> None:
    """Drop what is required of mappings that can be merged; items of lists are always complete."""
    for found in _objects(schema, root):
        found.pop("required", None)
        for part in found.get("properties", {}).values():
            _relax(part, root)
