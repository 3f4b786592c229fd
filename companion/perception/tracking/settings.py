"""What can be tuned in the tracking of neighbours.

The defaults are what flies. `TrackingSettings.literal` returns the published method as it stands, for
comparison.
"""

from enum import Enum

from pydantic import Field

from companion.perception.tracking.motion_filter import Agility
from companion.settings import Settings


class Association(str, Enum):
    """How clusters find their tracks."""

    GLOBAL = "global"
    """The least total cost within gates that follow the covariances."""
    GREEDY = "greedy"
    """The nearest pair first, within a fixed distance."""


class Tape(str, Enum):
    """Whether the other UAVs wear reflective tape."""

    REFLECTIVE = "reflective"
    """They do: bright points start tracks."""
    NONE = "none"
    """They do not: whatever is small, floats freely and moves is one of them."""


class TrackingSettings(Settings):
    """Settings of the neighbour tracker; lengths in metres, speeds in m/s."""

    tape: Tape = Field(default=Tape.REFLECTIVE, strict=False)
    """What marks the other UAVs."""

    stacked_scans: int = Field(default=2, ge=1, le=10)
    """B: newest scans whose points are looked at together."""
    min_range_m: float = Field(default=0.05, ge=0.0, le=5.0)
    """d_min: nearer points are left out."""
    max_range_m: float = Field(default=12.0, ge=1.0, le=40.0)
    """d_max: farther points are left out (10 in the published table)."""
    bright_reflectivity: int = Field(default=170, ge=1, le=255)
    """I_high: points at least as bright can start a track."""
    roi_radius_m: float = Field(default=0.3, gt=0.0, le=2.0)
    """r_roi: dimmer points this near to a predicted track, or to a bright cluster, are looked at too."""
    roi_sigmas: float = Field(default=2.5, ge=0.0, le=6.0)
    """The radius grows to so many standard deviations of the prediction..."""
    max_roi_radius_m: float = Field(default=0.9, gt=0.0, le=5.0)
    """...but not beyond this."""
    most_points: int = Field(default=3000, ge=100, le=20_000)
    """Most points that are clustered at once; more are thinned evenly."""

    epsilon_m: float = Field(default=0.1, gt=0.0, le=1.0)
    """Points this near to each other belong together (near the sensor)."""
    epsilon_spacings: float = Field(default=1.5, ge=0.0, le=10.0)
    """The same farther away, in mean distances between neighbouring points of the stack; 0: never grows."""
    core_points: int = Field(default=2, ge=1, le=50)
    """Points within epsilon, itself included, that make a point the core of a cluster."""
    min_points: int = Field(default=16, ge=1, le=500)
    """n_min: points a new neighbour must show in the stack at `min_points_range_m` and nearer..."""
    min_points_range_m: float = Field(default=3.0, gt=0.0, le=20.0)
    """...falling with the square of the range beyond this..."""
    min_points_floor: int = Field(default=2, ge=1, le=500)
    """...to no less than this."""
    sparse_updates: bool = True
    """A track may be kept by fewer points than it takes to begin one."""
    points_per_steradian: float = Field(default=3500.0, gt=0.0, le=1e6)
    """Points of one scan per unit of solid angle: 20,000 on 5.72 sr."""

    body_radius_m: float = Field(default=0.09, gt=0.0, le=2.0)
    """Radius of the upright cylinder that stands for another UAV's body..."""
    body_height_m: float = Field(default=0.08, gt=0.0, le=2.0)
    """...and its height; its near side is seen, its centre is wanted."""
    max_width_m: float = Field(default=0.6, gt=0.0, le=5.0)
    """Wider clusters are no UAV."""
    max_height_m: float = Field(default=0.4, gt=0.0, le=5.0)
    """Higher clusters are no UAV."""
    body_centre: bool = True
    """Measure the centre of the body; otherwise the mean of the visible points."""
    size_gate: bool = True
    """Refuse clusters by size and shape."""
    streaks: bool = True
    """Know bodies that move fast from the streaks that they leave in the stack."""

    association: Association = Field(default=Association.GLOBAL, strict=False)
    """How clusters find their tracks."""
    match_distance_m: float = Field(default=0.2, gt=0.0, le=5.0)
    """d_match: of the greedy association."""
    gate_probability: float = Field(default=0.9995, ge=0.5, lt=1.0)
    """Share of true pairs that the global association's gate admits."""
    rescue_factor: float = Field(default=4.0, ge=1.0, le=100.0)
    """A validated track and a cluster left over still match within a gate so many times as wide."""
    max_match_m: float = Field(default=0.8, gt=0.0, le=10.0)
    """Never farther from the prediction than this, however uncertain it is..."""
    max_return_m: float = Field(default=1.5, gt=0.0, le=20.0)
    """...or this, when a lost one is found again."""
    inactive_s: float = Field(default=0.5, gt=0.0, le=10.0)
    """t_inactive: an unobserved track is carried on as current for this long."""
    awaited_s: float = Field(default=3.0, ge=0.0, le=30.0)
    """A validated one that was lost is known again by any free body of its size where it is expected, tape
    in view or not, for this long; 0: never."""
    max_coast_sigma_m: float = Field(default=0.125, gt=0.0, le=20.0)
    """Unobserved, it is relied on only while no standard deviation of its position exceeds this."""
    hidden_s: float = Field(default=2.0, ge=0.0, le=30.0)
    """One that left the field of view, or is hidden by something nearer, is relied on for this long..."""
    max_hidden_sigma_m: float = Field(default=0.75, gt=0.0, le=20.0)
    """...while no standard deviation exceeds this: roughly where somebody flies is better than nothing."""
    last_seen_s: float = Field(default=10.0, ge=0.0, le=30.0)
    """A validated one stays for this much longer as 'last seen' and takes its number up again when found."""
    same_body_m: float = Field(default=0.5, gt=0.0, le=5.0)
    """Nothing new begins this near to a track, and of two tracks this near only one is true."""
    most_untaped: int = Field(default=24, ge=1, le=200)
    """Without tape anything small may be new: most tracks at once, and most places where one may begin."""
    most_tracks: int = Field(default=48, ge=1, le=200)
    """Most tracks at once, candidates included; the nearest clusters come first."""

    scatter_factor: float = Field(default=1.0, gt=0.0, le=10.0)
    """Multiplies how far single points of a body scatter about their mean in its model."""
    shape_sigma_m: float = Field(default=0.01, ge=0.0, le=0.5)
    """How far that mean may be off, whatever the number of points, along the beam and upwards; half as
    much across."""
    ego_position_sigma_m: float = Field(default=0.005, ge=0.0, le=0.5)
    """How much the own position jumps from scan to scan against the last ones; the error that all scans
    share cancels in relative positions and is not counted."""
    ego_rotation_sigma_deg: float = Field(default=0.05, ge=0.0, le=5.0)
    """The same for the own attitude."""
    degraded_factor: float = Field(default=4.0, ge=1.0, le=100.0)
    """Multiplies both while the odometry is degraded."""
    acceleration_sigma: float = Field(default=0.8, ge=0.0, le=50.0)
    """Standard deviation of each level axis of a neighbour's acceleration, m/s^2..."""
    acceleration_up_sigma: float = Field(default=0.3, ge=0.0, le=50.0)
    """...and of its acceleration upwards..."""
    acceleration_fading_s: float = Field(default=1.5, ge=0.0, le=20.0)
    """...and for how long it lasts; 0 for plain constant velocity with white acceleration."""
    steady_factor: float = Field(default=0.06, ge=0.0, le=1.0)
    """Multiplies both for a UAV that hovers or goes straight on..."""
    swerving_factor: float = Field(default=2.4, ge=1.0, le=20.0)
    """...and for one that swerves."""
    lost_fading_s: float = Field(default=1.5, gt=0.0, le=100.0)
    """How long a lost neighbour is believed to go on as it went..."""
    lost_speed_sigma: float = Field(default=1.0, ge=0.0, le=20.0)
    """...before its speed may be anything of this standard deviation on each axis, m/s."""
    acceleration_density: float = Field(default=0.01, gt=0.0, le=100.0)
    """Density of its white acceleration (gusts), m^2/s^3..."""
    known_acceleration_density: float = Field(default=0.0005, gt=0.0, le=100.0)
    """...once it is proven to be a UAV, and in which manner it flies is told from its motion."""
    initial_speed_sigma: float = Field(default=1.5, gt=0.0, le=20.0)
    """Standard deviation of a new neighbour's speed on each axis, m/s."""

    bright_share: float = Field(default=0.05, ge=0.0, le=1.0)
    """rho_high: share of bright points above which an observation counts as a UAV's."""
    max_bright_share: float = Field(default=0.85, ge=0.0, le=1.0)
    """A UAV also shows parts without tape; what shows none, by more than a few points, is a plate."""
    share_memory: float = Field(default=0.8, ge=0.0, lt=1.0)
    """How much of the past is kept, scan by scan, in that share; 0: of the stack alone."""
    on_s: float = Field(default=0.01, ge=0.0, le=10.0)
    """tau_on: duration for which it must count without a break..."""
    min_on_updates: int = Field(default=2, ge=1, le=50)
    """...and least number of updates in a row."""
    off_s: float = Field(default=2.0, ge=0.0, le=60.0)
    """A validated neighbour may show no tape for this long, as when it is seen edge-on."""
    off_in_part_s: float = Field(default=6.0, ge=0.0, le=60.0)
    """...and for this long while a part of it is hidden, or beyond the edge of the field of view."""
    scan_period_s: float = Field(default=0.1, gt=0.0, le=1.0)
    """Time between scans."""
    proof_of_flight: bool = True
    """A neighbour must also be seen to float freely or to move; otherwise brightness is enough."""
    free_evidence: float = Field(default=4.0, gt=0.0, le=50.0)
    """Log-likelihood ratio of free space below it over a foot, above which something floats."""
    foot_width_m: float = Field(default=0.06, gt=0.0, le=1.0)
    """Width of the thinnest post that is still expected to show under a sign."""
    moved_m: float = Field(default=0.4, gt=0.0, le=10.0)
    """A candidate that went this far, beyond doubt and not beside anything solid, flies..."""
    min_moving_speed: float = Field(default=0.25, ge=0.0, le=10.0)
    """...if it is also this fast, m/s."""
    moved_updates: int = Field(default=4, ge=1, le=100)
    """Observations that it takes to prove motion."""
    moved_sigmas: float = Field(default=5.0, ge=0.0, le=50.0)
    """The distance must be so many of its standard deviations."""
    surroundings_m: float = Field(default=0.4, gt=0.0, le=2.0)
    """How far below and above a body solid things count as attached to it..."""
    beside_m: float = Field(default=0.25, gt=0.0, le=2.0)
    """...and how far beside it."""
    fov_low_deg: float = Field(default=-5.0, ge=-90.0, le=0.0)
    """Lower edge of the sensor's field of view, as far as its beams are dense..."""
    fov_high_deg: float = Field(default=50.0, ge=0.0, le=90.0)
    """...and its upper edge: what reaches beyond them is seen in part."""

    def agility(self) -> Agility:
        """Return how a neighbour may accelerate."""
        return Agility(
            level_sigma=self.acceleration_sigma,
            up_sigma=self.acceleration_up_sigma,
            fading_s=self.acceleration_fading_s,
            white_density=self.acceleration_density,
            steady_factor=self.steady_factor,
            swerving_factor=self.swerving_factor,
            known_density=self.known_acceleration_density,
        )

    @classmethod
    def literal(cls) -> "TrackingSettings":
        """Return the published method: its table, and nothing that it does not describe."""
        return cls(
            max_range_m=10.0, roi_sigmas=0.0, epsilon_spacings=0.0, core_points=1, sparse_updates=False,
            streaks=False, size_gate=False, body_centre=False, association=Association.GREEDY,
            max_coast_sigma_m=20.0, last_seen_s=0.0, awaited_s=0.0, hidden_s=0.0,
            max_bright_share=1.0, share_memory=0.0, off_s=0.0, off_in_part_s=0.0, min_on_updates=1,
            proof_of_flight=False, acceleration_fading_s=0.0, acceleration_density=1.0,
        )  # fmt: skip
