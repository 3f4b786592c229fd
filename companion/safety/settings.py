"""What the supervisor permits; every vehicle states it in its profile."""

from pydantic import Field

from companion.settings import Settings


class SafetySettings(Settings):
    """Limits that hold for every setpoint, whoever asked for it."""

    max_speed_mps: float = Field(default=2.0, gt=0.0, le=8.0)
    """Largest horizontal speed that is ever commanded."""

    max_climb_mps: float = Field(default=1.0, gt=0.0, le=3.0)
    """Largest upward speed."""

    max_descent_mps: float = Field(default=0.7, gt=0.0, le=2.0)
    """Largest downward speed."""

    max_acceleration_mps2: float = Field(default=4.0, gt=0.0, le=10.0)
    """Largest change of the commanded velocity per second."""

    max_yaw_rate_deg_s: float = Field(default=60.0, gt=0.0, le=180.0)
    """Largest commanded turn rate."""

    min_altitude_m: float = Field(default=0.5, ge=0.0, le=50.0)
    """Below this height over the start point the vehicle is not commanded to descend."""

    max_altitude_m: float = Field(default=3.5, gt=0.0, le=100.0)
    """Above this height over the start point the vehicle is not commanded to climb."""

    max_data_age_ms: float = Field(default=200.0, ge=50.0, le=200.0)
    """Sensor data older than this moves nothing: the vehicle brakes and holds."""

    max_scan_age_ms: float = Field(default=400.0, ge=200.0, le=1000.0)
    """Without a matched scan for longer than this the vehicle is blind: it brakes and holds."""

    lost_after_ms: float = Field(default=1000.0, ge=200.0, le=2000.0)
    """After holding this long without usable odometry the stream ends, so that PX4's failsafe acts."""

    min_quality: int = Field(default=20, ge=1, le=100)
    """Odometry of lower quality moves nothing."""

    max_velocity_disagreement_mps: float = Field(default=1.0, gt=0.0, le=5.0)
    """Largest difference between our velocity and the autopilot's own for half a second."""

    max_heading_disagreement_deg: float = Field(default=15.0, gt=0.0, le=90.0)
    """Largest difference between our heading and the autopilot's: beyond it, it flies elsewhere."""

    max_pose_jump_m: float = Field(default=0.3, gt=0.0, le=5.0)
    """Largest step of the estimated position beyond what the vehicle's velocity explains."""

    max_attitude_jump_deg: float = Field(default=10.0, gt=0.0, le=90.0)
    """The same for its attitude."""

    engage_timeout_s: float = Field(default=3.0, ge=1.0, le=10.0)
    """How long the autopilot may take to enter OFFBOARD before the attempt is given up."""
