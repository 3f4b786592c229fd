"""The one place that knows filterpy: a Kalman filter of even motion, told of measurements in the past."""

import numpy as np
from filterpy.kalman import KalmanFilter

from companion.messages import FloatArray


class MotionFilter:
    """Position and velocity of one body; accelerations are noise."""

    def __init__(self, p_map: FloatArray, covariance_p: FloatArray, speed_sigma: float) -> None:
        """Start where a body was seen, with any velocity.

        Args:
            p_map: (3,) m.
            covariance_p: (3, 3) m^2.
            speed_sigma: standard deviation of each axis of the velocity, m/s.
        """
        self._filter = KalmanFilter(dim_x=6, dim_z=3)
        self._filter.x = np.concatenate([p_map, np.zeros(3)])
        self._filter.P = np.diag([0.0] * 3 + [speed_sigma**2] * 3)
        self._filter.P[:3, :3] = covariance_p

    @property
    def p_map(self) -> FloatArray:
        """Position (3,), m."""
        return np.asarray(self._filter.x[:3])

    @property
    def v_map(self) -> FloatArray:
        """Velocity (3,), m/s."""
        return np.asarray(self._filter.x[3:])

    @property
    def covariance(self) -> FloatArray:
        """Covariance (6, 6) of position, then velocity."""
        return np.asarray(self._filter.P)

    def predict(self, dt_s: float, density: float) -> None:
        """Carry the state on.

        Source: Y. Bar-Shalom et al., "Estimation with Applications to Tracking and Navigation", 2001,
        section 6.2.2.

        Args:
            dt_s: seconds.
            density: of the white acceleration, m^2/s^3.
        """
        F, Q = np.eye(6), np.zeros((6, 6))
        axes = np.arange(3)
        F[axes, axes + 3] = dt_s
        Q[axes, axes] = density * dt_s**3 / 3.0
        Q[axes, axes + 3] = Q[axes + 3, axes] = density * dt_s**2 / 2.0
        Q[axes + 3, axes + 3] = density * dt_s
        self._filter.predict(F=F, Q=Q)

    def innovation(self, z_map: FloatArray, R: FloatArray, age_s: float) -> tuple[FloatArray, FloatArray]:
        """Return by how much a measurement differs (3,), and the covariance of that (3, 3)."""
        H = _observation(age_s)
        return z_map - H @ self._filter.x, H @ self._filter.P @ H.T + R

    def update(self, z_map: FloatArray, R: FloatArray, age_s: float) -> None:
        """Take a position measured `age_s` seconds ago.

        Args:
            z_map: (3,) m.
            R: (3, 3) m^2.
            age_s: seconds.
        """
        self._filter.update(z_map, R=R, H=_observation(age_s))
        self._filter.P = 0.5 * (self._filter.P + self._filter.P.T)


def _observation(age_s: float) -> FloatArray:
    """Return the matrix that turns the state now into the position `age_s` seconds ago."""
    H = np.zeros((3, 6))
    H[:, :3] = np.eye(3)
    H[:, 3:] = -age_s * np.eye(3)
    return H
