"""Smooth motion of a vehicle that a real PX4 simulates, for the emulated LiDAR and IMU to follow.

PX4's simulator publishes its state 25 times a second, quantised to a centimetre and a centimetre per
second, on a clock that is a little slow, with jittered arrivals. A Kalman filter with white jerk turns
this into position, velocity and acceleration that can be predicted to the present. A follower then
steers a trajectory towards that prediction with piecewise constant jerk (and angular jerk), so corrections
never jump: position and attitude are twice continuously differentiable, and rate, velocity and
acceleration are exact derivatives of what the LiDAR sees.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from companion.geometry import rotation
from companion.messages import FloatArray
from companion.settings import Settings
from sitl.hil_state import GeographicOrigin, HilState, read_hil_state
from sitl.mavlink_frames import FrameCutter
from sitl.px4_truth_clock import ClockMap
from sitl.vehicle_truth import VehicleTruth

STEP_NS = 5_000_000
_STEP_S = 0.005
_GAP_MAX_US = 1_000_000
_CATCH_UP_STEPS = 400
_POSITION_SIGMA_M = 0.0045
_VELOCITY_SIGMA_M_S = 0.004


class Px4TruthSettings(Settings):
    """How closely the published motion is followed."""

    jerk_density: float = Field(2.0, gt=0.0, le=1.0e4)
    """Spectral density of the assumed jerk, m^2/s^5: higher follows faster and shakes more."""
    follower_rad_s: float = Field(10.0, gt=1.0, le=100.0)
    """Bandwidth with which the trajectory closes in on the prediction."""
    attitude_follower_rad_s: float = Field(30.0, gt=1.0, le=100.0)
    """The same for attitude, whose source is not quantised."""
    prediction_max_s: float = Field(0.25, ge=0.0, le=2.0)
    """Longest time that acceleration and rotation are extrapolated without news."""
    history_s: float = Field(1.0, gt=0.05, le=10.0)
    """How far back states can be asked for."""
    ground_clearance_m: float = Field(0.03, ge=0.0, le=1.0)
    """Height above the place of the first message below which the vehicle counts as standing."""


@dataclass(frozen=True, slots=True, eq=False)
class _Segment:
    """Motion over one step: cubic position, and a rotation vector that is cubic too."""

    t_ns: int
    p: FloatArray
    v: FloatArray
    a: FloatArray
    jerk: FloatArray
    q: FloatArray
    omega: FloatArray
    alpha: FloatArray
    angular_jerk: FloatArray

    def at(self, tau: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return (p, v, a, q, omega, alpha) `tau` seconds into the segment."""
        half = 0.5 * tau * tau
        third = half * tau / 3.0
        theta = self.omega * tau + self.alpha * half + self.angular_jerk * third
        theta_rate = self.omega + self.alpha * tau + self.angular_jerk * half
        across = _cross(theta, theta_rate)
        return (
            self.p + self.v * tau + self.a * half + self.jerk * third,
            self.v + self.a * tau + self.jerk * half,
            self.a + self.jerk * tau,
            rotation.multiply(self.q, rotation.exp(theta)),
            theta_rate - 0.5 * across + _cross(theta, across) / 6.0,
            self.alpha + self.angular_jerk * tau,
        )


class _MotionFilter:
    """Kalman filter of position, velocity and acceleration with the same covariance on all axes."""

    def __init__(self, state: HilState, t_ns: int, jerk_density: float) -> None:
        self.t_ns = t_ns
        self.x = np.stack([state.p_world, state.v_world, np.zeros(3)])
        self.P = np.diag([_POSITION_SIGMA_M**2, _VELOCITY_SIGMA_M_S**2, 1.0])
        self.q_world_body, self.omega_body = state.q_world_body, state.omega_body
        self.alpha_body = np.zeros(3)
        self._density = jerk_density

    def update(self, state: HilState, t_ns: int, rate: float) -> None:
        """Fuse one state that was true at host time `t_ns`; `rate` is simulator time per host time."""
        dt = max((t_ns - self.t_ns) * 1.0e-9, 1.0e-3)
        F = _transition(dt)
        self.x = F @ self.x
        self.P = F @ self.P @ F.T + self._density * _jerk_covariance(dt)
        z = np.stack([state.p_world, state.v_world * rate])
        H = np.eye(2, 3)
        S = H @ self.P @ H.T + np.diag([_POSITION_SIGMA_M**2, _VELOCITY_SIGMA_M_S**2])
        K = np.linalg.solve(S, H @ self.P).T
        self.x = self.x + K @ (z - self.x[:2])
        self.P = self.P - K @ S @ K.T
        omega = state.omega_body * rate
        self.alpha_body = 0.5 * self.alpha_body + 0.5 * (omega - self.omega_body) / dt
        self.q_world_body, self.omega_body = state.q_world_body, omega
        self.t_ns = t_ns

    def predict(self, dt: float, dt_max: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (p, v, a) `dt` seconds later, without acceleration beyond `dt_max`."""
        bounded = min(dt, dt_max)
        p, v, a = _transition(bounded) @ self.x
        if dt > dt_max:
            return p + v * (dt - dt_max), v, np.zeros(3)
        return p, v, a

    def predict_attitude(self, dt: float, dt_max: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (q, omega, alpha) `dt` seconds later, standing still beyond `dt_max`."""
        bounded = min(max(dt, 0.0), dt_max)
        theta = self.omega_body * bounded + self.alpha_body * (0.5 * bounded * bounded)
        q = rotation.multiply(self.q_world_body, rotation.exp(theta))
        if dt > dt_max:
            return q, np.zeros(3), np.zeros(3)
        return q, self.omega_body + self.alpha_body * bounded, self.alpha_body


class Px4Truth:
    """Turns received bytes into a smooth trajectory.

    Attributes:
        messages: states taken.
        rejected: messages with unusable content.
        restarts: times the simulator's clock jumped and everything began anew.
    """

    def __init__(self, settings: Px4TruthSettings, p_start_world: FloatArray | None = None) -> None:
        """Wait for the first message.

        Args:
            settings: how closely to follow.
            p_start_world: (3,) where in the world the vehicle is at the first message, metres.
        """
        self._settings = settings
        self._p_start = np.zeros(3) if p_start_world is None else np.asarray(p_start_world, dtype=np.float64)
        self._cutter = FrameCutter()
        self._origin: GeographicOrigin | None = None
        self._clock: ClockMap | None = None
        self._filter: _MotionFilter | None = None
        self._last_us = 0
        self._t_received_ns = 0
        self._segments: deque[_Segment] = deque(maxlen=max(4, round(settings.history_s / _STEP_S)))
        self.messages = 0
        self.rejected = 0
        self.restarts = 0

    def receive(self, data: bytes, t_ns: int) -> None:
        """Take bytes that arrived at `t_ns`; anything else than the expected message is skipped."""
        for frame in self._cutter.feed(data):
            if frame.message.get_type() != "HIL_STATE_QUATERNION":
                continue
            if self._origin is None:
                self._origin = GeographicOrigin.of(frame.message)
            state = read_hil_state(frame.message, self._origin)
            if state is None:
                self.rejected += 1
                continue
            self.messages += 1
            self._t_received_ns = t_ns
            self._take(state, t_ns)

    def age_ns(self, t_ns: int) -> int | None:
        """Return the time since the newest message, None before the first."""
        return None if self._filter is None else t_ns - self._t_received_ns

    def state_at(self, t_ns: int) -> VehicleTruth | None:
        """Return the motion at `t_ns`, None before the first message.

        Asking for a new time fixes the trajectory up to it; older times return what was fixed.

        Raises:
            ValueError: if `t_ns` lies before the remembered history.
        """
        if self._filter is None:
            return None
        self._advance(t_ns)
        if t_ns < self._segments[0].t_ns:
            raise ValueError(f"no trajectory before {self._segments[0].t_ns} ns, asked for {t_ns} ns")
        index = min((t_ns - self._segments[0].t_ns) // STEP_NS, len(self._segments) - 1)
        segment = self._segments[index]
        p, v, a, q, omega, _ = segment.at((t_ns - segment.t_ns) * 1.0e-9)
        return VehicleTruth(
            t_ns=t_ns,
            p_world=p,
            v_world=v,
            q_world_body=rotation.normalize(q),
            omega_body=omega,
            accel_world=a,
            on_ground=bool(p[2] - self._p_start[2] < self._settings.ground_clearance_m),
        )

    def _take(self, state: HilState, t_ns: int) -> None:
        moved = HilState(
            state.boot_us, state.p_world + self._p_start, state.v_world, state.q_world_body, state.omega_body
        )
        gap_us = state.boot_us - self._last_us
        self._last_us = state.boot_us
        if self._clock is None or self._filter is None or not 0 < gap_us < _GAP_MAX_US:
            if gap_us == 0:
                return
            self.restarts += int(self._filter is not None)
            self._clock = ClockMap(state.boot_us, t_ns)
            self._filter = _MotionFilter(moved, t_ns, self._settings.jerk_density)
            if not self._segments:
                self._start(moved, t_ns)
            return
        t_true_ns = self._clock.update(state.boot_us, t_ns)
        self._filter.update(moved, max(t_true_ns, self._filter.t_ns + 1_000_000), self._clock.rate)

    def _start(self, state: HilState, t_ns: int) -> None:
        zero = np.zeros(3)
        self._segments.append(
            _Segment(
                t_ns,
                state.p_world,
                state.v_world,
                zero,
                zero,
                state.q_world_body,
                state.omega_body,
                zero,
                zero,
            )
        )

    def _advance(self, t_ns: int) -> None:
        """Add segments until one covers `t_ns`; after a long pause begin anew at the prediction."""
        last = self._segments[-1]
        if t_ns - last.t_ns > _CATCH_UP_STEPS * STEP_NS:
            self._segments.clear()
            self._segments.append(self._target_segment(t_ns))
            return
        while t_ns >= last.t_ns + STEP_NS:
            last = self._next(last)
            self._segments.append(last)

    def _target_segment(self, t_ns: int) -> _Segment:
        p, v, a, q, omega, alpha = self._targets(t_ns)
        zero = np.zeros(3)
        return _Segment(t_ns, p, v, a, zero, q, omega, alpha, zero)

    def _targets(
        self, t_ns: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        assert self._filter is not None
        dt = (t_ns - self._filter.t_ns) * 1.0e-9
        dt_max = self._settings.prediction_max_s
        return (*self._filter.predict(dt, dt_max), *self._filter.predict_attitude(dt, dt_max))

    def _next(self, last: _Segment) -> _Segment:
        """Return the segment after `last`, steered towards the prediction at its start."""
        p, v, a, q, omega, alpha = last.at(_STEP_S)
        q = rotation.normalize(q)
        t_ns = last.t_ns + STEP_NS
        p_t, v_t, a_t, q_t, omega_t, alpha_t = self._targets(t_ns)
        w = self._settings.follower_rad_s
        jerk = w**3 * (p_t - p) + 3.0 * w**2 * (v_t - v) + 3.0 * w * (a_t - a)
        w = self._settings.attitude_follower_rad_s
        turn = rotation.log(rotation.multiply(rotation.conjugate(q), q_t))
        angular_jerk = w**3 * turn + 3.0 * w**2 * (omega_t - omega) + 3.0 * w * (alpha_t - alpha)
        return _Segment(t_ns, p, v, a, jerk, q, omega, alpha, angular_jerk)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross product of two vectors (3,), an order of magnitude faster than NumPy's."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _transition(dt: float) -> FloatArray:
    return np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])


def _jerk_covariance(dt: float) -> FloatArray:
    """Return the covariance that white jerk of unit density adds over `dt` seconds."""
    return np.array(
        [
            [dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0],
            [dt**4 / 8.0, dt**3 / 3.0, dt**2 / 2.0],
            [dt**3 / 6.0, dt**2 / 2.0, dt],
        ]
    )
