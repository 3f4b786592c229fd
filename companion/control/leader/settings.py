"""What the leader can be told: the mission, its map, its path planner and its potential field."""

from typing import Annotated

from pydantic import Field, model_validator

from companion.settings import Settings

Coordinate = Annotated[float, Field(ge=-100_000.0, le=100_000.0)]
Waypoint = Annotated[list[Coordinate], Field(min_length=3, max_length=3)]


class MissionSettings(Settings):
    """Where to fly and how fast."""

    waypoints_m: list[Waypoint] = Field(default=[], max_length=200)
    """Positions [x, y, z] in the map frame, metres, z up. The map's origin is the body at the start, so z
    counts from the height at which the body stood on the ground. Empty: hold where control was taken."""
    speed_mps: float = Field(default=1.0, gt=0.0, le=5.0)
    """Horizontal cruise speed."""
    max_speed_mps: float = Field(default=2.0, gt=0.0, le=5.0)
    """No command is ever faster than this, vertical part included."""
    wait_s: float = Field(default=1.0, ge=0.0, le=60.0)
    """Standstill after control is taken."""
    ramp_s: float = Field(default=1.0, ge=0.0, le=60.0)
    """Time from standstill to cruise speed after the wait."""
    arrival_radius_m: float = Field(default=0.5, gt=0.0, le=5.0)
    """A waypoint counts as reached when the body is nearer than this."""
    waypoint_hold_s: float = Field(default=0.0, ge=0.0, le=600.0)
    """Pause at every waypoint but the last; with 0 they are flown through without braking."""
    waypoint_holds_s: list[Annotated[float, Field(ge=0.0, le=600.0)]] = Field(default=[], max_length=200)
    """Pause at each waypoint one by one, instead of `waypoint_hold_s`; empty or one for every waypoint but
    the last."""
    final_hold_s: float = Field(default=3.0, ge=0.0, le=600.0)
    """Pause at the last waypoint before the mission counts as finished."""
    land_when_finished: bool = True
    """Whether the vehicle should land after the final hold, or go on holding."""
    brake_gain_per_s: float = Field(default=1.0, gt=0.0, le=3.0)
    """Speed allowed per metre left to a waypoint at which to stop: 1.0 brakes from 1 m on at 1 m/s."""
    vertical_gain_per_s: float = Field(default=1.0, gt=0.0, le=3.0)
    """Climb rate per metre of height error."""
    max_vertical_speed_mps: float = Field(default=0.5, gt=0.0, le=3.0)
    """Limit of climb and descent."""

    @model_validator(mode="after")
    def _holds_match_waypoints(self) -> "MissionSettings":
        held = len(self.waypoint_holds_s)
        if held and held != len(self.waypoints_m) - 1:
            raise ValueError(
                f"waypoint_holds_s names {held} pauses for {len(self.waypoints_m)} waypoints; "
                "it must be empty or name one for every waypoint but the last"
            )
        return self

    @model_validator(mode="after")
    def _speed_within_limit(self) -> "MissionSettings":
        if self.speed_mps > self.max_speed_mps:
            raise ValueError(f"speed_mps {self.speed_mps} exceeds max_speed_mps {self.max_speed_mps}")
        return self


class ObstacleMapSettings(Settings):
    """How returns become obstacles."""

    cell_m: float = Field(default=0.2, ge=0.05, le=1.0)
    """Horizontal size of a cell."""
    layer_m: float = Field(default=0.25, ge=0.05, le=1.0)
    """Vertical size of a cell."""
    reach_m: float = Field(default=10.0, ge=2.0, le=25.0)
    """Returns farther than this (horizontally) mark nothing."""
    band_below_m: float = Field(default=0.5, ge=0.1, le=2.0)
    """Obstacles down to this far below the vehicle, or its waypoint if lower, count."""
    band_above_m: float = Field(default=0.5, ge=0.1, le=2.0)
    """Obstacles up to this far above the vehicle, or its waypoint if higher, count."""
    ground_z_m: float = Field(default=-0.15, ge=-100.0, le=100.0)
    """Height of the ground in the map frame; negative because the body stands above it at the start."""
    ground_clearance_m: float = Field(default=0.3, ge=0.0, le=2.0)
    """Returns lower than this above the ground are ground."""
    self_radius_m: float = Field(default=0.35, ge=0.0, le=2.0)
    """Returns nearer to the body's origin than this are the vehicle itself."""
    memory_scans: int = Field(default=100, ge=1, le=10_000)
    """Scans after which an obstacle is forgotten when nothing at all returns from its direction any more."""


class RrtSettings(Settings):
    """Rapidly-exploring random tree over the plane of flight."""

    local_radius_m: float = Field(default=8.0, ge=2.0, le=20.0)
    """Distance of the local goal while the waypoint is farther."""
    sample_margin_m: float = Field(default=1.0, ge=0.0, le=5.0)
    """Samples lie in a disc this much wider than the local radius."""
    goal_bias: float = Field(default=0.15, ge=0.0, lt=1.0)
    """Share of samples that are the goal itself."""
    step_m: float = Field(default=0.8, ge=0.1, le=5.0)
    """Length of an edge."""
    max_nodes: int = Field(default=600, ge=10, le=5000)
    """Size of a tree; bounds the time of a search."""
    margin_m: float = Field(default=0.8, ge=0.0, le=5.0)
    """Room wanted between the vehicle's hull and obstacles."""
    relaxations: list[Annotated[float, Field(ge=0.0, le=1.0)]] = Field(
        default=[1.0, 0.8, 0.5, 0.3], min_length=1, max_length=8
    )
    """Shares of the margin tried one after the other until a path exists, widest first."""
    shortcuts: int = Field(default=50, ge=0, le=1000)
    """Random attempts to cut corners off a path."""
    extra_trees: int = Field(default=5, ge=0, le=50)
    """Further trees grown once a path is found, to choose the best of the paths; fewer where it is tight."""
    replan_period_s: float = Field(default=1.0, gt=0.0, le=10.0)
    """Time between searches while nothing is wrong."""
    retry_period_s: float = Field(default=0.2, gt=0.0, le=10.0)
    """Time between searches while there is no path."""
    blocked_horizon_m: float = Field(default=3.0, gt=0.0, le=20.0)
    """A path blocked nearer than this is replaced at once."""
    max_cross_track_m: float = Field(default=1.0, gt=0.0, le=10.0)
    """Distance from the path beyond which it is replaced at once."""
    keep_ratio: float = Field(default=1.1, ge=1.0, le=10.0)
    """The present path stays while it is at most this much longer than a new one."""
    patience_s: float = Field(default=90.0, gt=0.0, le=3600.0)
    """After this long without coming nearer to a waypoint the vehicle makes no more detours: it stops at the
    nearest place it can reach if that is near the waypoint (see `stand_in_distance_m`), else it holds. After
    twice as long it holds in any case."""
    stand_in_distance_m: float = Field(default=3.0, ge=0.0, le=10.0)
    """A waypoint in an obstacle is replaced by the best free point up to this far away."""


class PotentialFieldSettings(Settings):
    """Attraction along the path, repulsion from obstacles."""

    look_ahead_m: float = Field(default=1.5, ge=0.2, le=10.0)
    """Distance along the path of the point that attracts."""
    attraction: float = Field(default=1.0, gt=0.0, le=10.0)
    """Strength of the attraction (dimensionless; 1 gives cruise speed)."""
    repulsion: float = Field(default=0.3, ge=0.0, le=10.0)
    """Strength of the repulsion, m^3."""
    repulsion_distance_m: float = Field(default=2.0, gt=0.1, le=10.0)
    """Room between hull and obstacle beyond which nothing repels."""
    max_repulsion: float = Field(default=1.5, ge=0.0, le=10.0)
    """Limit of one sector's repulsion, and of the sum."""
    sectors: int = Field(default=24, ge=4, le=360)
    """Directions in which the nearest obstacle repels."""
    escape_threshold: float = Field(default=0.2, ge=-1.0, le=1.0)
    """A force along the path weaker than this gets a tangential part when the line ahead is not free."""
    least_drive: float = Field(default=0.5, ge=0.0, le=1.0)
    """Least force along the path while the straight line to the point ahead is free."""
    speed_per_room_per_s: float = Field(default=1.5, gt=0.0, le=10.0)
    """Speed allowed per metre of room between hull and obstacles: slower where it is tight."""
    least_speed_mps: float = Field(default=0.3, gt=0.0, le=2.0)
    """Speed allowed however tight it is."""
    prediction_s: float = Field(default=0.3, ge=0.0, le=2.0)
    """Forces are taken where the vehicle will be after this time, to make up for its slow response."""
    low_pass_s: float = Field(default=0.25, ge=0.0, le=5.0)
    """Time constant of the command's smoothing."""
    max_acceleration_mps2: float = Field(default=1.5, gt=0.0, le=10.0)
    """Limit of the command's change."""
    max_braking_mps2: float = Field(default=2.5, gt=0.0, le=10.0)
    """Limit of the command's change while stopping without a path."""


class LeaderSettings(Settings):
    """Everything about the leader's role."""

    vehicle_radius_m: float = Field(default=0.3, gt=0.0, le=2.0)
    """Radius of the disc that covers the vehicle, propellers included."""
    avoid_followers: bool = False
    """Treat followers as obstacles instead of leaving it to them to keep away."""
    follower_radius_m: float = Field(default=0.5, gt=0.0, le=2.0)
    """Returns this near to a tracked follower belong to it."""
    mission: MissionSettings = MissionSettings()
    obstacle_map: ObstacleMapSettings = ObstacleMapSettings()
    rrt: RrtSettings = RrtSettings()
    potential_field: PotentialFieldSettings = PotentialFieldSettings()
