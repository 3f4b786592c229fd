"""Gains of the laws of others; the defaults match the flock radius and separation published for them."""

from pydantic import Field

from companion.settings import Settings


class PacnavSettings(Settings):
    """Follow whoever flies most purposefully."""

    body_radius_m: float = Field(default=0.4, gt=0.0, le=2.0)
    """Of a vehicle, taken off every distance."""
    flock_radius_m: float = Field(default=1.1, gt=0.1, le=10.0)
    """Neighbours nearer than this are no targets, and are not flown at."""
    navigation_per_s: float = Field(default=0.8, ge=0.0, le=5.0)
    """Speed for each metre to the target."""
    force_mps: float = Field(default=1.0, ge=0.0, le=10.0)
    """Strength of the collision forces between vehicles."""
    force_reach_m: float = Field(default=1.1, gt=0.1, le=10.0)
    """Beyond this gap, and one more `body_radius_m`, there is no force between vehicles."""
    max_speed_mps: float = Field(default=1.7, gt=0.0, le=8.0)
    """Largest speed of this law; it must exceed the leader's."""
    hold_s: float = Field(default=1.0, ge=0.0, le=10.0)
    """How long a neighbour out of sight is held where it was, also as one to keep clear of."""
    history_s: float = Field(default=4.0, gt=0.0, le=20.0)
    """Length of the paths; at most 23 beats are kept."""
    beat_s: float = Field(default=0.2, ge=0.02, le=2.0)
    """Time between the samples of a path."""
    still_m: float = Field(default=0.06, ge=0.0, le=1.0)
    """A shorter step between two samples is noise and counts as none."""
    settle_s: float = Field(default=2.8, ge=0.0, le=20.0)
    """Nobody is followed before paths have been watched for so long."""
    obstacle_mps: float = Field(default=1.5, ge=0.0, le=10.0)
    """Strength of the forces that keep clear of obstacles."""
    obstacle_reach_m: float = Field(default=2.1, gt=0.1, le=10.0)
    """Beyond this gap there is no such force. As published it begins 2.5 m from the vehicle's centre: small
    flocks need a smaller `force_reach_m`, but do not make obstacles less dangerous."""


class VpfSettings(Settings):
    """Visual projection field with a velocity in both directions."""

    body_radius_m: float = Field(default=0.2, gt=0.0, le=1.0)
    """Of the disc as which a neighbour appears."""
    gain_mps: float = Field(default=4.0, ge=0.0, le=20.0)
    """Speed for each unit of the field."""
    edge: float = Field(default=0.10, ge=0.0, le=2.0)
    """Weight of an edge (pull) against the area (push); neighbours settle at `body_radius_m / edge`."""
    alignment: float = Field(default=0.8, ge=0.0, le=1.5)
    """Share of the neighbours' mean velocity that is flown along."""
    obstacle_mps: float = Field(default=1.0, ge=0.0, le=20.0)
    """The gain for obstacles, which have no edges."""
    obstacle_reach_m: float = Field(default=3.0, gt=0.1, le=10.0)
    """Obstacles farther than this are not in the field."""


class VpfPolarSettings(Settings):
    """Visual projection field with speed and course, as it was first stated."""

    body_radius_m: float = Field(default=0.2, gt=0.0, le=1.0)
    """Of the disc as which a neighbour appears."""
    relaxation_per_s: float = Field(default=0.5, ge=0.0, le=10.0)
    """How fast the speed returns to the cruise speed."""
    cruise_mps: float = Field(default=1.0, ge=0.0, le=5.0)
    """Speed of one that sees nobody."""
    speed_gain_mps2: float = Field(default=2.0, ge=0.0, le=20.0)
    """Acceleration for each unit of the field ahead."""
    speed_edge: float = Field(default=0.10, ge=0.0, le=2.0)
    """Weight of an edge for the speed."""
    turn_gain_per_s: float = Field(default=2.0, ge=0.0, le=20.0)
    """Turn rate for each unit of the field to the side."""
    turn_edge: float = Field(default=0.10, ge=0.0, le=2.0)
    """Weight of an edge for the course."""
    obstacle: float = Field(default=1.0, ge=0.0, le=20.0)
    """Weight of obstacles against neighbours."""
    obstacle_reach_m: float = Field(default=3.0, gt=0.1, le=10.0)
    """Obstacles farther than this are not in the field."""


class ReynoldsApfSettings(Settings):
    """Cohesion, separation and alignment, and a potential field of obstacles."""

    separation_m2ps: float = Field(default=6.0, ge=0.0, le=20.0)
    """Push away from neighbours, divided by their distance."""
    cohesion_per_s: float = Field(default=1.3, ge=0.0, le=5.0)
    """Pull towards neighbours for each metre."""
    alignment: float = Field(default=0.0, ge=0.0, le=1.5)
    """Share of the neighbours' mean velocity that is flown along."""
    low_pass_s: float = Field(default=0.0, ge=0.0, le=5.0)
    """Time constant that smooths the three; 0 for none."""
    obstacle_m3ps: float = Field(default=0.6, ge=0.0, le=10.0)
    """Strength of the obstacles' repulsion."""
    obstacle_reach_m: float = Field(default=2.5, gt=0.1, le=10.0)
    """Gap beyond which they do not repel."""
    body_radius_m: float = Field(default=0.2, gt=0.0, le=1.0)
    """Of the vehicle, taken off the distance to obstacles."""


class LloydSettings(Settings):
    """Fly to the weighted centroid of one's own cell."""

    radius_m: float = Field(default=3.0, gt=0.5, le=10.0)
    """Of the cell, where nothing cuts it."""
    spread_m: float = Field(default=0.5, gt=0.1, le=10.0)
    """Width of the weight about the goal."""
    least_spread_m: float = Field(default=0.3, gt=0.1, le=10.0)
    """Width that it narrows to while the vehicle is stuck."""
    stuck_m: float = Field(default=0.2, ge=0.0, le=5.0)
    """The vehicle is stuck if its centroid is nearer than this,"""
    hindered_m: float = Field(default=1.0, ge=0.0, le=5.0)
    """and the disc's own centroid farther from it than this."""
    look_ahead_s: float = Field(default=1.5, ge=0.0, le=5.0)
    """The goal is where the neighbours' mean will be after this time."""
    gain_per_s: float = Field(default=1.5, ge=0.0, le=5.0)
    """Speed for each metre to the centroid."""
    spacing_m: float = Field(default=1.0, ge=0.4, le=5.0)
    """Vehicles are kept this far apart."""
    obstacle_room_m: float = Field(default=0.5, ge=0.2, le=3.0)
    """Distance from obstacles to the vehicle's centre that is left free."""
    retreat_per_s: float = Field(default=1.5, ge=0.0, le=5.0)
    """Speed of giving way for each metre that is missing."""
