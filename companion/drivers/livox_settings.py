"""Configuration of the Livox Mid-360 driver."""

import ipaddress
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from companion.settings import Settings


def _require_ipv4(text: str) -> str:
    try:
        return str(ipaddress.IPv4Address(text))
    except ValueError:
        raise ValueError(f"{text!r} is not an IPv4 address like 192.168.1.50") from None


def _require_ipv4_or_auto(text: str) -> str:
    return text if text == "auto" else _require_ipv4(text)


IPv4 = Annotated[str, AfterValidator(_require_ipv4)]
IPv4OrAuto = Annotated[str, AfterValidator(_require_ipv4_or_auto)]
Port = Annotated[int, Field(ge=1, le=65_535)]
Coordinate = Annotated[float, Field(ge=-10.0, le=10.0)]

TagPolicy = Literal["all", "not_low", "only_high"]
PointFormat = Literal["cartesian_32", "cartesian_16", "spherical"]


class LidarPorts(Settings):
    """UDP ports on the sensor; fixed in its firmware."""

    discovery: Port = 56_000
    """Answers searches."""
    command: Port = 56_100
    """Answers commands."""
    state: Port = 56_200
    """Sends the state once a second."""
    points: Port = 56_300
    """Sends points."""
    imu: Port = 56_400
    """Sends inertial samples."""
    log: Port = 56_500
    """Answers commands about the sensor's own log."""


class HostPorts(Settings):
    """UDP ports on this computer; the sensor is told the last three."""

    discovery: Port = 56_000
    """Sends searches; when it is taken, the command port does."""
    command: Port = 56_101
    """Sends commands."""
    state: Port = 56_201
    """Receives the state."""
    points: Port = 56_301
    """Receives points."""
    imu: Port = 56_401
    """Receives inertial samples."""


class MaskBox(Settings):
    """A box in the LiDAR's point frame whose points belong to the vehicle itself."""

    x_min_m: Coordinate
    """Rear face."""
    x_max_m: Coordinate
    """Front face."""
    y_min_m: Coordinate
    """Right face."""
    y_max_m: Coordinate
    """Left face."""
    z_min_m: Coordinate
    """Bottom."""
    z_max_m: Coordinate
    """Top."""

    @model_validator(mode="after")
    def _check_order(self) -> "MaskBox":
        for axis in "xyz":
            if getattr(self, f"{axis}_min_m") >= getattr(self, f"{axis}_max_m"):
                raise ValueError(f"{axis}_min_m must be less than {axis}_max_m")
        return self


class LivoxSettings(Settings):
    """Driver of one Livox Mid-360."""

    lidar_ip: IPv4 = "192.168.1.100"
    """Address of the sensor: 192.168.1.1xx, where xx are the last two digits of its serial number."""
    host_ip: IPv4OrAuto = "auto"
    """Own address towards the sensor; `auto` asks the kernel which one routes there."""
    lidar_ports: LidarPorts = LidarPorts()
    """Ports on the sensor."""
    host_ports: HostPorts = HostPorts()
    """Ports on this computer."""
    broadcast_search: bool = True
    """Search by broadcast too, and listen to broadcasts, so that a sensor with another address is named."""
    point_format: PointFormat = "cartesian_32"
    """Format in which the sensor sends points."""
    frame_period_ms: int = Field(default=100, ge=10, le=1000)
    """Length of a scan in sensor time."""
    min_range_m: float = Field(default=0.3, ge=0.0, le=10.0)
    """Nearer points are dropped."""
    max_range_m: float = Field(default=100.0, gt=0.0, le=1000.0)
    """Farther points are dropped."""
    tag_policy: TagPolicy = "not_low"
    """Which confidence survives: `all`; `not_low` drops what any tag field calls low; `only_high`."""
    self_mask: tuple[MaskBox, ...] = Field(default=(), max_length=16, strict=False)
    """Boxes in the LiDAR frame (propellers, arms, legs) whose points are dropped."""
    receive_buffer_bytes: int = Field(default=4 * 1024 * 1024, ge=65_536, le=268_435_456)
    """Kernel buffer of the point socket; 4 MiB hold 0.9 s."""
    silence_timeout_ms: int = Field(default=500, ge=50, le=10_000)
    """After this time without points or inertial samples the handshake runs again."""
    state_silence_timeout_ms: int = Field(default=3000, ge=1100, le=60_000)
    """After this time without a state push, once one was heard, the handshake runs again."""
    command_timeout_ms: int = Field(default=500, ge=50, le=10_000)
    """A command without answer is sent again after this time."""
    data_timeout_ms: int = Field(default=2000, ge=200, le=60_000)
    """A configured sensor that sends nothing for this time is configured again."""

    @model_validator(mode="after")
    def _check_range(self) -> "LivoxSettings":
        if self.min_range_m >= self.max_range_m:
            raise ValueError("min_range_m must be less than max_range_m")
        if self.lidar_ip == self.host_ip:
            raise ValueError("lidar_ip and host_ip must differ")
        return self
