"""Configuration of the link to the autopilot."""

import re
from typing import Annotated

from pydantic import AfterValidator, Field

from companion.settings import Settings

_URL = re.compile(r"(udpin|udpout|tcpin|tcpout)://[^/:\s]+:\d{1,5}|serial(_flowcontrol)?:///[^:\s]+:\d{4,7}")


def _require_url(text: str) -> str:
    if not _URL.fullmatch(text):
        raise ValueError(f"{text!r} is not a link like udpin://0.0.0.0:14540 or serial:///dev/ttyTHS1:921600")
    return text


Url = Annotated[str, AfterValidator(_require_url)]


class GroundStation(Settings):
    """A ground station by its MAVLink address."""

    system_id: int = Field(default=255, ge=1, le=255)
    """Its system id."""
    component_id: int = Field(default=190, ge=1, le=255)
    """Its component id."""


class Px4Settings(Settings):
    """How the companion and the autopilot find and time each other."""

    url: Url = "udpin://0.0.0.0:14540"
    """Link to the autopilot: udpin, udpout, tcpin or tcpout with host and port, or serial with baud rate."""

    system_id: int = Field(default=1, ge=1, le=250)
    """MAV_SYS_ID of the only autopilot that is listened to and addressed."""

    component_id: int = Field(default=191, ge=2, le=255)
    """Own component id; 191 is an onboard computer."""

    ground_stations: Annotated[tuple[GroundStation, ...], Field(max_length=8, strict=False)] = (
        GroundStation(),
    )
    """Who may grant and revoke control by MAVLink; empty for nobody."""

    setpoint_hz: float = Field(default=50.0, ge=10.0, le=100.0)
    """Rate of velocity setpoints."""

    odometry_hz: float = Field(default=50.0, ge=10.0, le=100.0)
    """Highest rate of external odometry; below 10 Hz the autopilot's filter loses it."""

    timesync_hz: float = Field(default=10.0, ge=2.0, le=20.0)
    """Rate of clock comparisons."""

    max_setpoint_age_ms: float = Field(default=200.0, ge=50.0, le=200.0)
    """A velocity decided, or resting on sensor data, longer ago than this is not sent."""

    max_odometry_age_ms: float = Field(default=200.0, ge=50.0, le=250.0)
    """Odometry older than this is not sent; stamps 300 ms old would end all fusion in the autopilot."""

    min_odometry_quality: int = Field(default=10, ge=1, le=100)
    """Odometry of lower quality is not sent, so that the autopilot falls back at once."""

    angular_rate_noise_rad_s: float = Field(default=0.02, gt=0.0, le=1.0)
    """Standard deviation stated for the angular rates of the external odometry."""
