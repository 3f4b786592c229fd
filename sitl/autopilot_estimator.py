"""The emulated autopilot's estimator: noisy inertial propagation aided by external vision or GNSS.

It never copies the true position: the horizontal estimate integrates the true acceleration, seen through
an imperfect heading, and is corrected only by what external vision or simulated GNSS says. Roll and pitch
are taken from the truth, since gravity makes them observable; heading is the true one plus an error that
the gyroscope, the magnetometer or external vision determine.
"""

import math

import numpy as np
from pydantic import Field

from companion.settings import Settings
from sitl.autopilot_filter import Aid, seconds_between, turn_about_z, wrap_angle, yaw_of
from sitl.autopilot_inputs import ExternalVision, Quaternion, Vector
from sitl.autopilot_motion import MotionState
from sitl.autopilot_parameters import Parameters
from sitl.autopilot_vision import VisionFusion
from sitl.vehicle_truth import VehicleTruth

NORTH_TURN = -0.5 * math.pi
"""Turn of a local frame whose x axis points north, in a world whose y axis does."""
_GNSS_INTERVAL_NS = 125_000_000
_GNSS_VARIANCE_M2 = 0.05
_GNSS_VELOCITY_VARIANCE_M2_S2 = 0.02
_MAGNETOMETER_TIME_S = 5.0
_MAGNETIC_VARIANCE_RAD2 = 0.034
_BAROMETER_TIME_S = 1.0
_BAROMETER_DENSITY_M2_S = 9.0e-4
_COASTING_BUILD_UP_S = 0.15
_NOISE_BLOCK = 256


class EstimatorSettings(Settings):
    """Imperfections of the emulated inertial sensors and estimator."""

    acceleration_noise_m_s2: float = Field(0.25, ge=0.0, le=5.0)
    """White noise on each propagated acceleration (200 Hz)."""
    gyro_drift_rad_s: float = Field(2.0e-4, ge=0.0, le=0.1)
    """Standard deviation of the constant heading drift, drawn once."""
    magnetometer_error_rad: float = Field(0.1, ge=0.0, le=1.0)
    """Standard deviation of the magnetic heading's constant error, drawn once."""
    barometer_noise_m: float = Field(0.03, ge=0.0, le=2.0)
    """White noise of each barometric height."""
    gnss_noise_m: float = Field(0.05, ge=0.0, le=10.0)
    """White noise of each simulated GNSS position, and of its velocity in m/s."""
    gnss_start_s: float = Field(3.0, ge=0.0, le=120.0)
    """Time from the first step to the first GNSS fix."""
    coasting_acceleration_m_s2: float = Field(0.175, ge=0.0, le=5.0)
    """Error of the propagated acceleration while nothing aids it (a tilt error of about 1 deg)."""
    coasting_velocity_m_s: float = Field(0.45, ge=0.0, le=5.0)
    """Velocity error that builds up within half a second after aiding ends."""
    process_noise_m2_s3: float = Field(1.5e-3, gt=0.0, le=1.0)
    """Acceleration noise density that the covariance assumes."""
    coasting_variance_m2_s4: float = Field(1.2e-3, ge=0.0, le=1.0)
    """Acceleration variance that the covariance assumes while nothing aids it."""


class Estimator:
    """Own motion as the autopilot believes it.

    Attributes:
        motion: the state.
        vision: the four aids from external vision.
        t_ns: time of the state.
    """

    def __init__(self, settings: EstimatorSettings, parameters: Parameters, rng: np.random.Generator) -> None:
        """Start with no aiding at the local origin.

        Args:
            settings: imperfections.
            parameters: the autopilot's parameters, read anew at every use.
            rng: source of all noise.
        """
        self._settings = settings
        self._parameters = parameters
        self._rng = rng
        self._gyro_drift = settings.gyro_drift_rad_s * float(rng.standard_normal())
        self._magnetic_turn = NORTH_TURN + settings.magnetometer_error_rad * float(rng.standard_normal())
        direction = float(rng.uniform(-math.pi, math.pi))
        self.coasting_direction_local = (math.cos(direction), math.sin(direction))
        self.motion = MotionState(self._magnetic_turn, settings.process_noise_m2_s3)
        self.vision = VisionFusion(self.motion, parameters)
        self.gnss = Aid()
        self.t_ns = 0
        self._t_start_ns: int | None = None
        self._v_world: Vector = (0.0, 0.0, 0.0)
        self._q_world_body: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self._gnss_origin: Vector | None = None
        self._t_gnss_ns = 0
        self._barometer_offset: float | None = None
        self._height_was_vision = False
        self._t_last_aid_ns: int | None = None
        self._t_coasting_ns: int | None = None
        self._noise: list[float] = []

    @property
    def p_local(self) -> Vector:
        """Believed position in the z-up local frame, metres."""
        return self.motion.p_local

    @property
    def v_local(self) -> Vector:
        """Believed velocity in the z-up local frame, m/s."""
        return self.motion.v_local

    @property
    def q_local_body(self) -> Quaternion:
        """Believed attitude of the forward-left-up body in the local frame."""
        w, x, y, z = self._q_world_body
        c, s = math.cos(0.5 * self.motion.turn), math.sin(0.5 * self.motion.turn)
        return (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)

    @property
    def yaw(self) -> float:
        """Believed heading in the local frame, radians counter-clockwise."""
        return wrap_angle(yaw_of(self._q_world_body) + self.motion.turn)

    @property
    def aided(self) -> bool:
        """Whether something corrects the horizontal motion now."""
        return self.vision.position.active or self.vision.velocity.active or self.gnss.active

    @property
    def velocity_valid(self) -> bool:
        """Whether the horizontal velocity is trusted: aided, or coasting for less than EKF2_NOAID_TOUT."""
        if self._t_last_aid_ns is None:
            return False
        return self.t_ns - self._t_last_aid_ns <= int(self._parameters["EKF2_NOAID_TOUT"]) * 1000

    @property
    def position_valid(self) -> bool:
        """Whether the local horizontal position is trusted."""
        return self.velocity_valid

    @property
    def height_valid(self) -> bool:
        """Whether height is known; the barometer provides it from the first step on."""
        return self._barometer_offset is not None

    @property
    def global_valid(self) -> bool:
        """Whether a geographic position is known."""
        return self.gnss.active

    @property
    def position_variance(self) -> float:
        """Horizontal position variance in m^2, with its growth while coasting."""
        growth = 0.25 * self._settings.coasting_variance_m2_s4 * self.coasting_s**4
        return self.motion.horizontal.position + growth

    @property
    def velocity_variance(self) -> float:
        """Horizontal velocity variance in m^2/s^2, with its growth while coasting."""
        growth = self._settings.coasting_variance_m2_s4 * self.coasting_s**2
        return self.motion.horizontal.velocity + growth

    @property
    def coasting_s(self) -> float:
        """Seconds since the last aiding, 0 while aided or before the first."""
        if self.aided or self._t_last_aid_ns is None:
            return 0.0
        return seconds_between(self._t_last_aid_ns, self.t_ns)

    def step(self, truth: VehicleTruth, landed: bool) -> None:
        """Propagate to the truth's time, stop silent aids and fuse barometer, magnetometer and GNSS.

        Args:
            truth: true motion; used for inertial increments and as what the sensors measure.
            landed: the land detector's verdict, which lets an unaided estimate stand still.
        """
        t_ns = truth.t_ns
        v_x, v_y, v_z = truth.v_world.tolist()
        w, x, y, z = truth.q_world_body.tolist()
        self._q_world_body = (w, x, y, z)
        if self._t_start_ns is None:
            self._t_start_ns, self.t_ns, self._v_world = t_ns, t_ns, (v_x, v_y, v_z)
        dt = seconds_between(self.t_ns, t_ns)
        self.t_ns = t_ns
        increment = (v_x - self._v_world[0], v_y - self._v_world[1], v_z - self._v_world[2])
        self._v_world = (v_x, v_y, v_z)
        self._propagate(increment, dt, landed)
        if self.vision.stop_silent(t_ns) and self._has_magnetometer():
            self.motion.set_turn(self._magnetic_turn, 0.05)
            self.motion.reset_counter += 2
        self._fuse_barometer(float(truth.p_world[2]), dt)
        self._fuse_magnetometer(dt)
        self._fuse_gnss(truth)
        self.motion.remember(t_ns, self._q_world_body)

    def fuse_vision(self, sample: ExternalVision) -> None:
        """Fuse one external vision sample that arrives now; see `VisionFusion.fuse`."""
        self.vision.fuse(self.t_ns, sample, self.gnss.active)
        for aid in (self.vision.position, self.vision.velocity):
            if aid.t_fused_ns == self.t_ns:
                self._t_last_aid_ns = self.t_ns

    def _normal(self) -> float:
        if not self._noise:
            self._noise = self._rng.standard_normal(_NOISE_BLOCK).tolist()
        return self._noise.pop()

    def _propagate(self, increment: Vector, dt: float, landed: bool) -> None:
        motion = self.motion
        scale = self._settings.acceleration_noise_m_s2 * dt
        d_x, d_y, d_z = turn_about_z(motion.turn, increment)
        if self.aided:
            self._t_coasting_ns = None
        else:
            error = self._coasting_error(dt)
            d_x += error * self.coasting_direction_local[0]
            d_y += error * self.coasting_direction_local[1]
        before, p, half = motion.v_local, motion.p_local, 0.5 * dt
        v = (
            before[0] + d_x + scale * self._normal(),
            before[1] + d_y + scale * self._normal(),
            before[2] + d_z + scale * self._normal(),
        )
        if self._t_last_aid_ns is None or (landed and not self.aided):
            v = (0.0, 0.0, v[2])
        motion.p_local = (
            p[0] + half * (v[0] + before[0]),
            p[1] + half * (v[1] + before[1]),
            p[2] + half * (v[2] + before[2]),
        )
        motion.v_local = v
        motion.turn = wrap_angle(motion.turn + self._gyro_drift * dt)
        motion.horizontal.predict(dt)
        motion.vertical.predict(dt)

    def _coasting_error(self, dt: float) -> float:
        """Velocity error gained in this step: a constant tilt's pull plus a short initial kick."""
        if self._t_coasting_ns is None:
            self._t_coasting_ns = self.t_ns
        since_s = seconds_between(self._t_coasting_ns, self.t_ns)
        kick = self._settings.coasting_velocity_m_s / _COASTING_BUILD_UP_S
        decay = math.exp(-since_s / _COASTING_BUILD_UP_S)
        return (self._settings.coasting_acceleration_m_s2 + kick * decay) * dt

    def _has_magnetometer(self) -> bool:
        return int(self._parameters["EKF2_MAG_TYPE"]) != 5 and int(self._parameters["SYS_HAS_MAG"]) != 0

    def _gnss_enabled(self) -> bool:
        return int(self._parameters["EKF2_GPS_CTRL"]) != 0 and int(self._parameters["SYS_HAS_GPS"]) != 0

    def _fuse_barometer(self, z_world: float, dt: float) -> None:
        height_is_vision = self.vision.height.active
        if self._barometer_offset is None or (height_is_vision and not self._height_was_vision):
            self._barometer_offset = self.motion.p_local[2] - z_world
        self._height_was_vision = height_is_vision
        height = z_world + self._barometer_offset
        if height_is_vision:
            self._barometer_offset += dt / _BAROMETER_TIME_S * (self.motion.p_local[2] - height)
            return
        noise = self._settings.barometer_noise_m * self._normal()
        innovation = height + noise - self.motion.p_local[2]
        gain_p, gain_v = self.motion.vertical.update_position(_BAROMETER_DENSITY_M2_S / max(dt, 1.0e-3))
        self.motion.correct_axis(2, gain_p * innovation, gain_v * innovation)

    def _fuse_magnetometer(self, dt: float) -> None:
        motion = self.motion
        if self.vision.yaw.active:
            motion.yaw_variance = max(3.5e-5, motion.yaw_variance * (1.0 - 2.0 * dt))
        elif self._has_magnetometer():
            motion.correct_turn(dt / _MAGNETOMETER_TIME_S * wrap_angle(self._magnetic_turn - motion.turn))
            motion.yaw_variance += (_MAGNETIC_VARIANCE_RAD2 - motion.yaw_variance) * dt
        else:
            motion.yaw_variance += 1.0e-4 * dt

    def _fuse_gnss(self, truth: VehicleTruth) -> None:
        if not self._gnss_enabled():
            self.gnss.active = False
            return
        start_ns = self._t_start_ns if self._t_start_ns is not None else truth.t_ns
        if seconds_between(start_ns, truth.t_ns) < self._settings.gnss_start_s:
            return
        if truth.t_ns - self._t_gnss_ns < _GNSS_INTERVAL_NS:
            return
        self._t_gnss_ns = truth.t_ns
        w_x, w_y, w_z = truth.p_world.tolist()
        if self._gnss_origin is None:
            self._gnss_origin = (w_x, w_y, w_z)
        p = turn_about_z(NORTH_TURN, (w_x - self._gnss_origin[0], w_y - self._gnss_origin[1], 0.0))
        v = turn_about_z(NORTH_TURN, self._v_world)
        self.gnss.active = True
        self.gnss.fused(truth.t_ns)
        self._t_last_aid_ns = truth.t_ns
        motion, noise = self.motion, self._settings.gnss_noise_m
        gain_pp, gain_pv = motion.horizontal.update_position(_GNSS_VARIANCE_M2)
        gain_vp, gain_vv = motion.horizontal.update_velocity(_GNSS_VELOCITY_VARIANCE_M2_S2)
        for axis in range(2):
            d_p = p[axis] + noise * self._normal() - motion.p_local[axis]
            motion.correct_axis(axis, gain_pp * d_p, gain_pv * d_p)
            d_v = v[axis] + noise * self._normal() - motion.v_local[axis]
            motion.correct_axis(axis, gain_vp * d_v, gain_vv * d_v)
