"""What can be tuned in the LiDAR-inertial odometry; the defaults fit a Mid-360 on a small quadrotor."""

from typing import Literal

from pydantic import Field

from companion.perception.odometry.external_settings import ExternalMotionSettings
from companion.settings import Settings


class OdometrySettings(Settings):
    """Settings of the LiDAR-inertial odometry."""

    source: Literal["lidar_inertial", "external"] = "lidar_inertial"
    """Where own motion comes from: our own estimate, or another process by way of `external_odometry`."""
    external: ExternalMotionSettings = ExternalMotionSettings()
    """What the other process's odometry has to be like; for the source `external` only."""

    output_hz: float = Field(default=200.0, ge=1.0, le=400.0)
    """Rate of the forward-propagated odometry; never more than one per IMU sample."""
    registered_points: int = Field(default=20_000, ge=100, le=100_000)
    """Most points of one registered scan; above it, farther points are thinned before nearer ones."""

    min_range_m: float = Field(default=0.3, ge=0.0, le=5.0)
    """Nearer returns (frame, propellers, rain) are ignored."""
    max_range_m: float = Field(default=70.0, ge=5.0, le=200.0)
    """Farther returns are ignored."""
    ignore_uncertain_points: bool = True
    """Drop points whose tag bits 4-5 mark low confidence of the return's position."""
    matched_points: int = Field(default=1000, ge=200, le=10_000)
    """Wanted number of points per registration; the thinning grid adapts its cell size to it."""
    thinning_cell_min_m: float = Field(default=0.05, ge=0.01, le=1.0)
    """Smallest cell of the thinning grid."""
    thinning_cell_max_m: float = Field(default=1.0, ge=0.05, le=5.0)
    """Largest cell of the thinning grid."""

    fine_cell_m: float = Field(default=0.15, ge=0.05, le=1.0)
    """Cell of the fine map: one fused point each; planes are fitted to 3 x 3 x 3 cells."""
    coarse_cell_m: float = Field(default=0.6, ge=0.2, le=5.0)
    """Cell of the coarse map, used where the fine one is still too sparse."""
    fine_range_m: float = Field(default=30.0, ge=5.0, le=200.0)
    """Farther points are too sparse for the fine map and enter the coarse one only."""
    fine_blocks: int = Field(default=131_072, ge=1024, le=1_048_576)
    """Most blocks of 2 x 2 x 2 cells kept in the fine map (about 170 bytes each)."""
    coarse_blocks: int = Field(default=32_768, ge=1024, le=1_048_576)
    """Most blocks of 2 x 2 x 2 cells kept in the coarse map."""
    map_radius_m: float = Field(default=100.0, ge=10.0, le=1000.0)
    """Blocks farther than this from the sensor are forgotten."""

    range_sigma_m: float = Field(default=0.02, gt=0.0, le=0.5)
    """Standard deviation of a range."""
    angle_sigma_deg: float = Field(default=0.05, ge=0.0, le=2.0)
    """Standard deviation of a beam's direction; matters where a beam grazes a surface."""
    map_sigma_m: float = Field(default=0.02, ge=0.0, le=0.5)
    """Standard deviation added for what neighbouring points have in common: the map's own error."""
    plane_thickness_m: float = Field(default=0.1, gt=0.0, le=1.0)
    """Neighbourhoods whose points scatter more than this about their plane are not used."""
    max_iterations: int = Field(default=6, ge=1, le=20)
    """Most Gauss-Newton steps per scan."""
    min_effective_points: int = Field(default=50, ge=10, le=1000)
    """With fewer matched points a scan does not correct the state."""
    consistent_share: float = Field(default=0.6, ge=0.0, le=1.0)
    """When fewer of the points that found a plane agree with it, the match is searched more widely, and
    refused if that does not help."""
    wide_position_sigma_m: float = Field(default=0.3, gt=0.0, le=2.0)
    """How far off the prediction may be in the wider search."""
    wide_rotation_sigma_deg: float = Field(default=2.0, gt=0.0, le=20.0)
    """The same for its attitude."""
    wide_velocity_sigma: float = Field(default=1.0, gt=0.0, le=10.0)
    """The same for its velocity, m/s."""
    degenerate_fraction: float = Field(default=0.004, ge=0.0, le=0.2)
    """A direction observed by less than this share of the scan's information is left to the IMU."""

    gyro_noise: float = Field(default=2e-4, gt=0.0, le=0.1)
    """Density of the gyro's white noise, rad/s/sqrt(Hz); more is used while vibration shows more."""
    gyro_scale_sigma: float = Field(default=0.003, ge=0.0, le=0.1)
    """Standard deviation of the gyro's scale factors: how wrong a rate is that the bias does not explain."""
    accel_noise: float = Field(default=4e-3, gt=0.0, le=1.0)
    """Density of the accelerometer's white noise, m/s^2/sqrt(Hz)."""
    gyro_bias_walk: float = Field(default=2e-5, ge=0.0, le=0.01)
    """Random walk of the gyro bias, rad/s^2/sqrt(Hz)."""
    accel_bias_walk: float = Field(default=2e-4, ge=0.0, le=0.1)
    """Random walk of the accelerometer bias, m/s^3/sqrt(Hz)."""
    gravity: float = Field(default=9.80665, ge=9.7, le=9.9)
    """Local gravity, m/s^2."""
    accel_saturation: float = Field(default=78.0, ge=10.0, le=400.0)
    """Specific force on one axis, m/s^2, above which a sample counts as saturated."""
    gyro_saturation: float = Field(default=34.0, ge=1.0, le=70.0)
    """Rate on one axis, rad/s, above which a sample counts as saturated."""

    initial_window_s: float = Field(default=1.0, ge=0.5, le=10.0)
    """Time the sensor must rest before the odometry starts."""
    still_gyro_sigma: float = Field(default=0.02, gt=0.0, le=0.5)
    """Largest standard deviation of a gyro axis at rest, rad/s."""
    still_accel_sigma: float = Field(default=0.25, gt=0.0, le=5.0)
    """Largest standard deviation of an accelerometer axis at rest, m/s^2."""
    max_gyro_bias: float = Field(default=0.03, gt=0.0, le=1.0)
    """Mean rate above which the sensor is turning rather than biased, rad/s."""
    max_gravity_error: float = Field(default=0.6, gt=0.0, le=3.0)
    """Largest difference between the mean specific force at rest and gravity, m/s^2."""
    still_displacement_m: float = Field(default=0.05, gt=0.0, le=1.0)
    """Largest displacement between the first and last scan of the window."""
    initial_accel_bias_sigma: float = Field(default=0.05, gt=0.0, le=1.0)
    """Standard deviation of the accelerometer bias at start, m/s^2; the map leans by as much
    over gravity, and its covariance says so."""

    max_imu_gap_s: float = Field(default=0.6, ge=0.02, le=2.0)
    """A longer silence of the IMU restarts the odometry; a shorter one is bridged."""
    gap_accel_sigma: float = Field(default=2.0, ge=0.0, le=20.0)
    """Acceleration that may have gone unseen while samples are missing, m/s^2."""
    gap_rate_sigma: float = Field(default=0.5, ge=0.0, le=20.0)
    """Rate that may have gone unseen while samples are missing, rad/s."""
    saturated_accel_sigma: float = Field(default=40.0, ge=0.0, le=400.0)
    """How far off a saturated sample may be, m/s^2."""
    saturated_rate_sigma: float = Field(default=5.0, ge=0.0, le=70.0)
    """How far off a saturated sample may be, rad/s."""
    degraded_after_s: float = Field(default=0.25, ge=0.1, le=5.0)
    """Without an accepted scan for this long the status is DEGRADED."""
    lost_after_s: float = Field(default=4.0, ge=0.5, le=10.0)
    """Without an accepted scan for this long the status is LOST; see `search_s` for what follows."""

    imu_hz: float = Field(default=200.0, ge=20.0, le=2000.0)
    """Nominal rate of the IMU; half of it or twice as much is reported as a fault."""
    imu_silent_after_s: float = Field(default=0.06, ge=0.01, le=1.0)
    """Without an IMU sample for this long the status is DEGRADED: twelve samples at 200 Hz."""
    max_angular_acceleration: float = Field(default=150.0, ge=10.0, le=5000.0)
    """More than the vehicle can do, rad/s^2: a knock, or a mount that slips."""
    stamp_tolerance_s: float = Field(default=0.03, ge=0.005, le=0.5)
    """How far the stamps of scans may move against those of the IMU: 9 cm at 3 m/s."""
    gyro_bias_limit: float = Field(default=0.06, gt=0.0, le=1.0)
    """Estimated gyro bias, rad/s, that no healthy chip has."""
    accel_bias_limit: float = Field(default=1.0, gt=0.0, le=10.0)
    """Estimated accelerometer bias, m/s^2, that no healthy chip has."""
    search_after_s: float = Field(default=1.0, ge=0.3, le=10.0)
    """After an outage of this length the place is searched and proven before it is used again."""
    search_s: float = Field(default=10.0, ge=0.5, le=60.0)
    """A lost odometry keeps its map and searches its place for this long before it waits for rest."""
    residual_correlation: float = Field(default=3.2, ge=1.0, le=100.0)
    """How many times larger the variance of a matched motion is than if all residuals were independent, when
    they scatter as assumed: they share the map's errors, which do not average out."""
    position_sigma_floor_m: float = Field(default=5e-4, ge=0.0, le=1.0)
    """Smallest published standard deviation of each position axis."""
    rotation_sigma_floor_deg: float = Field(default=0.005, ge=0.0, le=10.0)
    """Smallest published standard deviation of each rotation axis."""
    velocity_sigma_floor: float = Field(default=0.002, ge=0.0, le=1.0)
    """Smallest published standard deviation of each velocity axis, m/s."""
