"""HIL_STATE_QUATERNION: how a PX4 simulator publishes the true motion, and how to read it.

Positions come in 1e-7 degrees and millimetres, velocities in cm/s, attitude and rates as floats.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field

from companion.geometry import frames, rotation
from companion.messages import FloatArray
from companion.settings import Settings
from sitl.mavlink_frames import FrameEncoder
from sitl.vehicle_truth import VehicleTruth

EARTH_RADIUS_M = 6_371_000.0
_GRAVITY = 9.81
_METRES_PER_UNIT = math.radians(1.0e-7) * EARTH_RADIUS_M
_INT16_MAX = 32_767


@dataclass(frozen=True, slots=True, eq=False)
class HilState:
    """One published state.

    Attributes:
        boot_us: simulator time.
        p_world: (3,) east, north, up of a reference point, metres.
        v_world: (3,) m/s in simulator time.
        q_world_body: (4,) attitude of the forward-left-up body.
        omega_body: (3,) rad/s in simulator time.
    """

    boot_us: int
    p_world: FloatArray
    v_world: FloatArray
    q_world_body: FloatArray
    omega_body: FloatArray


@dataclass(frozen=True, slots=True)
class GeographicOrigin:
    """Where the world's origin lies: 1e-7 degrees and millimetres."""

    latitude: int
    longitude: int
    altitude_mm: int

    @classmethod
    def of(cls, message: Any) -> "GeographicOrigin":
        """Return the place of a HIL_STATE_QUATERNION message."""
        return cls(message.lat, message.lon, message.alt)

    @property
    def metres_per_longitude(self) -> float:
        """East metres per 1e-7 degree of longitude."""
        return _METRES_PER_UNIT * math.cos(math.radians(1.0e-7 * self.latitude))


def read_hil_state(message: Any, origin: GeographicOrigin) -> HilState | None:
    """Return the motion in a decoded message, None if it is not finite or has no attitude."""
    q_ned = np.array(message.attitude_quaternion, dtype=np.float64)
    omega = np.array([message.rollspeed, message.pitchspeed, message.yawspeed], dtype=np.float64)
    norm = float(np.sqrt(q_ned @ q_ned))
    if not (0.5 < norm < 2.0 and bool(np.all(np.abs(omega) < 1.0e3))):
        return None
    east = (message.lon - origin.longitude) * origin.metres_per_longitude
    north = (message.lat - origin.latitude) * _METRES_PER_UNIT
    up = 1.0e-3 * (message.alt - origin.altitude_mm)
    return HilState(
        boot_us=message.time_usec,
        p_world=np.array([east, north, up]),
        v_world=frames.enu_from_ned(np.array([message.vx, message.vy, message.vz]) * 0.01),
        q_world_body=frames.q_enu_flu_from_ned_frd(q_ned),
        omega_body=frames.flu_from_frd(omega),
    )


class HilStateSettings(Settings):
    """Publisher of the true motion."""

    rate_hz: float = Field(25.0, gt=0.0, le=250.0)
    """Messages per second of simulator time."""
    clock_slow: float = Field(0.0, ge=-0.1, le=0.1)
    """Share by which simulator time runs slow (0.007 for PX4's own simulator)."""
    latitude_deg: float = Field(47.3977432, ge=-85.0, le=85.0)
    """Latitude of the world's origin."""
    longitude_deg: float = Field(8.5455939, ge=-180.0, le=180.0)
    """Longitude of the world's origin."""
    altitude_m: float = Field(489.4, ge=-500.0, le=9000.0)
    """Altitude of the world's origin."""


class HilStatePublisher:
    """Publishes a vehicle's truth as PX4's simulator does."""

    def __init__(self, settings: HilStateSettings, system_id: int = 1, boot_ns: int = 0) -> None:
        """Start at `boot_ns` of the simulation's clock, sending as component 1 of `system_id`."""
        self._settings = settings
        self._system_id = system_id
        self._boot_ns = boot_ns
        self._encoder = FrameEncoder("HIL_STATE_QUATERNION")
        self._period_us = round(1.0e6 / settings.rate_hz)
        self._next_us = 0
        self._sequence = 0

    def poll(self, t_ns: int, truth: VehicleTruth) -> bytes | None:
        """Return one frame if it is due at `t_ns`, None otherwise."""
        boot_us = int((t_ns - self._boot_ns) * (1.0 - self._settings.clock_slow)) // 1000
        if boot_us < self._next_us:
            return None
        self._next_us = max(self._next_us, boot_us - self._period_us) + self._period_us
        frame = self._encoder.frame(self._sequence, self._system_id, 1, self._fields(boot_us, truth))
        self._sequence = (self._sequence + 1) & 0xFF
        return frame

    def _fields(self, boot_us: int, truth: VehicleTruth) -> tuple[Any, ...]:
        settings = self._settings
        rate = 1.0 / (1.0 - settings.clock_slow)
        origin = GeographicOrigin(
            round(1.0e7 * settings.latitude_deg),
            round(1.0e7 * settings.longitude_deg),
            round(1.0e3 * settings.altitude_m),
        )
        east, north, up = truth.p_world.tolist()
        q_ned = frames.q_ned_frd_from_enu_flu(truth.q_world_body).tolist()
        v_ned = frames.ned_from_enu(truth.v_world * rate).tolist()
        omega = frames.frd_from_flu(truth.omega_body * rate).tolist()
        force_world = truth.accel_world + np.array([0.0, 0.0, _GRAVITY])
        force_body = rotation.rotate(rotation.conjugate(truth.q_world_body), force_world)
        accel = (frames.frd_from_flu(force_body) / _GRAVITY).tolist()
        return (
            boot_us,
            q_ned,
            *omega,
            origin.latitude + round(north / _METRES_PER_UNIT),
            origin.longitude + round(east / origin.metres_per_longitude),
            origin.altitude_mm + round(1.0e3 * up),
            *(_int16(100.0 * v) for v in v_ned),
            0,
            0,
            *(_int16(1000.0 * a) for a in accel),
        )


def _int16(value: float) -> int:
    return max(-_INT16_MAX, min(_INT16_MAX, round(value)))
