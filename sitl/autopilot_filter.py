"""Small pieces of the emulated estimator: scalar Kalman filters, aiding bookkeeping, state history."""

import math
from bisect import bisect_right
from collections import deque
from typing import NamedTuple

from companion.clock import NANOSECONDS_PER_SECOND
from sitl.autopilot_inputs import Quaternion, Vector

START_INTERVAL_NS = 200_000_000
STOP_INTERVAL_NS = 400_000_000
_SAMPLES_TO_START = 3
_REJECTION_RESET_NS = 1_500_000_000


class AxisCovariance:
    """Covariance of one position and its velocity, driven by white acceleration noise."""

    __slots__ = ("_noise", "mixed", "position", "velocity")

    def __init__(self, noise: float) -> None:
        """Start wide; `noise` is the acceleration's noise density, m^2/s^3."""
        self._noise = noise
        self.reset(0.01, 0.01)

    def reset(self, position: float, velocity: float) -> None:
        """Set the variances in m^2 and m^2/s^2 without correlation."""
        self.position = position
        self.velocity = velocity
        self.mixed = 0.0

    def predict(self, dt: float) -> None:
        """Grow over `dt` seconds."""
        self.position += dt * (2.0 * self.mixed + dt * self.velocity) + self._noise * dt * dt * dt / 3.0
        self.mixed += dt * self.velocity + 0.5 * self._noise * dt * dt
        self.velocity += self._noise * dt

    def update_position(self, variance: float) -> tuple[float, float]:
        """Fuse a position of the given variance; return the gains of position and velocity."""
        total = self.position + variance
        gain_position, gain_velocity = self.position / total, self.mixed / total
        self.velocity -= gain_velocity * self.mixed
        self.mixed -= gain_position * self.mixed
        self.position -= gain_position * self.position
        return gain_position, gain_velocity

    def update_velocity(self, variance: float) -> tuple[float, float]:
        """Fuse a velocity of the given variance; return the gains of position and velocity."""
        total = self.velocity + variance
        gain_position, gain_velocity = self.mixed / total, self.velocity / total
        self.position -= gain_position * self.mixed
        self.mixed -= gain_velocity * self.mixed
        self.velocity -= gain_velocity * self.velocity
        return gain_position, gain_velocity


class Aid:
    """One source of aiding: it starts on steady data, stops on a gap and gives in after long rejection."""

    __slots__ = ("_steady", "_t_last_ns", "_t_rejected_ns", "active", "t_fused_ns")

    def __init__(self) -> None:
        self.active = False
        self.t_fused_ns: int | None = None
        self._t_last_ns: int | None = None
        self._steady = 0
        self._t_rejected_ns: int | None = None

    def offer(self, t_ns: int) -> bool:
        """Note usable data; return whether fusion starts with it (the state is to be reset to it)."""
        interval_ns = None if self._t_last_ns is None else t_ns - self._t_last_ns
        self._t_last_ns = t_ns
        if interval_ns is not None and interval_ns < START_INTERVAL_NS:
            self._steady += 1
        else:
            self._steady = 1
        if self.active or self._steady < _SAMPLES_TO_START:
            return False
        self.active = True
        self._t_rejected_ns = None
        return True

    def judge(self, t_ns: int, passes: bool) -> bool:
        """Note the innovation test of active aiding; return whether to reset to the data instead."""
        if passes:
            self.t_fused_ns = t_ns
            self._t_rejected_ns = None
            return False
        if self._t_rejected_ns is None:
            self._t_rejected_ns = t_ns
        if t_ns - self._t_rejected_ns < _REJECTION_RESET_NS:
            return False
        self._t_rejected_ns = None
        return True

    def fused(self, t_ns: int) -> None:
        """Note that the state was set to the data."""
        self.t_fused_ns = t_ns
        self._t_rejected_ns = None

    def stop_if_silent(self, t_ns: int) -> bool:
        """Return whether fusion stops now, because usable data has not come for too long."""
        if not self.active or self._t_last_ns is None or t_ns - self._t_last_ns <= STOP_INTERVAL_NS:
            return False
        self.active = False
        self._steady = 0
        return True

    def fresh(self, t_ns: int, within_ns: int = STOP_INTERVAL_NS) -> bool:
        """Return whether data was fused within the given time."""
        return self.t_fused_ns is not None and t_ns - self.t_fused_ns <= within_ns


class PastState(NamedTuple):
    """Prediction at a past instant, without any correction, and the true attitude then."""

    t_ns: int
    p: Vector
    v: Vector
    turn: float
    q_world_body: Quaternion


class StateHistory:
    """The last third of a second of predictions, to compare late measurements with their own time."""

    def __init__(self, length: int = 96) -> None:
        self._states: deque[PastState] = deque(maxlen=length)

    def append(self, state: PastState) -> None:
        """Remember the newest prediction."""
        self._states.append(state)

    def at(self, t_ns: int) -> PastState | None:
        """Return the state at or just before `t_ns`, else the oldest; None if empty."""
        if not self._states:
            return None
        index = bisect_right(self._states, t_ns, key=lambda state: state.t_ns)
        return self._states[max(0, index - 1)]


def wrap_angle(angle: float) -> float:
    """Return an angle in radians within -pi to pi."""
    return math.remainder(angle, 2.0 * math.pi)


def rotate_by(q: Quaternion, v: Vector) -> Vector:
    """Return a vector's coordinates after rotation by a unit quaternion."""
    w, x, y, z = q
    tx = 2.0 * (y * v[2] - z * v[1])
    ty = 2.0 * (z * v[0] - x * v[2])
    tz = 2.0 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )


def turn_about_z(angle: float, v: Vector) -> Vector:
    """Return a vector turned counter-clockwise about z."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return (cosine * v[0] - sine * v[1], sine * v[0] + cosine * v[1], v[2])


def yaw_of(q: Quaternion) -> float:
    """Return the heading of a z-up attitude in radians."""
    w, x, y, z = q
    return math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))


def seconds_between(start_ns: int, end_ns: int) -> float:
    """Return a span of nanoseconds in seconds."""
    return (end_ns - start_ns) / NANOSECONDS_PER_SECOND
