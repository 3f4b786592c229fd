"""What own motion from another process has to be like to be flown on."""

from pydantic import Field, model_validator

from companion.settings import Settings


class ExternalMotionSettings(Settings):
    """Limits on odometry that another process estimates."""

    settling_s: float = Field(default=1.0, ge=0.2, le=30.0)
    """Time for which it must arrive and agree with the IMU before it counts."""
    stale_after_s: float = Field(default=0.25, ge=0.02, le=1.0)
    """Without it for this long, while the IMU carries on, the status is DEGRADED."""
    lost_after_s: float = Field(default=1.0, ge=0.1, le=5.0)
    """Without it for this long the status is LOST."""
    min_rate_hz: float = Field(default=8.0, ge=1.0, le=400.0)
    """Lower rates over the last second are DEGRADED."""

    min_quality: int = Field(default=30, ge=1, le=100)
    """A lower stated quality is DEGRADED; a stated failure is LOST."""
    unstated_quality: int = Field(default=70, ge=1, le=100)
    """Quality assumed of senders that state none."""
    max_position_sigma_m: float = Field(default=0.5, gt=0.0, le=10.0)
    """A larger standard deviation of the position is DEGRADED."""
    max_rotation_sigma_deg: float = Field(default=5.0, gt=0.0, le=60.0)
    """A larger standard deviation of the attitude is DEGRADED."""
    position_sigma_floor_m: float = Field(default=0.02, ge=0.0, le=1.0)
    """Smallest standard deviation that is passed on, for senders that are too sure of themselves."""
    rotation_sigma_floor_deg: float = Field(default=0.3, ge=0.0, le=10.0)
    """The same for each rotation axis."""
    velocity_sigma_floor_mps: float = Field(default=0.03, ge=0.0, le=1.0)
    """The same for each velocity axis."""

    max_jump_m: float = Field(default=0.3, gt=0.0, le=10.0)
    """A pose farther than this from where the pose before, its stated velocity and the IMU lead is a jump:
    it is counted as a reset of the map, whether the sender says so or not."""
    max_turn_jump_deg: float = Field(default=5.0, gt=0.0, le=90.0)
    """The same for the attitude."""
    jump_penalty_s: float = Field(default=1.0, ge=0.0, le=30.0)
    """After a jump that the sender did not announce the status is DEGRADED for this long."""
    most_resets: int = Field(default=3, ge=1, le=100)
    """With more jumps and announced resets than this within ten seconds the status is LOST."""
    max_velocity_error_mps: float = Field(default=0.5, gt=0.0, le=10.0)
    """A larger difference between the stated velocity and the way covered in half a second is DEGRADED."""
    max_tilt_error_deg: float = Field(default=4.0, gt=0.0, le=45.0)
    """Largest angle between its vertical and the accelerometer's, averaged over two seconds; more is LOST."""

    gyro_bias_time_s: float = Field(default=5.0, ge=1.0, le=120.0)
    """Time constant with which the gyro's bias is learnt from its attitudes."""
    max_gyro_bias: float = Field(default=0.05, ge=0.0, le=1.0)
    """Largest bias that is learnt, rad/s."""
    unstated_velocity_time_s: float = Field(default=0.2, ge=0.05, le=2.0)
    """Time constant with which velocity is learnt from positions when the sender states none."""

    @model_validator(mode="after")
    def _times_are_ordered(self) -> "ExternalMotionSettings":
        if self.lost_after_s <= self.stale_after_s:
            raise ValueError("lost_after_s must be more than stale_after_s")
        if self.stale_after_s * self.min_rate_hz < 1.0:
            raise ValueError("stale_after_s must be at least the period of min_rate_hz")
        return self
