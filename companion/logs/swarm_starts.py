"""Where the vehicles of a swarm began, so that their maps can be laid together."""

import math
from typing import Annotated

from pydantic import Field, Strict

from companion.errors import LogError
from companion.settings import Settings

MAX_VEHICLES = 64

Vector = Annotated[tuple[float, float, float], Strict(False)]


class StartPose(Settings):
    """Where a vehicle's odometry began, in the frame that all share."""

    position_m: Vector
    """Its body then, x, y, z."""
    yaw_deg: float = Field(default=0.0, ge=-360.0, le=360.0)
    """Its heading then, from x towards y."""
    clock_offset_s: float = Field(default=0.0, ge=-86400.0, le=86400.0)
    """What must be added to the times of its log, if its clock was not set as those of the others were."""


class SwarmStarts(Settings):
    """The file of `companion metrics --starts`."""

    starts: dict[str, StartPose] = Field(min_length=1, max_length=MAX_VEHICLES)
    """By the vehicles' names."""
    waypoints_m: list[Vector] = Field(default=[], max_length=100)
    """The leader's way in the same frame; the last is the goal."""


def parse_start(text: str) -> tuple[str, StartPose]:
    """Read ``NAME=x,y,z,yaw_deg``.

    Raises:
        LogError: if it is something else.
    """
    name, found, numbers = text.partition("=")
    try:
        x, y, z, yaw_deg = (float(number) for number in numbers.split(","))
        if found and name and all(map(math.isfinite, (x, y, z, yaw_deg))) and abs(yaw_deg) <= 360.0:
            return name, StartPose(position_m=(x, y, z), yaw_deg=yaw_deg)
    except ValueError:
        pass
    raise LogError(f"start {text!r}: allowed is NAME=x,y,z,yaw_deg in metres and degrees")


def parse_waypoint(text: str) -> Vector:
    """Read ``x,y,z``.

    Raises:
        LogError: if it is something else.
    """
    try:
        x, y, z = (float(number) for number in text.split(","))
        if all(map(math.isfinite, (x, y, z))):
            return x, y, z
    except ValueError:
        pass
    raise LogError(f"waypoint {text!r}: allowed is x,y,z in metres")
