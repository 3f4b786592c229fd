"""The one place that knows filterpy: a Kalman filter of one body's motion, told of the past."""

import math
from functools import lru_cache

import numpy as np
from filterpy.kalman import KalmanFilter

from companion.messages import FloatArray

_P, _V, _A = slice(0, 3), slice(3, 6), slice(6, 9)


class MotionFilter:
    """Position, velocity, and an acceleration that fades: constant velocity but for manoeuvres.

    A vehicle accelerates for a while, not afresh every instant, so its acceleration is a state of its own:
    noise with a standard deviation and a time constant. A time constant of zero leaves plain constant
    velocity with white acceleration.
    Source: R. Singer, "Estimating optimal tracking filter performance for manned maneuvering targets",
    1970.
    """

    def __init__(
        self,
        p_map: FloatArray,
        covariance_p: FloatArray,
        speed_sigma: float,
        acceleration_sigma: tuple[float, float],
        fading_s: float,
        v_map: FloatArray | None = None,
    ) -> None:
        """Start where a body was seen.

        Args:
            p_map: (3,) m.
            covariance_p: (3, 3) m^2.
            speed_sigma: standard deviation of each axis of the velocity, m/s.
            acceleration_sigma: the same of the acceleration, level and upwards, m/s^2.
            fading_s: its time constant.
            v_map: (3,) expected velocity, m/s; zero by default.
        """
        self._acceleration_sigma, self._fading_s = acceleration_sigma, fading_s
        self._filter = KalmanFilter(dim_x=9, dim_z=3)
        self._filter.x = np.concatenate([p_map, np.zeros(3) if v_map is None else v_map, np.zeros(3)])
        level, upwards = acceleration_sigma if fading_s > 0.0 else (0.0, 0.0)
        self._filter.P = np.diag([0.0] * 3 + [speed_sigma**2] * 3 + [level**2, level**2, upwards**2])
        self._filter.P[_P, _P] = covariance_p

    @property
    def p_map(self) -> FloatArray:
        """Position (3,), m."""
        return np.asarray(self._filter.x[_P])

    @property
    def v_map(self) -> FloatArray:
        """Velocity (3,), m/s."""
        return np.asarray(self._filter.x[_V])

    @property
    def covariance(self) -> FloatArray:
        """Covariance (6, 6) of position, then velocity."""
        return np.asarray(self._filter.P[:6, :6])

    def predict(self, dt_s: float, white_density: float) -> None:
        """Carry the state on.

        Args:
            dt_s: seconds.
            white_density: of the acceleration that is white, m^2/s^3.
        """
        F, Q = _transition(dt_s, self._acceleration_sigma, self._fading_s, white_density)
        self._filter.predict(F=F, Q=Q)

    def fade(self, dt_s: float, fading_s: float, speed_sigma: float, v_map: FloatArray) -> None:
        """Let what is known of the velocity fade for `dt_s`, towards another one give or take a speed.

        Args:
            dt_s: seconds.
            fading_s: time constant.
            speed_sigma: standard deviation of each axis that it tends to, m/s.
            v_map: (3,) the velocity that it tends to, m/s.
        """
        left = math.exp(-dt_s / fading_s)
        keep = np.repeat([1.0, left, left], 3)
        self._filter.x = keep * self._filter.x
        self._filter.x[_V] += (1.0 - left) * v_map
        self._filter.P = keep[:, None] * self._filter.P * keep
        self._filter.P[range(3, 6), range(3, 6)] += (1.0 - left**2) * speed_sigma**2

    def update(self, z_map: FloatArray, R: FloatArray, age_s: float) -> None:
        """Take a position measured `age_s` seconds ago.

        Args:
            z_map: (3,) m.
            R: (3, 3) m^2.
            age_s: seconds.
        """
        self._filter.update(z_map, R=R, H=_observation(age_s))
        self._filter.P = 0.5 * (self._filter.P + self._filter.P.T)


@lru_cache(maxsize=128)
def _transition(
    dt_s: float, acceleration_sigma: tuple[float, float], fading_s: float, white_density: float
) -> tuple[FloatArray, FloatArray]:
    """Return transition and noise (9, 9) each.

    Source: Y. Bar-Shalom et al., "Estimation with Applications to Tracking and Navigation", 2001,
    sections 6.2.2 and 8.2.3; the noise of the fading acceleration is integrated by Simpson's rule.
    """
    axes = np.arange(3)
    F, Q = _drift(dt_s, fading_s), np.zeros((9, 9))
    Q[axes, axes] = white_density * dt_s**3 / 3.0
    Q[axes, axes + 3] = Q[axes + 3, axes] = white_density * dt_s**2 / 2.0
    Q[axes + 3, axes + 3] = white_density * dt_s
    if fading_s > 0.0:
        level, upwards = acceleration_sigma
        density = 2.0 / fading_s * np.diag([level**2, level**2, upwards**2])
        for share, weight in ((0.0, 1.0), (0.25, 4.0), (0.5, 2.0), (0.75, 4.0), (1.0, 1.0)):
            push = _drift(share * dt_s, fading_s)[:, _A]
            Q += dt_s * weight / 12.0 * push @ density @ push.T
    return F, Q


def _drift(dt_s: float, fading_s: float) -> FloatArray:
    """Return the transition (9, 9) over `dt_s`."""
    axes = np.arange(3)
    F = np.eye(9)
    F[axes, axes + 3] = dt_s
    if fading_s <= 0.0:
        F[axes + 6, axes + 6] = 0.0
        return F
    left = math.exp(-dt_s / fading_s)
    F[axes, axes + 6] = fading_s * (dt_s - fading_s * (1.0 - left))
    F[axes + 3, axes + 6] = fading_s * (1.0 - left)
    F[axes + 6, axes + 6] = left
    return F


def _observation(age_s: float) -> FloatArray:
    """Return the matrix that turns the state now into the position `age_s` seconds ago."""
    H = np.zeros((3, 9))
    H[:, _P] = np.eye(3)
    H[:, _V] = -age_s * np.eye(3)
    H[:, _A] = 0.5 * age_s**2 * np.eye(3)
    return H
