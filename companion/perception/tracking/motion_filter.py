"""The one place that knows filterpy: Kalman filters of one body's motion, told of the past."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from filterpy.kalman import KalmanFilter

from companion.messages import FloatArray

_P, _V, _A = slice(0, 3), slice(3, 6), slice(6, 9)
# Who leaves a manner takes up the next one, mostly.
_SUCCESSORS = np.array([[0.0, 0.75, 0.25], [0.5, 0.0, 0.5], [0.25, 0.75, 0.0]])
_MANOEUVRES = 1
_LEAST_WEIGHT = 1e-6


@dataclass(frozen=True, slots=True)
class Agility:
    """How a vehicle may accelerate.

    It does so for a while, not afresh every instant, so its acceleration is noise with a standard
    deviation and a time constant. And it does not always do so: it keeps still or goes straight on, it
    manoeuvres, it swerves, and each of these manners lasts.

    Attributes:
        level_sigma: standard deviation of each level axis of the acceleration, m/s^2.
        up_sigma: the same upwards.
        fading_s: time constant; 0 for plain constant velocity with white acceleration.
        white_density: of the acceleration that is white, m^2/s^3.
        steady_factor: multiplies the standard deviations of who keeps still or goes straight on...
        swerving_factor: ...and of who swerves.
        known_density: replaces `white_density` once it is known in which manner it flies.
        manners_last_s: how long each manner lasts on average.
    """

    level_sigma: float
    up_sigma: float
    fading_s: float
    white_density: float
    steady_factor: float = 0.06
    swerving_factor: float = 2.4
    known_density: float = 5e-4
    manners_last_s: tuple[float, float, float] = (10.0, 5.0, 3.0)

    def unknown(self) -> tuple[float, float, float]:
        """Return standard deviation, level and upwards, and density of whose manner is not known."""
        if self.fading_s <= 0.0:
            return 0.0, 0.0, self.white_density
        return self.level_sigma, self.up_sigma, self.white_density

    def manners(self) -> list[tuple[float, float, float]]:
        """Return the same of each manner."""
        # Who is known to manoeuvre does so on the level, mostly.
        return [
            (factor * self.level_sigma, share * factor * self.up_sigma, self.known_density)
            for factor, share in ((self.steady_factor, 1.0), (1.0, 0.5), (self.swerving_factor, 0.5))
        ]


class MotionFilter:
    """Position, velocity, and an acceleration that fades: constant velocity but for manoeuvres.

    At first one Kalman filter stands for all manners of flying. Once told to distinguish, there is one for
    each, and what is measured tells which one is true: so the covariance of who hovers is small and that
    of who swings to and fro is not.
    Source: R. Singer, "Estimating optimal tracking filter performance for manned maneuvering targets",
    1970; H. Blom and Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian
    switching coefficients", 1988.
    """

    def __init__(
        self,
        p_map: FloatArray,
        covariance_p: FloatArray,
        speed_sigma: float,
        agility: Agility,
        v_map: FloatArray | None = None,
    ) -> None:
        """Start where a body was seen.

        Args:
            p_map: (3,) m.
            covariance_p: (3, 3) m^2.
            speed_sigma: standard deviation of each axis of the velocity, m/s.
            agility: how it may accelerate.
            v_map: (3,) expected velocity, m/s; zero by default.
        """
        self._agility, self._weights = agility, np.ones(1)
        level, upwards, _ = agility.unknown()
        x = np.concatenate([p_map, np.zeros(3) if v_map is None else v_map, np.zeros(3)])
        P = np.diag([0.0] * 3 + [speed_sigma**2] * 3 + [level**2, level**2, upwards**2])
        P[_P, _P] = covariance_p
        self._spread([agility.unknown()], x, P)

    @property
    def p_map(self) -> FloatArray:
        """Position (3,), m."""
        return np.asarray(self._x[_P])

    @property
    def v_map(self) -> FloatArray:
        """Velocity (3,), m/s."""
        return np.asarray(self._x[_V])

    @property
    def covariance(self) -> FloatArray:
        """Covariance (6, 6) of position, then velocity."""
        return np.asarray(self._covariance)

    @property
    def cautious_covariance(self) -> FloatArray:
        """The same (6, 6) for what comes next, when it may begin to manoeuvre at any time."""
        return np.asarray(self._cautious[:6, :6])

    @property
    def weights(self) -> FloatArray:
        """Probability of each manner of flying."""
        return self._weights.copy()

    def distinguish(self) -> None:
        """From now on find out in which manner it flies."""
        if len(self._filters) == 1 and self._agility.fading_s > 0.0:
            self._spread(self._agility.manners(), self._filters[0].x, self._filters[0].P)

    def predict(self, dt_s: float) -> None:
        """Carry the state on by `dt_s` seconds."""
        agility = self._agility
        if len(self._filters) > 1:
            self._mix(dt_s)
        for filter_, (level, upwards, density) in zip(self._filters, self._manners, strict=True):
            F, Q = _transition(dt_s, (level, upwards), agility.fading_s, density)
            filter_.predict(F=F, Q=Q)
        self._combine()

    def fade(self, dt_s: float, fading_s: float, speed_sigma: float, v_map: FloatArray) -> None:
        """Let what is known of the velocity fade for `dt_s`, towards another one give or take a speed.

        In which manner it flew does not matter any more.

        Args:
            dt_s: seconds.
            fading_s: time constant.
            speed_sigma: standard deviation of each axis that it tends to, m/s.
            v_map: (3,) the velocity that it tends to, m/s.
        """
        if len(self._filters) > 1:
            x, _ = _mean(self._weights, *self._states())
            self._spread([self._agility.unknown()], x, self._cautious)
        left = math.exp(-dt_s / fading_s)
        keep = np.repeat([1.0, left, left], 3)
        (only,) = self._filters
        only.x = keep * only.x
        only.x[_V] += (1.0 - left) * v_map
        only.P = keep[:, None] * only.P * keep
        only.P[range(3, 6), range(3, 6)] += (1.0 - left**2) * speed_sigma**2
        self._combine()

    def update(self, z_map: FloatArray, R: FloatArray, age_s: float) -> None:
        """Take a position measured `age_s` seconds ago.

        Args:
            z_map: (3,) m.
            R: (3, 3) m^2.
            age_s: seconds.
        """
        H = _observation(age_s)
        likelihoods = np.empty(len(self._filters))
        for i, filter_ in enumerate(self._filters):
            filter_.update(z_map, R=R, H=H)
            filter_.P = 0.5 * (filter_.P + filter_.P.T)
            square = float(filter_.y @ filter_.SI @ filter_.y)
            likelihoods[i] = 0.5 * (math.log(np.linalg.det(filter_.SI)) - square)
        if len(self._filters) == 1:
            self._combine()
            return
        # However surely it flew in one manner, it may have begun another.
        weights = self._weights * np.exp(likelihoods - likelihoods.max())
        weights = np.maximum(weights / weights.sum(), _LEAST_WEIGHT)
        self._weights = weights / weights.sum()
        self._combine()

    def _spread(self, manners: list[tuple[float, float, float]], x: FloatArray, P: FloatArray) -> None:
        """Begin with as many filters as manners, all alike."""
        self._manners, self._filters = manners, []
        for _ in manners:
            filter_ = KalmanFilter(dim_x=9, dim_z=3)
            filter_.x, filter_.P = x.copy(), P.copy()
            self._filters.append(filter_)
        self._weights = np.full(len(manners), 1.0 / len(manners))
        self._combine()

    def _mix(self, dt_s: float) -> None:
        """Let each manner begin from all that may have come before it."""
        switching = _switching(dt_s, self._agility.manners_last_s)
        weights = self._weights @ switching
        shares = (switching * self._weights[:, None] / weights).T
        x, P = self._states()
        means = shares @ x
        apart = x[None] - means[:, None]
        mixed = (shares @ P.reshape(len(P), -1)).reshape(P.shape)
        mixed += apart.transpose(0, 2, 1) @ (shares[:, :, None] * apart)
        for filter_, mean, covariance in zip(self._filters, means, mixed, strict=True):
            filter_.x, filter_.P = mean, covariance
        self._weights = weights

    def _states(self) -> tuple[FloatArray, FloatArray]:
        x = np.array([filter_.x for filter_ in self._filters])
        return x, np.array([filter_.P for filter_ in self._filters])

    def _combine(self) -> None:
        x, P = self._states()
        if len(self._filters) == 1:
            self._x, self._covariance, self._cautious = x[0], P[0, :6, :6], P[0]
            return
        self._x, covariance = _mean(self._weights, x, P)
        self._covariance = covariance[:6, :6]
        apart = x[_MANOEUVRES] - self._x
        self._cautious = P[_MANOEUVRES] + apart[:, None] * apart


def _mean(weights: FloatArray, x: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (n,) and covariance (n, n) of Gaussians (k, n) and (k, n, n) that are mixed."""
    mean = weights @ x
    apart = x - mean
    covariance = (weights @ P.reshape(len(P), -1)).reshape(P.shape[1:])
    return mean, covariance + apart.T @ (weights[:, None] * apart)


@lru_cache(maxsize=128)
def _switching(dt_s: float, manners_last_s: tuple[float, float, float]) -> FloatArray:
    """Return the probability (3, 3) of going over from one manner (row) to another within `dt_s`."""
    stay = np.exp(-dt_s / np.array(manners_last_s))
    return np.asarray(np.diag(stay) + (1.0 - stay)[:, None] * _SUCCESSORS)


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
