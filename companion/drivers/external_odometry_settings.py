"""Configuration of the link over which another process on this computer sends its odometry."""

from typing import Annotated, Literal

from pydantic import Field, Strict

from companion.drivers.livox_settings import IPv4, Port
from companion.settings import Settings

Frame = Literal["local_frd", "local_ned", "local_flu"]
ChildFrame = Literal["body_frd", "body_flu"]
SourceClock = Literal["estimated", "host_monotonic", "lidar"]
MavlinkId = Annotated[int, Field(ge=1, le=255)]


class ExternalOdometrySettings(Settings):
    """Where MAVLink ODOMETRY arrives, from whom it is taken and in which frames and on which clock it may be.

    The sender's frame is the map: its origin and yaw are where the sender started. `local_ned` is taken
    as true north, so that x of the map then points east.
    """

    bind_ip: IPv4 = "127.0.0.1"
    """Own address to listen at; only processes on this computer reach the default."""
    port: Port = 14_580
    """UDP port to listen at."""

    system_ids: Annotated[tuple[MavlinkId, ...], Field(max_length=8, strict=False)] = ()
    """MAVLink system ids that are listened to; empty for any."""
    component_ids: Annotated[tuple[MavlinkId, ...], Field(max_length=8, strict=False)] = ()
    """MAVLink component ids that are listened to; empty for any."""

    frames: Annotated[tuple[Frame, ...], Field(min_length=1, max_length=3), Strict(False)] = (
        "local_frd",
        "local_ned",
        "local_flu",
    )
    """Values of `frame_id` that are accepted: MAV_FRAME_LOCAL_FRD (20), LOCAL_NED (1), LOCAL_FLU (21)."""
    child_frames: Annotated[tuple[ChildFrame, ...], Field(min_length=1, max_length=2), Strict(False)] = (
        "body_frd",
        "body_flu",
    )
    """Values of `child_frame_id` that are accepted: MAV_FRAME_BODY_FRD (12), and 13 for BODY_FLU. The
    quaternion turns the child frame into the frame; velocity and rates are in the child frame."""

    clock: SourceClock = "estimated"
    """What `time_usec` counts: `host_monotonic` is this computer's CLOCK_MONOTONIC, `lidar` the LiDAR's own
    time; with `estimated` it may be Unix time or anything else, and the least delayed message tells."""
    min_delay_ms: float = Field(default=0.0, ge=0.0, le=200.0)
    """With the clock `estimated`: least time that the sender takes from its measurement to its message."""
    max_delay_ms: float = Field(default=400.0, ge=20.0, le=2000.0)
    """Messages that are older on arrival are refused."""
    max_rate_hz: float = Field(default=250.0, ge=10.0, le=1000.0)
    """Messages stamped closer together than half this rate's period are refused."""
    silence_timeout_s: float = Field(default=2.0, ge=0.5, le=60.0)
    """After this long without an accepted message another sender, or other frames, may take over."""

    position_sigma_m: float = Field(default=0.05, gt=0.0, le=5.0)
    """Standard deviation used when the sender states none."""
    rotation_sigma_deg: float = Field(default=1.0, gt=0.0, le=30.0)
    """The same for each rotation axis."""
    velocity_sigma_mps: float = Field(default=0.1, gt=0.0, le=5.0)
    """The same for each velocity axis."""
    max_position_sigma_m: float = Field(default=10.0, gt=0.0, le=1000.0)
    """Messages that state more than this on an axis are refused."""
    max_rotation_sigma_deg: float = Field(default=60.0, gt=0.0, le=180.0)
    """The same for rotations."""
    max_velocity_sigma_mps: float = Field(default=10.0, gt=0.0, le=1000.0)
    """The same for velocities."""
    max_speed_mps: float = Field(default=30.0, gt=0.0, le=200.0)
    """Messages that state a higher speed are refused."""
    max_distance_m: float = Field(default=10_000.0, ge=10.0, le=1e6)
    """Messages that state a position farther from the origin are refused."""
