"""What a swarm is told before its trial: how many, where they begin, how the leader behaves."""

from typing import Annotated, Literal

from pydantic import Field, Strict, model_validator

from companion.settings import Settings
from companion.yaml_problems import misfit

Behaviour = Literal["straight", "hover", "reverse", "turn", "mixed"]
Range = Annotated[tuple[float, float], Strict(False)]

ROOM_TO_LIMITS_M = 0.2
"""No follower begins nearer than this to the lowest or highest altitude."""


class LeaderBehaviourSettings(Settings):
    """How the leader flies, beyond the way that its waypoints give."""

    behaviour: Behaviour = "straight"
    """`straight` to the goal; with one long `hover` on the way; one `reverse` over several metres; a sharp
    `turn` to a second goal; `mixed` draws one of them for every trial."""
    speed_mps: Range = (0.5, 1.5)
    """Cruise speed is drawn uniformly between these for every trial."""
    wait_s: float = Field(default=1.0, ge=0.0, le=60.0)
    """Standstill at the start."""
    ramp_s: float = Field(default=1.0, ge=0.0, le=60.0)
    """From standstill to cruise speed."""
    final_hold_s: float = Field(default=3.0, ge=0.0, le=60.0)
    """Pause at the goal before the trial is judged, so that followers can settle."""

    @model_validator(mode="after")
    def _speeds_are_ordered(self) -> "LeaderBehaviourSettings":
        if not 0.0 < self.speed_mps[0] <= self.speed_mps[1] <= 5.0:
            raise ValueError("speed_mps must be two rising speeds above 0 and up to 5")
        return self


class TerminationSettings(Settings):
    """What ends a trial, and what counts as success."""

    vehicle_radius_m: float = Field(default=0.2, gt=0.0, le=2.0)
    """Two centres nearer than twice this collide; so does a surface nearer than this."""
    altitude_m: Range = (0.5, 3.5)
    """Lowest and highest flight."""
    leader_unseen_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """The leader is lost when no follower has perceived it for longer."""
    goal_tolerance_m: float = Field(default=1.0, gt=0.0, le=10.0)
    """The leader has arrived within this of the goal."""
    gathered_m: float = Field(default=5.0, gt=0.0, le=100.0)
    """All followers must be this near to the leader when the trial is judged."""
    spare_time_s: float = Field(default=20.0, ge=0.0, le=600.0)
    """A trial may last twice the way at the leader's speed, and this much more."""

    @model_validator(mode="after")
    def _there_is_room_to_fly(self) -> "TerminationSettings":
        low, high = self.altitude_m
        if low + 2.0 * ROOM_TO_LIMITS_M > high:
            raise misfit(
                ("altitude_m",), f"{low:g} to {high:g}", f"at least {2.0 * ROOM_TO_LIMITS_M:g} m between them"
            )
        return self


class SwarmSettings(Settings):
    """One leader and its followers."""

    followers: int = Field(default=4, ge=1, le=20)
    """How many."""
    follower_profile: str = Field(default="sitl_swarm_follower.yaml", min_length=1)
    """Profile of every follower, relative to the file that names it."""
    spacing_m: float = Field(default=1.6, gt=0.4, le=10.0)
    """Distance between the cells of the grid on which the swarm begins."""
    jitter_m: float = Field(default=0.1, ge=0.0, le=1.0)
    """Each begins up to this far from its cell's centre, in x and y."""
    cruise_height_m: Range = (1.5, 2.0)
    """Height over the ground at which the leader flies, drawn for every trial."""
    height_jitter_m: float = Field(default=0.1, ge=0.0, le=1.0)
    """Followers begin up to this far above or below the leader."""
    goal_distance_m: float = Field(default=30.0, ge=2.0, le=500.0)
    """From the middle of the start to the goal, in a random direction, where the world names no waypoints."""
    waypoints_m: list[Range] | None = Field(default=None, min_length=1, max_length=20)
    """The leader's way in open country instead, from the middle of the start; the last point is the goal."""
    leader: LeaderBehaviourSettings = LeaderBehaviourSettings()
    termination: TerminationSettings = TerminationSettings()

    @model_validator(mode="after")
    def _leader_flies_within_the_limits(self) -> "SwarmSettings":
        low, high = self.cruise_height_m
        floor, ceiling = self.termination.altitude_m
        if not floor < low <= high < ceiling:
            raise misfit(
                ("cruise_height_m",),
                f"{low:g} to {high:g}",
                f"rising heights between {floor:g} and {ceiling:g}, termination.altitude_m",
            )
        return self
