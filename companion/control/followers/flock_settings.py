"""Gains of `flock`."""

from pydantic import Field

from companion.settings import Settings


class FlockSettings(Settings):
    """Follow those who lead away, keep apart, never fly faster at anything than it allows."""

    cohesion_per_s: float = Field(default=0.32, ge=0.0, le=3.0)
    """Pull towards the neighbours, per metre to their weighted mean."""
    pursuit_s_per_m: float = Field(default=6.87, ge=0.0, le=50.0)
    """Additional weight of a neighbour for each m/s at which it flies away from here: it may be leading."""
    far_weight: float = Field(default=1.22, ge=0.0, le=10.0)
    """Additional weight of a neighbour at twice `separation_m`, growing with distance."""
    feed_forward: float = Field(default=0.94, ge=0.0, le=2.0)
    """Share of the neighbours' weighted mean velocity that is flown along."""
    separation_m2ps: float = Field(default=1.2, ge=0.0, le=10.0)
    """Push away from near neighbours."""
    separation_m: float = Field(default=2.4, gt=0.4, le=8.0)
    """Neighbours farther than this do not push."""
    lead_s: float = Field(default=0.23, ge=0.0, le=1.0)
    """How far ahead of now neighbours are reckoned."""
    height_per_s: float = Field(default=1.4, ge=0.0, le=5.0)
    """Vertical speed for each metre that the wanted height is above the own."""
    top_weight: float = Field(default=0.0, ge=0.0, le=1.0)
    """The wanted height is the neighbours' mean at 0, that of the highest at 1."""
    below_m: float = Field(default=0.03, ge=-0.5, le=0.5)
    """Flown this much under the wanted height: those lower are out of sight sooner than those higher."""
    dodge_mps: float = Field(default=4.0, ge=0.0, le=10.0)
    """Speed at which a follower steps aside from a neighbour about to hit it."""
    dodge_time_s: float = Field(default=2.2, ge=0.0, le=10.0)
    """How early that begins."""
    dodge_room_m: float = Field(default=1.16, gt=0.1, le=5.0)
    """A neighbour that will pass farther than this is let pass."""
    flow_m2ps: float = Field(default=0.066, ge=0.0, le=5.0)
    """Push away from obstacles."""
    flow_reach_m: float = Field(default=2.8, gt=0.1, le=10.0)
    """Obstacles with more room than this do not push."""
    obstacle_per_s: float = Field(default=0.95, gt=0.0, le=5.0)
    """Speed allowed towards an obstacle for each metre of room."""
    obstacle_margin_m: float = Field(default=0.2, ge=0.0, le=2.0)
    """Room at which none is allowed any more."""
    neighbour_per_s: float = Field(default=1.9, gt=0.0, le=8.0)
    """The same between neighbours."""
    neighbour_margin_m: float = Field(default=0.63, ge=0.0, le=3.0)
    """Distance of the centres at which none is allowed any more."""
    neighbour_share: float = Field(default=1.0, ge=0.0, le=1.5)
    """Share of the velocity at which a neighbour comes that is given way to: 1 if it does nothing itself."""
    band_below_m: float = Field(default=0.42, ge=0.1, le=3.0)
    """Obstacles count down to this far below the own height."""
    band_above_m: float = Field(default=0.4, ge=0.1, le=3.0)
    """Obstacles count up to this far above the own height."""
    scan_delay_s: float = Field(default=0.1, ge=0.0, le=0.5)
    """Age of the obstacle grid, made up for with the own velocity."""
    obstacle_memory_s: float = Field(default=1.6, ge=0.0, le=10.0)
    """How long near obstacles are remembered; 0 for not at all."""
    neighbour_memory_s: float = Field(default=1.22, ge=0.0, le=10.0)
    """How long a neighbour out of sight is reckoned with, less and less."""
    coast_s: float = Field(default=1.6, gt=0.0, le=20.0)
    """Time constant of slowing down once nobody is known."""
    body_radius_m: float = Field(default=0.2, gt=0.0, le=1.0)
    """Of the vehicle, taken off every distance to an obstacle."""
    detour: float = Field(default=0.8, ge=0.0, le=2.0)
    """Worth of speed in any direction against speed in the wanted one, where an obstacle is in the way."""
    heed_s_per_m: float = Field(default=0.0, ge=0.0, le=50.0)
    """The same for its velocity."""
    stop_s: float = Field(default=0.47, ge=0.0, le=2.0)
    """How long the vehicle flies on before a command takes effect; it brakes that much sooner."""
    link_per_s: float = Field(default=0.51, ge=0.0, le=3.0)
    """Pull towards a neighbour with nobody between, for each metre that it is farther than `link_m`."""
    link_m: float = Field(default=1.55, gt=0.4, le=8.0)
    """Gaps up to this are not closed."""
    dodge_full_mps: float = Field(default=2.2, gt=0.0, le=5.0)
    """A neighbour that comes slower against the motion of the others is stepped aside from less, and at half
    of it hardly at all."""
    link_behind_s_per_m: float = Field(default=0.96, ge=0.0, le=5.0)
    """For each m/s at which the vehicle flies away from a neighbour, the pull towards it is so much less."""
    foresight_s: float = Field(default=0.7, ge=0.0, le=2.0)
    """Neighbours are stepped aside from and braked for at the velocity that they will have so much later."""
    pass_m: float = Field(default=0.02, ge=0.0, le=3.0)
    """An obstacle that is left aside with so much room beyond `obstacle_margin_m` does not slow down."""
    neighbour_stop_s: float = Field(default=0.3, ge=0.0, le=2.0)
    """How long the vehicle flies on towards a neighbour before a command takes effect."""
    retreat_mps: float = Field(default=1.49, ge=0.0, le=3.0)
    """It retreats from a neighbour no faster than this."""
